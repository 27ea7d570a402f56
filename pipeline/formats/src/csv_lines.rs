//! Hand-written CSV files: records with line numbers.

use csv::{Position, ReaderBuilder, StringRecord, Trim};

/// Records of a UTF-8 file, each with its line number and trimmed fields. A record in another encoding or with an
/// unclosed quote is an error.
pub fn records(bytes: &[u8]) -> impl Iterator<Item = (u64, Result<StringRecord, String>)> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(text);
    let mut lines = LineNumbers {
        text,
        place: 0,
        line: 1,
    };
    std::iter::from_fn(move || {
        let mut record = StringRecord::new();
        let start = reader.position().byte() as usize;
        let (line, record) = match reader.read_record(&mut record) {
            Ok(false) => return None,
            Ok(true) => (lines.at(record.position()), Ok(record)),
            Err(error) => {
                let reason = "it is not UTF-8 text; save the file as UTF-8".to_owned();
                (lines.at(error.position()), Err(reason))
            }
        };
        let end = reader.position().byte() as usize;
        let raw = text.get(start..end.min(text.len())).unwrap_or_default();
        let record = match is_open(raw) {
            true => Err(unclosed(raw)),
            false => record,
        };
        Some((line, record))
    })
}

fn unclosed(raw: &[u8]) -> String {
    let breaks = raw
        .trim_ascii()
        .iter()
        .filter(|byte| **byte == b'\n')
        .count();
    let swallowed = match breaks {
        0 => String::new(),
        1 => ", so that it and the line behind it are one and were not used".to_owned(),
        breaks => {
            format!(", so that it and the {breaks} lines behind it are one and were not used")
        }
    };
    format!(
        "a quote in it is not closed, or a quote in a quoted text is not doubled{swallowed}; write a quote in a text \
         as \"\""
    )
}

/// Whether a quoted field of the record lacks its closing quote or continues after it. Quotes inside a quoted field are
/// doubled.
fn is_open(record: &[u8]) -> bool {
    let mut bytes = record.trim_ascii().iter().copied().peekable();
    while bytes.peek().is_some() {
        if bytes.next_if_eq(&b'"').is_some() {
            loop {
                match bytes.next() {
                    None => return true,
                    Some(b'"') if bytes.next_if_eq(&b'"').is_none() => break,
                    Some(_) => {}
                }
            }
            while bytes.next_if(|byte| matches!(byte, b' ' | b'\t')).is_some() {}
            if !matches!(bytes.peek(), None | Some(b',' | b'\r' | b'\n')) {
                return true;
            }
        }
        // Skip to the next field.
        while bytes.next().is_some_and(|byte| byte != b',') {}
    }
    false
}

/// Line numbers by byte offset. The CSV reader's own count is wrong for CR LF and empty lines.
struct LineNumbers<'a> {
    text: &'a [u8],
    place: usize,
    line: u64,
}

impl LineNumbers<'_> {
    /// The line number of a record's start; offsets must ascend between calls.
    fn at(&mut self, position: Option<&Position>) -> u64 {
        let byte = position.map_or(0, Position::byte) as usize;
        while self.place < self.text.len()
            && (self.place < byte || matches!(self.text[self.place], b'\r' | b'\n'))
        {
            self.line += u64::from(self.text[self.place] == b'\n');
            self.place += 1;
        }
        self.line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quote_that_is_not_closed_is_a_reason_with_its_line() {
        let lines = |text: &str| -> Vec<(u64, bool)> {
            let records = records(text.as_bytes());
            records
                .map(|(line, record)| (line, record.is_ok()))
                .collect()
        };
        for (text, expected) in [
            ("a,b\n\"a, b\",\"c\"\"d\"\n", &[(1, true), (2, true)][..]),
            ("a,\"two\nlines\"\nb,c\n", &[(1, true), (3, true)]),
            ("a,say \"hello\" to\n", &[(1, true)]),
            ("a,b\nc,\"d\ne,f\ng,h\n", &[(1, true), (2, false)]),
            ("a,\"b\nc,\"d\"\ne,f\n", &[(1, false), (3, true)]),
            ("\r\n\r\na,\"b\" \r\nc,d\"\r\n", &[(3, true), (4, true)]),
        ] {
            assert_eq!(lines(text), expected, "{text:?}");
        }
        let open: Vec<_> = records(b"a,\"b\nc\nd").collect();
        let reason = open[0].1.as_ref().expect_err("open");
        assert!(reason.contains("the 2 lines behind it"), "{reason}");
    }
}
