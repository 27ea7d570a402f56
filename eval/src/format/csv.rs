//! Scores as comma-separated values, one line per score.

use datasets_spec::record::ScoreRow;

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
        let ScoreRow {
            system,
            task,
            metric,
            protocol,
            encoder_hash,
            n,
            repeats,
            mean,
            ci95,
            takes,
            targets,
            sources,
            instructions,
            gallery,
            ranked,
            fid_items,
            latent_width,
            novelty,
            items_digest,
        } = row;
        let fields = [
            system.clone(),
            task.clone(),
            metric.clone(),
            protocol.clone(),
            encoder_hash.clone(),
            n.to_string(),
            repeats.to_string(),
            mean.to_string(),
            ci95.map_or_else(String::new, |ci95| ci95.to_string()),
            takes.to_string(),
            targets.to_string(),
            sources.to_string(),
            instructions.to_string(),
            gallery.to_string(),
            ranked.to_string(),
            fid_items.to_string(),
            latent_width.to_string(),
            novelty.clone(),
            items_digest.clone(),
            standing.ranks_systems.to_string(),
            standing.behind_identity.to_string(),
            standing.best.to_string(),
        ];
        text += &line(&fields);
    }
    text
}

/// A line of CSV with its line end. Cells with commas, quotation marks or line breaks are put in quotation marks.
pub fn line(cells: &[String]) -> String {
    let cells: Vec<String> = cells.iter().map(|cell| quoted(cell)).collect();
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
        let without = ScoreRow { ci95: None, ..row };
        assert_eq!(
            render(&[without], &Judges::new()),
            expected.replace(",0.1,0.001,", ",0.1,,")
        );
    }
}
