//! The numbers of the metrics file in TensorBoard's format.
//!
//! The file is a sequence of TFRecords: the length as `u64`, its masked CRC-32C, the message, and its masked CRC-32C,
//! all little-endian. A message is an `Event` of protobuf: `wall_time` (field 1), `step` (2), and `file_version` (3) or
//! `summary` (5), whose `value`s (1) have a `tag` (1) and a `simple_value` (2). The time is always 0, because this
//! library does not read the clock.
//!
//! Source: `event.proto`, `summary.proto` and `record_writer.cc` of TensorFlow.

use serde_json::Value;

/// Name of the file. TensorBoard finds files with `tfevents` in their name.
pub(super) const EVENTS: &str = "events.out.tfevents.0.stance";

pub(super) fn head() -> Vec<u8> {
    let mut event = time();
    put_bytes(&mut event, 3, b"brain.Event:2");
    record(&event)
}

/// Encodes the numbers of a line of the metrics file, each under its name. Empty if the line is not an object with a
/// step.
pub(super) fn of_line(line: &Value) -> Vec<u8> {
    let (Some(fields), Some(step)) = (line.as_object(), line["step"].as_u64()) else {
        return Vec::new();
    };
    let mut summary = Vec::new();
    for (name, value) in fields.iter().filter(|(name, _)| *name != "step") {
        if let Some(number) = value.as_f64() {
            let mut value = Vec::new();
            put_bytes(&mut value, 1, name.as_bytes());
            put_tag(&mut value, 2, Wire::Fixed32);
            value.extend((number as f32).to_le_bytes());
            put_bytes(&mut summary, 1, &value);
        }
    }
    let mut event = time();
    put_tag(&mut event, 2, Wire::Varint);
    put_varint(&mut event, step);
    put_bytes(&mut event, 5, &summary);
    record(&event)
}

#[derive(Clone, Copy)]
enum Wire {
    Varint = 0,
    Fixed64 = 1,
    Length = 2,
    Fixed32 = 5,
}

fn time() -> Vec<u8> {
    let mut event = Vec::new();
    put_tag(&mut event, 1, Wire::Fixed64);
    event.extend(0f64.to_le_bytes());
    event
}

fn put_tag(message: &mut Vec<u8>, field: u64, wire: Wire) {
    put_varint(message, field << 3 | wire as u64);
}

fn put_bytes(message: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    put_tag(message, field, Wire::Length);
    put_varint(message, bytes.len() as u64);
    message.extend(bytes);
}

fn put_varint(message: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        message.push(number as u8 | 0x80);
        number >>= 7;
    }
    message.push(number as u8);
}

fn record(message: &[u8]) -> Vec<u8> {
    let length = (message.len() as u64).to_le_bytes();
    let mut record = length.to_vec();
    record.extend(masked_crc(&length));
    record.extend(message);
    record.extend(masked_crc(message));
    record
}

/// The masked CRC of a record: rotated, with a constant added, so that the CRC of data that contains CRCs stays useful.
fn masked_crc(bytes: &[u8]) -> [u8; 4] {
    let crc = crc32c::crc32c(bytes);
    crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_file_begins_as_those_of_tensorflow_do() {
        let head = head();
        // Every TensorFlow file begins with length 24 and its CRC; the time and the version follow.
        assert_eq!(head[..8], 24u64.to_le_bytes());
        assert_eq!(head[8..13], [0xa3, 0x7f, 0x4b, 0x22, 0x09]);
        assert_eq!(head[21..36], *b"\x1a\x0dbrain.Event:2");
        assert_eq!(head.len(), 12 + 24 + 4);
    }

    #[test]
    fn a_line_is_an_event_of_its_numbers() {
        let event = of_line(&json!({ "step": 300, "loss": 0.5, "is_best": true }));
        let message = &event[12..event.len() - 4];
        let summary = b"\x0a\x0b\x0a\x04loss\x15\x00\x00\x00\x3f";
        let begin = b"\x09\0\0\0\0\0\0\0\0\x10\xac\x02\x2a".as_slice();
        let expected = [begin, &[summary.len() as u8], summary];
        assert_eq!(message, expected.concat());
        assert!(of_line(&json!("no object")).is_empty());
    }
}
