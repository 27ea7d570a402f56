//! Scores as comma-separated values, one line for each.

use datasets_spec::record::ScoreRow;

/// Writes the rows of the table of scores with a head line, after RFC 4180 but for the line ends,
/// which are those of Unix. Numbers keep all their digits.
pub fn render(scores: &[ScoreRow]) -> String {
    let mut text = "system,task,metric,protocol,encoder_hash,n,repeats,mean,ci95\n".to_owned();
    for row in scores {
        let fields = [
            quoted(&row.system),
            quoted(&row.task),
            quoted(&row.metric),
            quoted(&row.protocol),
            quoted(&row.encoder_hash),
            row.n.to_string(),
            row.repeats.to_string(),
            row.mean.to_string(),
            row.ci95.to_string(),
        ];
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}

pub(super) fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::Metric;
    use crate::table::tests::score_row;

    #[test]
    fn fields_that_hold_separators_are_quoted() {
        let row = score_row("style", "a \"b\", c", Metric::FidUnit, 0.1);
        assert_eq!(
            render(&[row]),
            "system,task,metric,protocol,encoder_hash,n,repeats,mean,ci95\n\
             \"a \"\"b\"\", c\",style,FID,\"galleries of 32, seed 0\",0123456789abcdef,512,10,0.1,0.001\n"
        );
    }
}
