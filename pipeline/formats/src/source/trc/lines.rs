//! The lines of the text, and their cells.

use crate::source::head::UTF8_BOM;

/// A line of the text.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    /// Position of the line in the file.
    pub(super) at: usize,
    pub(super) text: &'a [u8],
    /// Whether a line break follows.
    pub(super) is_whole: bool,
}

impl<'a> Line<'a> {
    /// The trimmed cells of the line, with their byte offsets in the file. Tabs separate cells, or blanks in a line
    /// without tabs.
    pub(super) fn cells(&self) -> Vec<(usize, &'a [u8])> {
        let is_tabbed = self.text.contains(&b'\t');
        let mut cells = Vec::new();
        let mut start = 0;
        let ends = self.text.iter().enumerate();
        let ends = ends.filter(|(_, byte)| match is_tabbed {
            true => **byte == b'\t',
            false => byte.is_ascii_whitespace(),
        });
        for end in ends.map(|(end, _)| end).chain([self.text.len()]) {
            let cell = &self.text[start..end];
            let skipped = cell.len() - cell.trim_ascii_start().len();
            let cell_at = self.at + start + skipped;
            start = end + 1;
            if is_tabbed || !cell.is_empty() {
                cells.push((cell_at, cell.trim_ascii()));
            }
        }
        cells
    }
}

/// The lines of a file that are not blank.
pub(super) struct Lines<'a> {
    pub(super) bytes: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    pub(super) fn of(bytes: &'a [u8]) -> Self {
        let at = bytes.strip_prefix(UTF8_BOM).map_or(0, |_| UTF8_BOM.len());
        Self { bytes, at }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        while self.at < self.bytes.len() {
            let rest = &self.bytes[self.at..];
            let end = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
            let line = Line {
                at: self.at,
                text: &rest[..end.unwrap_or(rest.len())],
                is_whole: end.is_some(),
            };
            self.at += line.text.len() + 1;
            if !line.text.trim_ascii().is_empty() {
                return Some(line);
            }
        }
        None
    }
}
