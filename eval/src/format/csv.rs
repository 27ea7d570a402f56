//! Scores as comma-separated values, one line per score.

use datasets_spec::record::ScoreRow;
use serde_json::Value;

use super::json::Score;
use crate::judge::Judges;
use crate::table::standings;

const HEAD: &str = "system,task,metric,protocol,encoder_hash,n,repeats,mean,ci95,\
                    takes,targets,sources,instructions,gallery,ranked,fid_items,latent_width,\
                    novelty,items_digest,ranks_systems,behind_identity,best";

/// Writes the rows of the table of scores with a header line, as RFC 4180 but with Unix line ends.
/// Numbers keep all their digits.
pub fn render(scores: &[ScoreRow], judges: &Judges) -> String {
    let mut text = format!("{HEAD}\n");
    for (row, standing) in scores.iter().zip(standings(scores, judges)) {
        let score = serde_json::to_value(Score { row, standing }).expect("plain columns");
        let field = |name: &str| match &score[name] {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            // JSON writes `1.0` where the shortest form is `1`.
            Value::Number(number) if number.is_f64() => {
                number.as_f64().unwrap_or(f64::NAN).to_string()
            }
            other => other.to_string(),
        };
        let fields: Vec<String> = HEAD.split(',').map(field).collect();
        text += &line(&fields);
    }
    text
}

/// A line of CSV with its line end. Cells with commas, quotation marks or line breaks are put in quotation marks.
pub fn line(cells: &[impl AsRef<str>]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| quoted(cell.as_ref())).collect();
    cells.join(",") + "\n"
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::fid::FID;
    use crate::table::tests::score_row;

    #[test]
    fn fields_that_hold_separators_are_quoted() {
        let row = score_row("style", "a \"b\", c", &FID, 0.1);
        let expected = format!(
            "{HEAD}\n\"a \"\"b\"\", c\",style,FID,\"galleries of 32, seed 0\",0123456789abcdef,512,10,\
             0.1,0.001,1,29,400,61,32,512,256,64,,a1b2c3d4e5f6,true,false,true\n"
        );
        assert_eq!(render(std::slice::from_ref(&row), &Judges::new()), expected);
        let score = Score {
            row: &row,
            standing: crate::table::Standing::default(),
        };
        let score = serde_json::to_value(score).expect("plain columns");
        // No column is left out.
        let fields = score.as_object().expect("an object");
        assert_eq!(HEAD.split(',').count(), fields.len());
        let without = render(&[ScoreRow { ci95: None, ..row }], &Judges::new());
        assert_eq!(without, expected.replace(",0.1,0.001,", ",0.1,,"));
    }
}
