//! Opcodes of containers, memos, names and calls.

use std::sync::Arc;

use super::literals::latin_1;
use super::{FALSE, MAX_OBJECTS, Machine, NONE};
use crate::error::Error;
use crate::object::{Global, Id, Node};
use crate::value::Value;

impl Machine<'_> {
    pub(super) fn container(&mut self, op: u8) -> Result<Node, Error> {
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
    pub(super) fn fill(&mut self, op: u8) -> Result<(), Error> {
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

    /// Pairs alternating keys and values. Values of dropped keys are replaced by `None`.
    fn entries(&mut self, items: &[Id]) -> Result<Vec<(Id, Id)>, Error> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(self.malformed("found a key without a value"));
        }
        let mut entries = Vec::with_capacity(pairs.len());
        for &[key, value] in pairs {
            let text = self.text_of(key);
            let dropped = text.is_some_and(|text| self.options.drop_keys.contains(&text));
            if dropped && value > FALSE {
                self.nodes[value as usize] = Node::Leaf(Value::None);
            }
            entries.push((key, value));
        }
        Ok(entries)
    }

    pub(super) fn memoize(&mut self, op: u8) -> Result<(), Error> {
        let key = match op {
            0x94 => self.memo.len() as u64,
            b'q' | b'h' => self.input.byte()?.into(),
            b'r' | b'j' => u32::from_le_bytes(self.input.array()?).into(),
            _ => {
                let line = self.input.line()?;
                let key = String::from_utf8_lossy(&line).trim().parse();
                key.map_err(|_| self.malformed("found no number of a memo"))?
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

    /// Runs the opcodes of names, calls and states.
    pub(super) fn object(&mut self, op: u8) -> Result<(), Error> {
        match op {
            b'c' | b'i' => {
                let module = self.input.line()?;
                let name = self.input.line()?;
                let (module, name) = (latin_1(&module), latin_1(&name));
                match op {
                    b'i' => Err(self.refused_global(&module, &name)),
                    _ => self.global(&module, &name),
                }
            }
            0x93 => {
                let name = self.pop()?;
                let module = self.pop()?;
                let (Some(module), Some(name)) = (self.text_of(module), self.text_of(name)) else {
                    return Err(self.malformed("found a name that is not text"));
                };
                let (module, name) = (module.to_owned(), name.to_owned());
                self.global(&module, &name)
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
                    return Err(self.malformed("found a call with named arguments"));
                }
                self.call()
            }
            _ => self.call(),
        }
    }

    fn global(&mut self, module: &str, name: &str) -> Result<(), Error> {
        match Global::find(module, name) {
            Some(global) => self.push_node(Node::Global(global)),
            None => Err(self.refused_global(module, name)),
        }
    }

    fn refused_global(&self, module: &str, name: &str) -> Error {
        let called = format!("{}.{}", module.escape_debug(), name.escape_debug());
        self.refused(&called, Global::refusal(module, name))
    }

    /// Calls a known name with the arguments on the stack.
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
            Global::Tuple => Node::Tuple(self.items_of(&arguments)?),
            Global::Set => Node::Set(self.items_of(&arguments)?),
            Global::Bytes => self.encoded(&arguments)?,
            Global::RebuildTensor => self.tensor(&arguments)?,
            Global::LoadStorage => self.inner_storage(&arguments)?,
            Global::ArrayWrapper if arguments.is_empty() => Node::PendingWrapper,
            Global::NdArray | Global::StorageOf(_) | Global::ArrayWrapper => {
                return Err(self.malformed(format!("found a call of {global:?}")));
            }
        };
        self.push_node(node)
    }

    fn dict(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let mut entries = Vec::new();
        for item in self.items_of(arguments)? {
            match self.node(item) {
                Node::Tuple(pair) | Node::List(pair) if pair.len() == 2 => entries.extend(pair),
                _ => return Err(self.malformed("found an entry that is no pair")),
            }
        }
        self.entries(&entries).map(Node::Dict)
    }

    /// The items of the container that a constructor gets as argument; no items without an argument.
    fn items_of(&self, arguments: &[Id]) -> Result<Vec<Id>, Error> {
        match arguments.first().map(|&items| self.node(items)) {
            None => Ok(Vec::new()),
            Some(Node::List(items) | Node::Tuple(items) | Node::Set(items)) => Ok(items.clone()),
            Some(other) => Err(self.malformed(format!("found a container of {}", other.kind()))),
        }
    }

    fn encoded(&self, arguments: &[Id]) -> Result<Node, Error> {
        let encoding = arguments.get(1).and_then(|&name| self.text_of(name));
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

    fn set_state(&mut self, target: Id, state: Id) -> Result<(), Error> {
        let parts = match self.node(state) {
            Node::Tuple(parts) => parts.clone(),
            _ => Vec::new(),
        };
        let node = match self.node(target) {
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
                self.array_of_state(shape, item, fortran, data)?
            }
            Node::ItemType(item) => Node::ItemType(self.ordered(*item, &parts)?),
            Node::PendingWrapper => self.wrapped_array(state)?,
            // Attributes of an ordered dictionary, such as the layer versions that PyTorch keeps in
            // `_metadata`, are not part of its value.
            Node::Dict(_) if state == NONE || matches!(self.node(state), Node::Dict(_)) => {
                return Ok(());
            }
            other => {
                let kind = other.kind();
                return Err(self.malformed(format!("found a state for {kind}")));
            }
        };
        self.nodes[target as usize] = node;
        Ok(())
    }
}
