//! Scores as JSON, one object per score.

use datasets_spec::record::ScoreRow;
use serde::Serialize;

use crate::Error;
use crate::judge::Judges;
use crate::table::{Standing, standings};

/// A row of the table of scores in its JSON form.
#[derive(Serialize)]
pub(super) struct Score<'a> {
    #[serde(flatten)]
    pub(super) row: &'a ScoreRow,
    #[serde(flatten)]
    pub(super) standing: Standing,
}

/// Writes an array with one object, on its own line, for each row of the table of scores. So the document can be parsed
/// whole or compared line by line.
///
/// # Errors
/// JSON cannot express a row.
pub fn render(scores: &[ScoreRow], judges: &Judges) -> Result<String, Error> {
    let mut text = "[".to_owned();
    let rows = scores.iter().zip(standings(scores, judges));
    for (index, (row, standing)) in rows.enumerate() {
        text.push_str(if index == 0 { "\n" } else { ",\n" });
        let score = Score { row, standing };
        let line = serde_json::to_string(&score)?;
        text.push_str(&line);
    }
    text.push_str("\n]\n");
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use serde_json::Value;

    use super::*;
    use crate::table::tests::sample_scores;

    /// Fields that readers of the document rely on; a new field changes the contract.
    const FIELDS: &str = "system task metric protocol encoder_hash n repeats mean ci95 takes targets \
                          sources instructions gallery ranked fid_items latent_width novelty \
                          items_digest ranks_systems behind_identity best";

    #[test]
    fn the_document_is_one_array_that_gives_the_rows_back() {
        let scores = sample_scores("semantic");
        let text = render(&scores, &Judges::new()).expect("serialisable");
        let read: Vec<BTreeMap<String, Value>> = serde_json::from_str(&text).expect("an array");
        assert_eq!(read.len(), scores.len());
        let standings = standings(&scores, &Judges::new());
        for ((read, row), standing) in read.iter().zip(&scores).zip(standings) {
            let fields: BTreeSet<&str> = read.keys().map(String::as_str).collect();
            assert_eq!(fields, FIELDS.split(' ').collect::<BTreeSet<_>>());
            for written in [serde_json::to_value(row), serde_json::to_value(standing)] {
                let written = written.expect("plain columns");
                for (name, written) in written.as_object().expect("an object") {
                    let found = &read[name];
                    match (found.as_f64(), written.as_f64()) {
                        // serde_json may parse a number with an error in the last bit.
                        (Some(a), Some(b)) => assert!((a - b).abs() <= f64::EPSILON * b.abs()),
                        _ => assert_eq!(found, written, "{name}"),
                    }
                }
            }
        }
        assert_eq!(text.lines().count(), scores.len() + 2);
        let none = render(&[], &Judges::new()).expect("serialisable");
        let none: Value = serde_json::from_str(&none).expect("JSON");
        assert_eq!(none, serde_json::json!([]));
    }
}
