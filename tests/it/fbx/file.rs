//! Documents of FBX, written as text and in binary.

use std::fmt::Write;

use glam::DVec3;

/// A value of a node.
#[derive(Clone)]
pub(super) enum Value {
    Text(String),
    Long(i64),
    Real(f64),
    Longs(Vec<i64>),
    Floats(Vec<f32>),
}

/// A node of an FBX document.
#[derive(Clone)]
pub(super) struct Record {
    pub(super) name: &'static str,
    pub(super) values: Vec<Value>,
    pub(super) children: Vec<Record>,
}

pub(super) fn record(name: &'static str, values: Vec<Value>, children: Vec<Record>) -> Record {
    Record {
        name,
        values,
        children,
    }
}

/// A node with one value.
pub(super) fn leaf(name: &'static str, value: Value) -> Record {
    record(name, vec![value], Vec::new())
}

/// A node with children and no values.
pub(super) fn group(name: &'static str, children: Vec<Record>) -> Record {
    record(name, Vec::new(), children)
}

pub(super) fn text(text: &str) -> Value {
    Value::Text(text.to_owned())
}

/// A property: its name, its types, and its values.
pub(super) fn property(name: &str, kind: &str, more: &str, values: Vec<Value>) -> Record {
    let mut all = vec![text(name), text(kind), text(more), text("A")];
    all.extend(values);
    record("P", all, Vec::new())
}

pub(super) fn vector(name: &str, at: DVec3) -> Record {
    property(name, name, "", at.to_array().map(Value::Real).to_vec())
}

/// Encodes the records as text.
pub(super) fn ascii(records: &[Record]) -> Vec<u8> {
    fn write(record: &Record, depth: usize, text: &mut String) {
        let indent = "\t".repeat(depth);
        let _ = write!(text, "{indent}{}:", record.name);
        for (number, value) in record.values.iter().enumerate() {
            text.push_str(if number == 0 { " " } else { ", " });
            let list = |words: Vec<String>| {
                let (count, words) = (words.len(), words.join(","));
                format!("*{count} {{\n{indent}\ta: {words}\n{indent}}}")
            };
            text.push_str(&match value {
                // In text, the class of an object precedes its name; in binary files it follows.
                Value::Text(value) => match value.split_once("\0\u{1}") {
                    Some((name, class)) => format!("\"{class}::{name}\""),
                    None => format!("\"{value}\""),
                },
                Value::Long(value) => value.to_string(),
                Value::Real(value) => format!("{value:?}"),
                Value::Longs(values) => list(values.iter().map(i64::to_string).collect()),
                Value::Floats(values) => list(values.iter().map(f32::to_string).collect()),
            });
        }
        if !record.children.is_empty() {
            text.push_str(" {\n");
            for child in &record.children {
                write(child, depth + 1, text);
            }
            let _ = write!(text, "{indent}}}");
        }
        text.push('\n');
    }
    let mut text = "; FBX 7.4.0 project file\n".to_owned();
    for record in records {
        write(record, 0, &mut text);
    }
    text.into_bytes()
}

/// Encodes the records as binary data of version 7.4.
pub(super) fn binary(records: &[Record]) -> Vec<u8> {
    fn write(record: &Record, bytes: &mut Vec<u8>) {
        let start = bytes.len();
        bytes.extend([0; 12]);
        bytes.push(record.name.len() as u8);
        bytes.extend(record.name.as_bytes());
        let values_at = bytes.len();
        for value in &record.values {
            bytes.extend(match value {
                Value::Text(value) => {
                    let length = (value.len() as u32).to_le_bytes();
                    [&b"S"[..], &length, value.as_bytes()].concat()
                }
                Value::Long(value) => [&b"L"[..], &value.to_le_bytes()].concat(),
                Value::Real(value) => [&b"D"[..], &value.to_le_bytes()].concat(),
                Value::Longs(values) => {
                    let content = values.iter().flat_map(|value| value.to_le_bytes());
                    array(b"l", values.len(), &content.collect::<Vec<u8>>())
                }
                Value::Floats(values) => {
                    let content = values.iter().flat_map(|value| value.to_le_bytes());
                    array(b"f", values.len(), &content.collect::<Vec<u8>>())
                }
            });
        }
        let values_len = bytes.len() - values_at;
        if !record.children.is_empty() {
            for child in &record.children {
                write(child, bytes);
            }
            bytes.extend([0; 13]);
        }
        let numbers = [bytes.len(), record.values.len(), values_len];
        for (number, place) in numbers.iter().zip(0..) {
            let at = start + 4 * place;
            bytes[at..at + 4].copy_from_slice(&(*number as u32).to_le_bytes());
        }
    }
    fn array(kind: &[u8], count: usize, content: &[u8]) -> Vec<u8> {
        let numbers = [count, 0, content.len()].map(|number| (number as u32).to_le_bytes());
        [kind, numbers.as_flattened(), content].concat()
    }
    let mut bytes = b"Kaydara FBX Binary  \0\x1a\0".to_vec();
    bytes.extend(7400u32.to_le_bytes());
    for record in records {
        write(record, &mut bytes);
    }
    bytes.extend([0; 13]);
    bytes
}
