//! Opcodes of numbers and text.

use super::Machine;
use crate::error::Error;
use crate::value::Value;

impl Machine<'_> {
    /// Reads the length that follows an opcode of text or bytes.
    pub(super) fn length(&mut self, op: u8) -> Result<u64, Error> {
        Ok(match op {
            b'U' | b'C' | 0x8c => self.input.byte()?.into(),
            b'T' | b'X' | b'B' => u32::from_le_bytes(self.input.array()?).into(),
            _ => u64::from_le_bytes(self.input.array()?),
        })
    }

    pub(super) fn number(&mut self, op: u8) -> Result<Value, Error> {
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

    /// An integer of `len` bytes, in two's complement.
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

    pub(super) fn text(&mut self, op: u8) -> Result<String, Error> {
        match op {
            b'S' => {
                let line = self.input.line()?;
                unquote(&line).ok_or_else(|| {
                    self.malformed("found a string that is not quoted as Python does")
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
}

pub(super) fn latin_1(bytes: &[u8]) -> String {
    bytes.iter().copied().map(char::from).collect()
}

/// Decodes a string literal of Python 2 as Latin-1; `None` if it is malformed.
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

/// Decodes a text line of protocol 0: Latin-1, where `\u` before four hexadecimal digits and `\U` before eight stand for a
/// character.
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
