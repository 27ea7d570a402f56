//! CSV files that people write: the records with the numbers of their lines.

use csv::{Position, ReaderBuilder, StringRecord, Trim};

/// The records of a file in UTF-8, each with the number of its line and with trimmed fields. A record in another
/// encoding is a reason to refuse the line.
pub(crate) fn records(bytes: &[u8]) -> impl Iterator<Item = (u64, Result<StringRecord, String>)> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(text);
    let mut lines = LineNumbers {
        text,
        place: 0,
        line: 1,
    };
    reader.into_records().map(move |record| match record {
        Ok(record) => (lines.at(record.position()), Ok(record)),
        Err(error) => {
            let reason = "it is not UTF-8 text; save the file as UTF-8".to_owned();
            (lines.at(error.position()), Err(reason))
        }
    })
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
