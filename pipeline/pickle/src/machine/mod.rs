//! The stack machine that runs a pickle: one method per family of opcodes.
//!
//! # Source
//! The opcodes and their meaning are those of Python's `pickletools`, protocols 0 to 5.

mod arrays;
mod literals;
mod objects;
mod unfold;

use std::collections::BTreeMap;
use std::io::Read;

use crate::array;
use crate::error::{Error, error};
use crate::input::Input;
use crate::object::{Id, Node, Storage, StorageData};
use crate::value::{Options, Value};

/// Newest supported protocol.
const MAX_PROTOCOL: u8 = 5;
/// Limits on objects and stack pushes over a whole run. A pickle of MotionFix has about a million objects; hostile
/// bytes stay below a gigabyte of memory.
const MAX_OBJECTS: usize = 1 << 23;
const MAX_PUSHES: usize = 1 << 26;

/// Ids of the objects that every machine starts with.
const NONE: Id = 0;
const TRUE: Id = 1;
const FALSE: Id = 2;

/// The machine and its state.
pub(crate) struct Machine<'a> {
    /// The input. After a pickle was run, it continues behind that pickle.
    pub(crate) input: Input<'a>,
    options: Options<'a>,
    /// Whether the bytes of arrays follow joblib's wrappers.
    pub(crate) wrapped_arrays: bool,
    /// Whether the pickle may name storages outside it. If not, it may contain storages as nested files.
    pub(crate) outside_storages: bool,
    nodes: Vec<Node>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: BTreeMap<u64, Id>,
    pushes: usize,
    /// Byte offset of the current opcode.
    op_at: usize,
}

impl<'a> Machine<'a> {
    pub(crate) fn new(reader: impl Read + 'a, options: Options<'a>) -> Self {
        Self {
            input: Input::new(reader),
            options,
            wrapped_arrays: false,
            outside_storages: false,
            nodes: vec![
                Node::Leaf(Value::None),
                Node::Leaf(Value::Bool(true)),
                Node::Leaf(Value::Bool(false)),
            ],
            stack: Vec::new(),
            marks: Vec::new(),
            memo: BTreeMap::new(),
            pushes: 0,
            op_at: 0,
        }
    }

    /// Reads a pickle to its end.
    pub(crate) fn read(mut self) -> Result<Value, Error> {
        let root = self.run()?;
        self.value(root, &BTreeMap::new())
    }

    /// The object with this id.
    pub(crate) fn node(&self, id: Id) -> &Node {
        &self.nodes[id as usize]
    }

    /// Element types of the storages outside the pickle, by storage name.
    pub(crate) fn outside_storages(&self) -> BTreeMap<String, array::Dtype> {
        self.nodes
            .iter()
            .filter_map(|node| match node {
                Node::Storage(Storage {
                    dtype,
                    data: StorageData::Named(key),
                }) => Some((key.clone(), *dtype)),
                _ => None,
            })
            .collect()
    }

    /// Runs one pickle and returns the id of its result.
    pub(crate) fn run(&mut self) -> Result<Id, Error> {
        self.stack.clear();
        self.marks.clear();
        self.memo.clear();
        loop {
            self.op_at = self.input.position();
            let op = self.input.byte()?;
            if op == b'.' {
                return self.pop();
            }
            self.step(op)?;
        }
    }

    fn step(&mut self, op: u8) -> Result<(), Error> {
        match op {
            0x80 => {
                let version = self.input.byte()?;
                if version > MAX_PROTOCOL {
                    return Err(self.malformed(format!(
                        "found protocol {version}, expected at most {MAX_PROTOCOL}"
                    )));
                }
                Ok(())
            }
            // A frame is a hint for reading ahead, which the input does not need.
            0x95 => self.input.array::<8>().map(drop),
            b'N' => self.push(NONE),
            0x88 => self.push(TRUE),
            0x89 => self.push(FALSE),
            b'I' | b'J' | b'K' | b'M' | b'L' | 0x8a | 0x8b | b'F' | b'G' => {
                let value = self.number(op)?;
                self.push_node(Node::Leaf(value))
            }
            b'S' | b'T' | b'U' | b'V' | b'X' | 0x8c | 0x8d => {
                let text = self.text(op)?;
                self.push_node(Node::Leaf(Value::Str(text.into())))
            }
            b'B' | b'C' | 0x8e | 0x96 => {
                let len = self.length(op)?;
                let bytes = self.input.bytes(len)?;
                self.push_node(Node::Leaf(Value::Bytes(bytes.into())))
            }
            b'(' => {
                self.marks.push(self.stack.len());
                self.count_push()
            }
            b'0' if self.marks.last() == Some(&self.stack.len()) => {
                self.marks.pop();
                Ok(())
            }
            b'0' => self.pop().map(drop),
            b'1' => self.items_from_mark().map(drop),
            b'2' => {
                let top = self.top()?;
                self.push(top)
            }
            b']' | b'}' | b')' | 0x8f | b'l' | b'd' | b't' | 0x91 | 0x85..=0x87 => {
                let node = self.container(op)?;
                self.push_node(node)
            }
            b'a' | b'e' | b's' | b'u' | 0x90 => self.fill(op),
            b'p' | b'q' | b'r' | 0x94 | b'g' | b'h' | b'j' => self.memoize(op),
            b'c' | 0x93 | b'i' | b'o' | b'R' | b'b' | 0x81 | 0x92 | b'P' | b'Q' => self.object(op),
            0x82..=0x84 => Err(self.refused("an extension code", "it names code by a number")),
            0x97 | 0x98 => Err(self.refused("a buffer", "it is kept outside the pickle")),
            other => Err(self.malformed(format!("found opcode {other:#04x}, expected a pickle's"))),
        }
    }

    fn top(&self) -> Result<Id, Error> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(&top) if self.stack.len() > bottom => Ok(top),
            _ => Err(self.malformed("found an opcode without its operands")),
        }
    }

    fn pop(&mut self) -> Result<Id, Error> {
        let top = self.top()?;
        self.stack.pop();
        Ok(top)
    }

    fn items_from_mark(&mut self) -> Result<Vec<Id>, Error> {
        match self.marks.pop() {
            Some(mark) if mark <= self.stack.len() => Ok(self.stack.split_off(mark)),
            _ => Err(self.malformed("found an opcode without its mark")),
        }
    }

    fn push(&mut self, id: Id) -> Result<(), Error> {
        self.count_push()?;
        self.stack.push(id);
        Ok(())
    }

    fn count_push(&mut self) -> Result<(), Error> {
        self.pushes += 1;
        if self.pushes > MAX_PUSHES {
            return Err(self.limit(format!("found more than {MAX_PUSHES} operands")));
        }
        Ok(())
    }

    fn push_node(&mut self, node: Node) -> Result<(), Error> {
        let id = Id::try_from(self.nodes.len())
            .ok()
            .filter(|_| self.nodes.len() < MAX_OBJECTS);
        let id = id.ok_or_else(|| self.limit(format!("found more than {MAX_OBJECTS} objects")))?;
        self.nodes.push(node);
        self.push(id)
    }

    fn refused(&self, what: &str, why: &str) -> Error {
        error!("E-PICKLE-REFUSED", "the pickle asks for {what}: {why}").at(self.op_at)
    }

    fn malformed(&self, reason: impl Into<String>) -> Error {
        Error::new("E-PICKLE-FORMAT", reason).at(self.op_at)
    }

    fn wrong_shape(&self, reason: impl Into<String>) -> Error {
        Error::new("E-PICKLE-SHAPE", reason).at(self.op_at)
    }

    fn limit(&self, reason: impl Into<String>) -> Error {
        Error::new("E-PICKLE-LIMIT", reason).at(self.op_at)
    }
}
