//! Words, keywords and numbers of a BVH file. Errors carry byte offsets.

use glam::DVec3;

use crate::source::names;
use clip::{Rejected, rejected};

pub(super) fn syntax(at: usize, reason: impl Into<String>) -> Rejected {
    Rejected::read("E-BVH-SYNTAX", reason).at(at)
}

/// The error about a word other than the expected one.
pub(super) fn unexpected(at: usize, word: &[u8], expected: &str) -> Rejected {
    syntax(at, format!("found {}, expected {expected}", shown(word)))
}

/// The text of a token for a message.
pub(super) fn shown(token: &[u8]) -> String {
    match token {
        b"" => "the end of the file".to_owned(),
        token => names::shown(token),
    }
}

pub(super) struct Cursor<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn skip_space(&mut self) {
        let rest = &self.bytes[self.at..];
        self.at += rest
            .iter()
            .take_while(|byte| byte.is_ascii_whitespace())
            .count();
    }

    /// The next word: a brace, or the text up to white space or a brace. Empty at the end.
    pub(super) fn word(&mut self) -> (usize, &'a [u8]) {
        self.skip_space();
        let rest = &self.bytes[self.at..];
        let len = match rest.first() {
            Some(b'{' | b'}') => 1,
            _ => rest
                .iter()
                .take_while(|&&byte| !byte.is_ascii_whitespace() && byte != b'{' && byte != b'}')
                .count(),
        };
        let start = self.at;
        self.at += len;
        (start, &rest[..len])
    }

    /// The rest of the line up to a brace, trimmed.
    pub(super) fn rest_of_line(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        let len = rest
            .iter()
            .take_while(|byte| !matches!(byte, b'\n' | b'\r' | b'{' | b'}'))
            .count();
        self.at += len;
        rest[..len].trim_ascii()
    }

    pub(super) fn expect(&mut self, expected: &str) -> Result<(), Rejected> {
        let (at, word) = self.word();
        match word.eq_ignore_ascii_case(expected.as_bytes()) {
            true => Ok(()),
            false => Err(unexpected(at, word, expected)),
        }
    }

    /// A keyword. Its colon, if it has one, may be missing, stand apart or touch the next word.
    pub(super) fn keyword(&mut self, expected: &str) -> Result<(), Rejected> {
        self.skip_space();
        let name = expected.trim_end_matches(':');
        let start = self.at;
        for part in name.split(' ') {
            self.skip_space();
            let rest = &self.bytes[self.at..];
            if rest.len() < part.len() || !rest[..part.len()].eq_ignore_ascii_case(part.as_bytes())
            {
                let (_, word) = self.word();
                return Err(unexpected(start, word, expected));
            }
            self.at += part.len();
        }
        if name.len() < expected.len() {
            self.skip_space();
            if self.bytes.get(self.at) == Some(&b':') {
                self.at += 1;
            }
        }
        Ok(())
    }

    pub(super) fn count(&mut self, expected: &str) -> Result<usize, Rejected> {
        let (at, word) = self.word();
        std::str::from_utf8(word)
            .ok()
            .and_then(|text| text.parse().ok())
            .ok_or_else(|| unexpected(at, word, expected))
    }

    pub(super) fn vector(&mut self) -> Result<DVec3, Rejected> {
        let mut vector = [0.0; 3];
        for value in &mut vector {
            let (at, word) = self.word();
            *value = parse_number(word).ok_or_else(|| number(at, word))?;
        }
        Ok(DVec3::from_array(vector))
    }
}

pub(super) fn number(at: usize, token: &[u8]) -> Rejected {
    let hint = if token.contains(&b',') {
        "; decimals are written with a point"
    } else {
        ""
    };
    rejected!(
        "E-BVH-NUMBER",
        "found {}, expected a finite number{hint}",
        shown(token)
    )
    .at(at)
}

/// Parses a decimal number, correctly rounded; `None` if the text is not a finite number.
pub(super) fn parse_number(token: &[u8]) -> Option<f64> {
    let number = fast_float2::parse::<f64, _>(token).ok();
    number.filter(|value| value.is_finite())
}
