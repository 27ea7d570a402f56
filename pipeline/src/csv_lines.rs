//! Line numbers of CSV files.

/// Line numbers by byte offset. The CSV reader's own count is wrong for CR LF and empty lines.
pub(crate) struct LineNumbers<'a> {
    text: &'a [u8],
    place: usize,
    line: u64,
}

impl<'a> LineNumbers<'a> {
    pub(crate) fn of(text: &'a [u8]) -> Self {
        Self {
            text,
            place: 0,
            line: 1,
        }
    }

    /// The line number of a record's start; offsets must ascend between calls.
    pub(crate) fn at(&mut self, position: Option<&csv::Position>) -> u64 {
        let byte = position.map_or(0, csv::Position::byte) as usize;
        while self.place < self.text.len()
            && (self.place < byte || matches!(self.text[self.place], b'\r' | b'\n'))
        {
            self.line += u64::from(self.text[self.place] == b'\n');
            self.place += 1;
        }
        self.line
    }
}
