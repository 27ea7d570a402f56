//! Captions in text files.

use datasets_spec::table::Caption;

use crate::sidecar::caption;
use crate::source::head::refuse_pointer;

/// Maximum length of a caption line in bytes.
const MAX_LINE_BYTES: usize = 1000;
/// Maximum number of captions of one file; further lines count as no captions.
const MAX_CAPTIONS: usize = 1000;

/// Parses one caption per line, and returns the numbers of the other lines, from 1. A line is a text about the whole clip, or
/// HumanML3D's `caption#lemma/POS lemma/POS#start#end` with times in seconds. A time that is not a number is read as 0,
/// which is how the published loader reads the `nan` that some of the files contain.
///
/// # Source
/// HumanML3D's text format.
pub fn parse_captions(text: &str) -> (Vec<Caption>, Vec<usize>) {
    let mut captions = Vec::new();
    let mut others = Vec::new();
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    for (number, line) in (1..).zip(lines).filter(|(_, line)| !line.is_empty()) {
        match parse_line(line) {
            Some(caption) if captions.len() < MAX_CAPTIONS => captions.push(caption),
            _ => others.push(number),
        }
    }
    (captions, others)
}

/// The captions of a file beside a motion, and what of it cannot be used.
pub(super) fn captions_beside(bytes: &[u8]) -> (Vec<Caption>, Option<String>) {
    if let Err(rejected) = refuse_pointer(bytes) {
        return (Vec::new(), Some(rejected.reason));
    }
    let (captions, others) = parse_captions(&String::from_utf8_lossy(bytes));
    let problem = match others[..] {
        [] => None,
        [line] => Some(format!("line {line}: it is no caption")),
        [line, ..] => {
            let count = others.len();
            Some(format!(
                "line {line}: it is the first of {count} lines that are no captions"
            ))
        }
    };
    (captions, problem)
}

fn parse_line(line: &str) -> Option<Caption> {
    // The caption itself may contain a hash sign; the last three fields may not.
    let mut fields = line.rsplitn(4, '#');
    let (Some(to), Some(from), Some(tokens), Some(text)) =
        (fields.next(), fields.next(), fields.next(), fields.next())
    else {
        let is_foreign = |c: char| c.is_control() || c == char::REPLACEMENT_CHARACTER;
        let is_text = line.len() <= MAX_LINE_BYTES
            && line.chars().any(char::is_alphabetic)
            && !line.chars().any(is_foreign);
        return is_text.then(|| caption(line));
    };
    if text.trim().is_empty() {
        return None;
    }
    let (from_s, to_s) = (from.trim().parse::<f32>(), to.trim().parse::<f32>());
    let finite = |seconds: f32| if seconds.is_finite() { seconds } else { 0.0 };
    Some(Caption {
        text: text.trim().to_owned(),
        tokens: tokens.trim().to_owned(),
        from_s: finite(from_s.ok()?),
        to_s: finite(to_s.ok()?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captions_keep_their_tokens_and_times_and_plain_lines_count() {
        let (captions, others) = parse_captions(
            "\u{feff}a man kicks.#a/DET man/NOUN kick/VERB#0.0#0.0\r\n\
             take step #2#take/VERB#1.5#nan\n\na man kicks twice, as in take #1\nbad#times#a#b\n\
             12 34.5\n\u{fffd}PNG\n # x/DET#0#0\n",
        );
        assert_eq!(others, [5, 6, 7, 8]);
        assert_eq!(captions[0].text, "a man kicks.");
        assert_eq!(captions.len(), 3);
        assert_eq!(captions[0].tokens, "a/DET man/NOUN kick/VERB");
        assert_eq!(captions[1].text, "take step #2");
        assert_eq!((captions[1].from_s, captions[1].to_s), (1.5, 0.0));
        assert_eq!(captions[2].text, "a man kicks twice, as in take #1");
        assert_eq!((captions[2].from_s, captions[2].to_s), (0.0, 0.0));
    }
}
