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
    use serde::Deserialize;

    use super::*;
    use crate::names::{IDENTITY, REAL_DATA};
    use crate::table::tests::sample_scores;

    /// Fields that readers of the document rely on; a new field changes the contract.
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Read {
        system: String,
        task: String,
        metric: String,
        protocol: String,
        encoder_hash: String,
        n: u32,
        repeats: u32,
        mean: f64,
        ci95: Option<f64>,
        takes: u32,
        targets: u32,
        sources: u32,
        instructions: u32,
        gallery: u32,
        ranked: u32,
        fid_items: u32,
        latent_width: u32,
        novelty: String,
        items_digest: String,
        ranks_systems: bool,
        behind_identity: bool,
        best: bool,
    }

    #[test]
    fn the_document_is_one_array_that_gives_the_rows_back() {
        let scores = sample_scores("semantic");
        let text = render(&scores, &Judges::new()).expect("serialisable");
        let read: Vec<Read> = serde_json::from_str(&text).expect("an array");
        assert_eq!(read.len(), scores.len());
        // serde_json may parse a number with an error in the last bit.
        let same = |a: f64, b: f64| (a - b).abs() <= f64::EPSILON * b.abs();
        for (read, row) in read.iter().zip(&scores) {
            assert_eq!(
                (&read.system, &read.task, &read.metric, &read.protocol),
                (&row.system, &row.task, &row.metric, &row.protocol)
            );
            assert_eq!(
                (&read.encoder_hash, read.n, read.repeats),
                (&row.encoder_hash, row.n, row.repeats)
            );
            let ci95 = [read.ci95, row.ci95].map(|ci95| ci95.expect("measured"));
            assert!(same(read.mean, row.mean) && same(ci95[0], ci95[1]));
            assert_eq!(
                (read.takes, read.targets, read.sources, read.instructions),
                (row.takes, row.targets, row.sources, row.instructions)
            );
            assert_eq!(
                (read.gallery, read.ranked, read.fid_items, read.latent_width),
                (row.gallery, row.ranked, row.fid_items, row.latent_width)
            );
            assert_eq!(
                (&read.novelty, &read.items_digest),
                (&row.novelty, &row.items_digest)
            );
            // The sample system is better than identity only in Multimodality.
            let is_last = row.system == "MotionReFit tiny";
            let is_given = [REAL_DATA, IDENTITY].contains(&row.system.as_str());
            let is_behind = !is_given && is_last == (row.metric != "Multimodality");
            assert!(read.ranks_systems);
            assert_eq!(read.behind_identity, is_behind, "{row:?}");
            // The other system is best in every metric except Multimodality.
            let is_best = row.system == "ours_100%|<b>" && row.metric != "Multimodality"
                || is_last && row.metric == "Multimodality";
            assert_eq!(read.best, is_best, "{row:?}");
        }
        assert_eq!(text.lines().count(), scores.len() + 2);
        let none = render(&[], &Judges::new()).expect("serialisable");
        let none: Vec<Read> = serde_json::from_str(&none).expect("an array");
        assert!(none.is_empty());
    }
}
