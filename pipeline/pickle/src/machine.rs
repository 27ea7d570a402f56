//! The stack machine: one method for each family of opcodes.
//!
//! # Source
//! The opcodes and their meaning are those of Python's `pickletools`, protocols 0 to 5.

use std::collections::BTreeMap;
use std::io::Read;
use std::sync::Arc;

use crate::array::{self, Array, ItemType};
use crate::error::Error;
use crate::input::Input;
use crate::object::{Global, Id, Node, Storage, StorageData, Tensor};
use crate::value::{Options, Value};

/// Newest protocol there is.
pub(crate) const MAX_PROTOCOL: u8 = 5;
/// Most objects, and most places on the stack over a whole run: a pickle of MotionFix has about
/// a million, and the bound keeps what hostile bytes can make of themselves below a gigabyte.
const MAX_OBJECTS: usize = 1 << 23;
const MAX_PUSHES: usize = 1 << 26;
/// Deepest nesting of containers; motion files nest four deep.
const MAX_DEPTH: usize = 64;
/// How many times more values than objects a pickle may unfold to by sharing.
const MAX_SHARING: usize = 8;
/// Bytes from which the source of an array is let go once the array is made. Python shares empty
/// and one-byte objects among arrays, and never large ones.
const RELEASE_LEN: usize = 4096;

/// Places of the objects every machine starts with.
const NONE: Id = 0;
const TRUE: Id = 1;
const FALSE: Id = 2;

/// Reads the storage in a file of `torch.save`.
type ReadStorage = fn(&[u8]) -> Result<Storage, Error>;

/// The machine, on its way through a pickle.
pub(crate) struct Machine<'a> {
    input: Input<'a>,
    options: Options<'a>,
    /// Reads a storage that is given by the bytes of a file of `torch.save`.
    read_storage: ReadStorage,
    /// Bytes of arrays follow joblib's wrappers.
    wrapped_arrays: bool,
    /// Storages may be named that are kept outside the pickle.
    outside_storages: bool,
    /// Storages may be given by the bytes of a file of their own.
    inner_files: bool,
    nodes: Vec<Node>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: BTreeMap<u64, Id>,
    pushes: usize,
    /// Where the current opcode stands.
    op_at: usize,
}

impl<'a> Machine<'a> {
    pub(crate) fn new(
        reader: impl Read + 'a,
        options: Options<'a>,
        read_storage: ReadStorage,
    ) -> Self {
        Self {
            input: Input::new(reader),
            options,
            read_storage,
            wrapped_arrays: false,
            outside_storages: false,
            inner_files: true,
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

    pub(crate) fn with_wrapped_arrays(self) -> Self {
        Self {
            wrapped_arrays: true,
            ..self
        }
    }

    /// Accepts names of storages, and no files within the pickle.
    pub(crate) fn with_outside_storages(self) -> Self {
        Self {
            outside_storages: true,
            inner_files: false,
            ..self
        }
    }

    /// Reads a pickle to its end.
    pub(crate) fn read(mut self) -> Result<Value, Error> {
        let root = self.run()?;
        self.value(root, &BTreeMap::new())
    }

    /// The object at a place.
    pub(crate) fn node(&self, id: Id) -> &Node {
        &self.nodes[id as usize]
    }

    /// The input behind the last pickle that was run.
    pub(crate) fn input(&mut self) -> &mut Input<'a> {
        &mut self.input
    }

    /// Types of the storages that are kept outside the pickle, by name.
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

    /// Runs one pickle and returns the place of its object.
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
            // A frame says how far to read ahead, which the input decides by itself.
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

    /// The length an opcode of text or bytes states.
    fn length(&mut self, op: u8) -> Result<u64, Error> {
        Ok(match op {
            b'U' | b'C' | 0x8c => self.input.byte()?.into(),
            b'T' | b'X' | b'B' => u32::from_le_bytes(self.input.array()?).into(),
            _ => u64::from_le_bytes(self.input.array()?),
        })
    }

    fn number(&mut self, op: u8) -> Result<Value, Error> {
        Ok(match op {
            b'J' => Value::Int(i32::from_le_bytes(self.input.array()?).into()),
            b'K' => Value::Int(self.input.byte()?.into()),
            b'M' => Value::Int(u16::from_le_bytes(self.input.array()?).into()),
            b'G' => Value::Float(f64::from_be_bytes(self.input.array()?)),
            0x8a => {
                let len = self.input.byte()?;
                self.long(len.into())?
            }
            0x8b => {
                let len = u32::from_le_bytes(self.input.array()?);
                self.long(len.into())?
            }
            _ => {
                let line = self.input.line()?;
                let text = String::from_utf8_lossy(&line);
                let text = text.trim().trim_end_matches('L');
                let value = match (op, text) {
                    (b'I', "00") => Some(Value::Bool(false)),
                    (b'I', "01") => Some(Value::Bool(true)),
                    (b'F', text) => text.parse().ok().map(Value::Float),
                    (_, text) => text.parse().ok().map(Value::Int),
                };
                value.ok_or_else(|| {
                    self.malformed(format!(
                        "found \"{}\", expected a number",
                        text.escape_debug()
                    ))
                })?
            }
        })
    }

    /// A whole number of so many bytes, in two's complement.
    fn long(&mut self, len: u64) -> Result<Value, Error> {
        let bytes = self.input.bytes(len)?;
        let negative = bytes.last().is_some_and(|last| last >> 7 == 1);
        let fill = if negative { 0xff } else { 0 };
        let mut wide = [fill; 16];
        if bytes.len() > wide.len() {
            return Err(self.limit(format!(
                "found a number of {} bytes, expected at most {}",
                bytes.len(),
                wide.len()
            )));
        }
        wide[..bytes.len()].copy_from_slice(&bytes);
        Ok(Value::Int(i128::from_le_bytes(wide)))
    }

    fn text(&mut self, op: u8) -> Result<String, Error> {
        match op {
            b'S' => {
                let line = self.input.line()?;
                unquote(&line).ok_or_else(|| {
                    self.malformed("found a string that is not quoted as Python does".to_owned())
                })
            }
            b'V' => {
                let line = self.input.line()?;
                Ok(unescape_unicode(&line))
            }
            _ => {
                let len = self.length(op)?;
                let bytes = self.input.bytes(len)?;
                Ok(match op {
                    b'T' | b'U' => latin_1(&bytes),
                    _ => String::from_utf8_lossy(&bytes).into_owned(),
                })
            }
        }
    }

    fn container(&mut self, op: u8) -> Result<Node, Error> {
        Ok(match op {
            b']' => Node::List(Vec::new()),
            b'}' => Node::Dict(Vec::new()),
            b')' => Node::Tuple(Vec::new()),
            0x8f => Node::Set(Vec::new()),
            b'l' => Node::List(self.items_from_mark()?),
            b't' => Node::Tuple(self.items_from_mark()?),
            0x91 => Node::Set(self.items_from_mark()?),
            b'd' => {
                let items = self.items_from_mark()?;
                Node::Dict(self.entries(&items)?)
            }
            _ => {
                let mut items = Vec::new();
                for _ in 0x85..=op {
                    items.push(self.pop()?);
                }
                items.reverse();
                Node::Tuple(items)
            }
        })
    }

    /// Adds items to the container below them.
    fn fill(&mut self, op: u8) -> Result<(), Error> {
        let items = match op {
            b'a' => vec![self.pop()?],
            b's' => {
                let value = self.pop()?;
                vec![self.pop()?, value]
            }
            _ => self.items_from_mark()?,
        };
        let container = self.top()?;
        let entries = match op {
            b's' | b'u' => self.entries(&items)?,
            _ => Vec::new(),
        };
        match (op, &mut self.nodes[container as usize]) {
            (b'a' | b'e', Node::List(list)) => list.extend(items),
            (0x90, Node::Set(set)) => set.extend(items),
            (b's' | b'u', Node::Dict(dict)) => dict.extend(entries),
            (_, other) => {
                let kind = other.kind();
                return Err(self.malformed(format!("found items for {kind}")));
            }
        }
        Ok(())
    }

    /// Keys and values in turn as entries; values of dropped keys are let go here.
    fn entries(&mut self, items: &[Id]) -> Result<Vec<(Id, Id)>, Error> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(self.malformed("found a key without a value".to_owned()));
        }
        let mut entries = Vec::with_capacity(pairs.len());
        for &[key, value] in pairs {
            let dropped = match self.node(key) {
                Node::Leaf(Value::Str(text)) => self.options.drop_keys.contains(&&**text),
                _ => false,
            };
            if dropped && value > FALSE {
                self.nodes[value as usize] = Node::Leaf(Value::None);
            }
            entries.push((key, value));
        }
        Ok(entries)
    }

    fn memoize(&mut self, op: u8) -> Result<(), Error> {
        let key = match op {
            0x94 => self.memo.len() as u64,
            b'q' | b'h' => self.input.byte()?.into(),
            b'r' | b'j' => u32::from_le_bytes(self.input.array()?).into(),
            _ => {
                let line = self.input.line()?;
                let key = String::from_utf8_lossy(&line).trim().parse();
                key.map_err(|_| self.malformed("found no number of a memo".to_owned()))?
            }
        };
        if matches!(op, b'g' | b'h' | b'j') {
            let found = self.memo.get(&key).copied();
            let id = found
                .ok_or_else(|| self.malformed(format!("found memo {key}, which was never set")))?;
            return self.push(id);
        }
        let top = self.top()?;
        self.memo.insert(key, top);
        if self.memo.len() > MAX_OBJECTS {
            return Err(self.limit(format!("found more than {MAX_OBJECTS} memos")));
        }
        Ok(())
    }

    /// Names, calls and states.
    fn object(&mut self, op: u8) -> Result<(), Error> {
        match op {
            b'c' | b'i' => {
                let module = self.input.line()?;
                let name = self.input.line()?;
                let (module, name) = (latin_1(&module), latin_1(&name));
                if op == b'i' {
                    let called = format!("{}.{}", module.escape_debug(), name.escape_debug());
                    return Err(self.refused(&called, Global::refusal(&module, &name)));
                }
                self.global(&module, &name)
            }
            0x93 => {
                let name = self.pop()?;
                let module = self.pop()?;
                match (self.node(module), self.node(name)) {
                    (Node::Leaf(Value::Str(module)), Node::Leaf(Value::Str(name))) => {
                        let (module, name) = (module.clone(), name.clone());
                        self.global(&module, &name)
                    }
                    _ => Err(self.malformed("found a name that is not text".to_owned())),
                }
            }
            b'o' => Err(self.refused("an instance", "that is code and is never executed")),
            b'P' => Err(self.refused("an object by its name", "it is kept outside the pickle")),
            b'Q' => {
                let id = self.pop()?;
                self.outside_storage(id)
            }
            b'b' => {
                let state = self.pop()?;
                let target = self.top()?;
                self.set_state(target, state)
            }
            0x92 => {
                let keywords = self.pop()?;
                if !matches!(self.node(keywords), Node::Dict(entries) if entries.is_empty()) {
                    return Err(self.malformed("found a call with named arguments".to_owned()));
                }
                self.call()
            }
            _ => self.call(),
        }
    }

    fn global(&mut self, module: &str, name: &str) -> Result<(), Error> {
        match Global::find(module, name) {
            Some(global) => self.push_node(Node::Global(global)),
            None => {
                let called = format!("{}.{}", module.escape_debug(), name.escape_debug());
                Err(self.refused(&called, Global::refusal(module, name)))
            }
        }
    }

    /// Does what a known name stands for with the arguments on the stack.
    fn call(&mut self) -> Result<(), Error> {
        let arguments = self.pop()?;
        let callee = self.pop()?;
        let (Node::Global(global), Node::Tuple(arguments)) =
            (self.node(callee), self.node(arguments))
        else {
            let kind = self.node(callee).kind();
            return Err(self.malformed(format!("found a call of {kind}")));
        };
        let (global, arguments) = (*global, arguments.clone());
        let node = match global {
            Global::Reconstruct => {
                let class = arguments.first().map(|&class| self.node(class));
                if !matches!(class, Some(Node::Global(Global::NdArray))) {
                    return Err(self.refused(
                        "an array of a class of its own",
                        "only numpy.ndarray is read",
                    ));
                }
                Node::PendingArray
            }
            Global::ItemType => Node::ItemType(self.item_type(&arguments)?),
            Global::Scalar => match self.scalar(&arguments)? {
                Ok(value) => Node::Leaf(value),
                Err(object) => return self.push(object),
            },
            Global::FromBuffer => self.array_over_buffer(&arguments)?,
            Global::Dict => self.dict(&arguments)?,
            Global::List => Node::List(self.items_of(&arguments)?),
            Global::Tuple | Global::TensorShape => Node::Tuple(self.items_of(&arguments)?),
            Global::Set => Node::Set(self.items_of(&arguments)?),
            Global::Bytes | Global::Encode => self.encoded(&arguments)?,
            Global::RebuildTensor => self.tensor(&arguments)?,
            Global::LoadStorage => self.inner_storage(&arguments)?,
            Global::ArrayWrapper if arguments.is_empty() => Node::PendingWrapper,
            Global::NdArray | Global::StorageOf(_) | Global::ArrayWrapper => {
                return Err(self.malformed(format!("found a call of {global:?}")));
            }
        };
        self.push_node(node)
    }

    fn item_type(&self, arguments: &[Id]) -> Result<ItemType, Error> {
        let name = match arguments.first().map(|&name| self.node(name)) {
            Some(Node::Leaf(Value::Str(name))) => &**name,
            _ => "",
        };
        ItemType::parse(name).ok_or_else(|| {
            Error::new(
                "E-PICKLE-DTYPE",
                format!(
                    "found an array type \"{}\", expected one such as f4, f8, i8 or U6",
                    name.escape_debug()
                ),
            )
            .at(self.op_at)
        })
    }

    /// A scalar, or the place of the object it wraps.
    fn scalar(&mut self, arguments: &[Id]) -> Result<Result<Value, Id>, Error> {
        let &[item, data] = arguments else {
            return Err(self.malformed(format!(
                "found a scalar of {} arguments, expected a type and its bytes",
                arguments.len()
            )));
        };
        let item = self.as_item_type(item)?;
        if item.dtype.is_none() {
            return Ok(Err(data));
        }
        let array = self.make_array(item, Vec::new(), data, false)?;
        let text = array.to_text().and_then(|mut texts| texts.pop());
        let number = array.to_f64().and_then(|mut numbers| numbers.pop());
        Ok(Ok(match (array.dtype(), text, number) {
            (_, Some(text), _) => Value::Str(text.into()),
            (array::Dtype::Bool, _, Some(number)) => Value::Bool(number != 0.0),
            (array::Dtype::Float(_), _, Some(number)) => Value::Float(number),
            _ => array.first_int().map_or(Value::None, Value::Int),
        }))
    }

    fn array_over_buffer(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let &[buffer, item, shape, order] = arguments else {
            return Err(self.malformed(format!(
                "found an array of {} arguments, expected buffer, type, shape and order",
                arguments.len()
            )));
        };
        let fortran = matches!(self.node(order), Node::Leaf(Value::Str(order)) if &**order == "F");
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let array = self.make_array(item, shape, buffer, fortran)?;
        Ok(Node::Leaf(Value::Array(Arc::new(array))))
    }

    fn dict(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let mut entries = Vec::new();
        for item in self.items_of(arguments)? {
            match self.node(item) {
                Node::Tuple(pair) | Node::List(pair) if pair.len() == 2 => entries.extend(pair),
                _ => return Err(self.malformed("found an entry that is no pair".to_owned())),
            }
        }
        self.entries(&entries).map(Node::Dict)
    }

    /// The items of the one container among the arguments of a container's class.
    fn items_of(&self, arguments: &[Id]) -> Result<Vec<Id>, Error> {
        match arguments.first().map(|&items| self.node(items)) {
            None => Ok(Vec::new()),
            Some(Node::List(items) | Node::Tuple(items) | Node::Set(items)) => Ok(items.clone()),
            Some(other) => Err(self.malformed(format!("found a container of {}", other.kind()))),
        }
    }

    fn encoded(&self, arguments: &[Id]) -> Result<Node, Error> {
        let encoding = match arguments.get(1).map(|&name| self.node(name)) {
            Some(Node::Leaf(Value::Str(name))) => Some(&**name),
            _ => None,
        };
        let bytes = match arguments.first().map(|&data| self.node(data)) {
            None => Arc::from([]),
            Some(Node::Leaf(Value::Bytes(bytes))) => bytes.clone(),
            Some(Node::Leaf(Value::Str(text)))
                if matches!(encoding, Some("latin1" | "latin-1")) =>
            {
                self.latin_1_bytes(text)?
            }
            Some(other) => {
                return Err(self.malformed(format!(
                    "found bytes of {} by {encoding:?}, expected bytes or text in latin1",
                    other.kind()
                )));
            }
        };
        Ok(Node::Leaf(Value::Bytes(bytes)))
    }

    fn tensor(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let &[storage, offset, shape, strides, ..] = arguments else {
            return Err(self.malformed(format!(
                "found a tensor of {} arguments, expected storage, offset, shape and strides",
                arguments.len()
            )));
        };
        let offset = match self.node(offset) {
            Node::Leaf(Value::Int(offset)) => usize::try_from(*offset).ok(),
            _ => None,
        };
        let offset = offset.ok_or_else(|| self.malformed("found no offset".to_owned()))?;
        let (shape, strides) = (self.as_shape(shape)?, self.as_shape(strides)?);
        let Node::Storage(Storage { dtype, data }) = self.node(storage) else {
            return Err(self.malformed("found a tensor without a storage".to_owned()));
        };
        let dtype = *dtype;
        match data {
            StorageData::Present(bytes) => {
                let array = Array::from_strides(dtype, bytes, offset, shape, &strides)
                    .map_err(|reason| self.wrong_shape(reason))?;
                Ok(Node::Leaf(Value::Array(Arc::new(self.narrowed(array)))))
            }
            StorageData::Named(key) => Ok(Node::Tensor(Tensor {
                dtype,
                key: key.clone(),
                offset,
                shape,
                strides,
            })),
        }
    }

    fn inner_storage(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let Some(&data) = arguments.first() else {
            return Err(self.malformed("found a storage without bytes".to_owned()));
        };
        if !self.inner_files {
            return Err(self.refused("a file within a file", "one within a pickle is the most"));
        }
        let bytes = self.take_bytes(data)?;
        (self.read_storage)(&bytes).map(Node::Storage)
    }

    /// A storage by the tuple that names it: a word, its class, its key, a device and a length.
    fn outside_storage(&mut self, id: Id) -> Result<(), Error> {
        if !self.outside_storages {
            return Err(self.refused("an object by its name", "it is kept outside the pickle"));
        }
        let Node::Tuple(parts) = self.node(id) else {
            return Err(self.malformed("found a name that is no tuple".to_owned()));
        };
        let &[_, class, key, ..] = parts.as_slice() else {
            return Err(self.malformed("found a storage without class and key".to_owned()));
        };
        let (Node::Global(Global::StorageOf(dtype)), Node::Leaf(Value::Str(key))) =
            (self.node(class), self.node(key))
        else {
            return Err(self.malformed("found a storage without class and key".to_owned()));
        };
        let storage = Storage {
            dtype: *dtype,
            data: StorageData::Named(key.to_string()),
        };
        self.push_node(Node::Storage(storage))
    }

    fn set_state(&mut self, target: Id, state: Id) -> Result<(), Error> {
        let parts = match self.node(state) {
            Node::Tuple(parts) => parts.clone(),
            _ => Vec::new(),
        };
        match self.node(target) {
            Node::PendingArray => {
                // Very old arrays state no version.
                let (&[_, shape, item, fortran, data] | &[shape, item, fortran, data]) =
                    parts.as_slice()
                else {
                    return Err(self.malformed(format!(
                        "found an array's state of {} parts, expected 5",
                        parts.len()
                    )));
                };
                let node = self.array_of_state(shape, item, fortran, data)?;
                self.nodes[target as usize] = node;
            }
            Node::ItemType(item) => {
                let item = self.ordered(*item, &parts)?;
                self.nodes[target as usize] = Node::ItemType(item);
            }
            Node::PendingWrapper => {
                let node = self.wrapped_array(state)?;
                self.nodes[target as usize] = node;
            }
            // Attributes beside the entries of an ordered dictionary, such as the versions of
            // layers that PyTorch notes in `_metadata`, are no part of its value.
            Node::Dict(_) if matches!(self.node(state), Node::Dict(_)) => {}
            Node::Dict(_) if state == NONE => {}
            other => {
                let kind = other.kind();
                return Err(self.malformed(format!("found a state for {kind}")));
            }
        }
        Ok(())
    }

    fn array_of_state(
        &mut self,
        shape: Id,
        item: Id,
        fortran: Id,
        data: Id,
    ) -> Result<Node, Error> {
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let fortran = match self.node(fortran) {
            Node::Leaf(Value::Bool(fortran)) => *fortran,
            Node::Leaf(Value::Int(fortran)) => *fortran != 0,
            _ => false,
        };
        if item.dtype.is_some() {
            let array = self.make_array(item, shape, data, fortran)?;
            return Ok(Node::Leaf(Value::Array(Arc::new(array))));
        }
        match self.node(data) {
            Node::List(items) if array::count(&shape) == Some(items.len()) => {
                Ok(Node::List(items.clone()))
            }
            other => Err(self.wrong_shape(format!(
                "found {} for an array of objects of shape {shape:?}",
                other.kind()
            ))),
        }
    }

    /// A type with the byte order of its state: version, order, inner type, field names, …
    fn ordered(&self, item: ItemType, state: &[Id]) -> Result<ItemType, Error> {
        let order = match state.get(1).map(|&order| self.node(order)) {
            Some(Node::Leaf(Value::Str(order))) => order.clone(),
            _ => return Err(self.malformed("found a type without a byte order".to_owned())),
        };
        let plain = state.get(2..5).is_none_or(|parts| {
            parts
                .iter()
                .all(|&part| matches!(self.node(part), Node::Leaf(Value::None)))
        });
        if !plain {
            return Err(Error::new(
                "E-PICKLE-DTYPE",
                "found an array type with named fields, expected plain numbers",
            )
            .at(self.op_at));
        }
        Ok(ItemType {
            big_endian: &*order == ">",
            ..item
        })
    }

    /// The array behind one of joblib's wrappers.
    ///
    /// # Source
    /// `NumpyArrayWrapper` of joblib: the wrapper's attributes, then, where it has an alignment, a
    /// byte that counts the padding and the padding, then the items.
    fn wrapped_array(&mut self, state: Id) -> Result<Node, Error> {
        if !self.wrapped_arrays {
            return Err(self.malformed("found a joblib array outside a joblib dump".to_owned()));
        }
        let Node::Dict(entries) = self.node(state) else {
            return Err(self.malformed("found a joblib array without attributes".to_owned()));
        };
        let attribute = |name: &str| {
            let named = entries.iter().find(|(key, _)| {
                matches!(self.node(*key), Node::Leaf(Value::Str(text)) if &**text == name)
            });
            named.map(|(_, value)| *value)
        };
        let missing = || self.malformed("found a joblib array without type and shape".to_owned());
        let item = attribute("dtype").ok_or_else(missing)?;
        let shape = attribute("shape").ok_or_else(missing)?;
        let fortran = attribute("order").is_some_and(
            |order| matches!(self.node(order), Node::Leaf(Value::Str(order)) if &**order == "F"),
        );
        let aligned = attribute("numpy_array_alignment_bytes")
            .is_some_and(|bytes| matches!(self.node(bytes), Node::Leaf(Value::Int(_))));
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let Some(dtype) = item.dtype else {
            return self.wrapped_objects();
        };
        if aligned {
            let padding = self.input.byte()?;
            self.input.bytes(padding.into())?;
        }
        let len = array::byte_len(dtype, &shape).ok_or_else(|| {
            self.wrong_shape(format!("found shape {shape:?}, which no array can have"))
        })?;
        let raw: Arc<[u8]> = self.input.bytes(len as u64)?.into();
        let array = Array::from_raw(item, shape, raw, fortran)
            .map_err(|reason| self.wrong_shape(reason))?;
        Ok(Node::Leaf(Value::Array(Arc::new(self.narrowed(array)))))
    }

    /// An array of objects, which joblib writes as a pickle within the pickle.
    fn wrapped_objects(&mut self) -> Result<Node, Error> {
        let outer = (
            std::mem::take(&mut self.stack),
            std::mem::take(&mut self.marks),
            std::mem::take(&mut self.memo),
        );
        // The inner pickle is written by Python's own pickler, which knows no wrappers.
        self.wrapped_arrays = false;
        let inner = self.run()?;
        self.wrapped_arrays = true;
        (self.stack, self.marks, self.memo) = outer;
        Ok(self.node(inner).clone())
    }

    fn make_array(
        &mut self,
        item: ItemType,
        shape: Vec<usize>,
        data: Id,
        fortran: bool,
    ) -> Result<Array, Error> {
        let raw = self.take_bytes(data)?;
        let array = Array::from_raw(item, shape, raw, fortran)
            .map_err(|reason| self.wrong_shape(reason))?;
        Ok(self.narrowed(array))
    }

    fn narrowed(&self, array: Array) -> Array {
        if self.options.single_precision {
            array.in_single_precision()
        } else {
            array
        }
    }

    /// The bytes of an object; large ones are taken away from it.
    fn take_bytes(&mut self, id: Id) -> Result<Arc<[u8]>, Error> {
        let bytes = match self.node(id) {
            Node::Leaf(Value::Bytes(bytes)) => bytes.clone(),
            Node::Leaf(Value::Str(text)) => self.latin_1_bytes(text)?,
            other => {
                let kind = other.kind();
                return Err(self.malformed(format!("found {kind}, expected bytes of an array")));
            }
        };
        if bytes.len() >= RELEASE_LEN {
            self.nodes[id as usize] = Node::Released;
        }
        Ok(bytes)
    }

    fn latin_1_bytes(&self, text: &str) -> Result<Arc<[u8]>, Error> {
        let bytes: Result<Vec<u8>, _> = text.chars().map(u8::try_from).collect();
        let bytes = bytes.map_err(|_| {
            self.malformed("found text beyond latin1 where bytes were expected".to_owned())
        })?;
        Ok(bytes.into())
    }

    fn as_item_type(&self, id: Id) -> Result<ItemType, Error> {
        match self.node(id) {
            Node::ItemType(item) => Ok(*item),
            other => Err(self.malformed(format!("found {}, expected a type", other.kind()))),
        }
    }

    fn as_shape(&self, id: Id) -> Result<Vec<usize>, Error> {
        let extent = |id: Id| match self.node(id) {
            Node::Leaf(Value::Int(extent)) => usize::try_from(*extent).ok(),
            _ => None,
        };
        let extents = match self.node(id) {
            Node::Tuple(extents) | Node::List(extents) => {
                extents.iter().map(|&id| extent(id)).collect()
            }
            _ => extent(id).map(|extent| vec![extent]),
        };
        extents.ok_or_else(|| self.malformed("found no shape where one was expected".to_owned()))
    }

    /// Unfolds an object to a value. `storages` holds those kept outside the pickle.
    pub(crate) fn value(
        &self,
        root: Id,
        storages: &BTreeMap<String, Arc<[u8]>>,
    ) -> Result<Value, Error> {
        let mut left = self.nodes.len().saturating_mul(MAX_SHARING);
        self.unfold(root, 0, &mut left, storages)
    }

    fn unfold(
        &self,
        id: Id,
        depth: usize,
        left: &mut usize,
        storages: &BTreeMap<String, Arc<[u8]>>,
    ) -> Result<Value, Error> {
        if depth > MAX_DEPTH {
            return Err(self.limit(format!(
                "found containers nested deeper than {MAX_DEPTH}, or one within itself"
            )));
        }
        *left = left.checked_sub(1).ok_or_else(|| {
            self.limit("found objects shared so often that they unfold without end".to_owned())
        })?;
        let mut all = |items: &[Id]| -> Result<Vec<Value>, Error> {
            items
                .iter()
                .map(|&item| self.unfold(item, depth + 1, left, storages))
                .collect()
        };
        Ok(match self.node(id) {
            Node::Leaf(value) => value.clone(),
            Node::List(items) => Value::List(all(items)?),
            Node::Tuple(items) => Value::Tuple(all(items)?),
            Node::Set(items) => Value::Set(all(items)?),
            Node::Dict(entries) => {
                let mut unfolded = Vec::new();
                for &(key, value) in entries {
                    let pair = all(&[key, value])?;
                    if let Ok([key, value]) = <[Value; 2]>::try_from(pair) {
                        unfolded.push((key, value));
                    }
                }
                Value::Dict(unfolded)
            }
            Node::ItemType(item) => Value::Str(
                item.dtype
                    .map_or("O".to_owned(), |dtype| dtype.to_string())
                    .into(),
            ),
            Node::Tensor(tensor) => {
                let storage = storages.get(&tensor.key).ok_or_else(|| {
                    self.wrong_shape(format!("found no storage {}", tensor.key.escape_debug()))
                })?;
                let array = Array::from_strides(
                    tensor.dtype,
                    storage,
                    tensor.offset,
                    tensor.shape.clone(),
                    &tensor.strides,
                )
                .map_err(|reason| self.wrong_shape(reason))?;
                Value::Array(Arc::new(self.narrowed(array)))
            }
            Node::Global(global) => {
                return Err(self.refused(&format!("{global:?}"), "a class is no value"));
            }
            other => {
                return Err(self.malformed(format!("found {} as a value", other.kind())));
            }
        })
    }

    fn top(&self) -> Result<Id, Error> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        match self.stack.last() {
            Some(&top) if self.stack.len() > bottom => Ok(top),
            _ => Err(self.malformed("found an opcode without its operands".to_owned())),
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
            _ => Err(self.malformed("found an opcode without its mark".to_owned())),
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
        Error::new(
            "E-PICKLE-REFUSED",
            format!("the pickle asks for {what}: {why}"),
        )
        .at(self.op_at)
    }

    fn malformed(&self, reason: String) -> Error {
        Error::new("E-PICKLE-FORMAT", reason).at(self.op_at)
    }

    fn wrong_shape(&self, reason: String) -> Error {
        Error::new("E-PICKLE-SHAPE", reason).at(self.op_at)
    }

    fn limit(&self, reason: String) -> Error {
        Error::new("E-PICKLE-LIMIT", reason).at(self.op_at)
    }
}

fn latin_1(bytes: &[u8]) -> String {
    bytes.iter().copied().map(char::from).collect()
}

/// The text of a Python 2 string literal, its bytes taken as Latin-1.
fn unquote(line: &[u8]) -> Option<String> {
    let line = line.trim_ascii();
    let (&quote, rest) = line.split_first()?;
    let (&end, inner) = rest.split_last()?;
    if quote != end || !matches!(quote, b'\'' | b'"') {
        return None;
    }
    let mut text = String::new();
    let mut bytes = inner.iter().copied();
    while let Some(byte) = bytes.next() {
        if byte != b'\\' {
            text.push(char::from(byte));
            continue;
        }
        text.push(match bytes.next()? {
            b'n' => '\n',
            b't' => '\t',
            b'r' => '\r',
            b'x' => char::from(hex(&mut bytes, 2)? as u8),
            escaped @ (b'\\' | b'\'' | b'"') => char::from(escaped),
            _ => return None,
        });
    }
    Some(text)
}

/// The text of a protocol-0 string: Latin-1, with `\u` and four or `\U` and eight hexadecimal digits.
fn unescape_unicode(line: &[u8]) -> String {
    let mut text = String::new();
    let mut rest = line;
    while let Some((&byte, after)) = rest.split_first() {
        let digits = match (byte, after.first()) {
            (b'\\', Some(b'u')) => 4,
            (b'\\', Some(b'U')) => 8,
            _ => 0,
        };
        let code = (digits > 0)
            .then(|| hex(&mut after[1..].iter().copied(), digits))
            .flatten();
        rest = match code {
            Some(code) => {
                text.push(char::from_u32(code).unwrap_or(char::REPLACEMENT_CHARACTER));
                &after[1 + digits..]
            }
            None => {
                text.push(char::from(byte));
                after
            }
        };
    }
    text
}

fn hex(bytes: &mut impl Iterator<Item = u8>, digits: usize) -> Option<u32> {
    (0..digits).try_fold(0, |code: u32, _| {
        let digit = char::from(bytes.next()?).to_digit(16)?;
        Some(code << 4 | digit)
    })
}
