//! `captions.csv`: labels of single clips of a folder, one line each.

use csv::StringRecord;
use datasets_spec::table::Caption;

use crate::csv_lines;
use crate::sidecar::{Content, LabelCaption, Sidecar};

/// Columns of a file; only the first is needed.
const COLUMNS: [&str; 10] = [
    "clip", "text", "from_s", "to_s", "tokens", "subject", "action", "style", "split", "license",
];

/// Parses a UTF-8 file with a header line. Unusable lines are reported; the others are used.
pub(super) fn parse(bytes: &[u8]) -> Content {
    let mut content = Content::default();
    let mut records = csv_lines::records(bytes);
    let header = match records.next() {
        Some((_, Ok(header))) => header,
        Some((line, Err(reason))) => {
            content.problems.push(format!("line {line}: {reason}"));
            return content;
        }
        None => return content,
    };
    let columns: Vec<String> = header.iter().map(str::to_lowercase).collect();
    if !columns.iter().any(|column| column == COLUMNS[0]) {
        content.problems.push(format!(
            "its header line names no column clip, so no line was used; it may name {}",
            COLUMNS.join(", ")
        ));
        return content;
    }
    let unknown = columns
        .iter()
        .filter(|column| !COLUMNS.contains(&column.as_str()));
    let unknown: Vec<&str> = unknown.map(String::as_str).collect();
    if !unknown.is_empty() {
        content.problems.push(format!(
            "columns {} are not known and were passed over; known are {}",
            unknown.join(", "),
            COLUMNS.join(", ")
        ));
    }
    for (line, record) in records {
        match record.and_then(|record| labels(&columns, &record)) {
            Ok((name, mut labels)) => {
                let problems = &mut content.problems;
                labels.clean(|reason| problems.push(format!("line {line}: {reason}")));
                content.clips.push((Some(line), name, labels));
            }
            Err(reason) => content.problems.push(format!("line {line}: {reason}")),
        }
    }
    content
}

fn labels(columns: &[String], record: &StringRecord) -> Result<(String, Sidecar), String> {
    if record.len() > columns.len() {
        return Err(format!(
            "it has {} fields, the header {}; quote a text with commas",
            record.len(),
            columns.len()
        ));
    }
    let field = |name: &str| {
        let place = columns.iter().position(|column| column == name)?;
        record.get(place).filter(|field| !field.is_empty())
    };
    let seconds = |name: &str| match field(name).map(str::parse::<f32>) {
        None => Ok(0.0),
        Some(Ok(seconds)) => Ok(seconds),
        Some(Err(_)) => Err(format!("{name} is no number of seconds")),
    };
    let name = field("clip").ok_or("it names no clip")?;
    let split = field("split").map(|split| split.to_lowercase().parse());
    let owned = |name: &str| field(name).map(str::to_owned);
    let (from_s, to_s) = (seconds("from_s")?, seconds("to_s")?);
    let caption = owned("text").map(|text| {
        LabelCaption::from(Caption {
            text,
            tokens: owned("tokens").unwrap_or_default(),
            from_s,
            to_s,
        })
    });
    let labels = Sidecar {
        captions: caption.into_iter().collect(),
        subject: owned("subject"),
        action: owned("action"),
        style: owned("style"),
        split: split
            .transpose()
            .map_err(|error: datasets_spec::Error| error.to_string())?,
        license: owned("license"),
        ..Sidecar::default()
    };
    Ok((name.to_owned(), labels))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_labels_or_problems_with_their_number() {
        let content = parse(
            "\u{feff}Clip,text,from_s,to_s,split,note\r\n\
             walk,a person walks,,,train,x\n\
             \n\
             walk,\"a person turns, slowly\",1.5,2,,\n\
             run,a person runs,soon,,,\n\
             jump,,,,everything,\n\
             ,a person sits,,,,\n\
             hop,a,b,c,d,e,f\n"
                .as_bytes(),
        );
        let used: Vec<(Option<u64>, &str)> = content
            .clips
            .iter()
            .map(|(line, name, _)| (*line, name.as_str()))
            .collect();
        assert_eq!(used, [(Some(2), "walk"), (Some(4), "walk")]);
        let caption = &content.clips[1].2.captions[0].caption;
        assert_eq!(caption.text, "a person turns, slowly");
        let expected = [
            "note",
            "line 5: from_s",
            "line 6:",
            "line 7: it names no clip",
            "line 8: it has 7",
        ];
        let problems = &content.problems;
        assert_eq!(problems.len(), expected.len(), "{problems:?}");
        for (problem, part) in problems.iter().zip(expected) {
            assert!(problem.contains(part), "{part}: {problem}");
        }
    }

    #[test]
    fn a_file_of_another_kind_is_named_and_not_used() {
        let content = parse(b"file,caption\nwalk,a person walks\n");
        assert!(content.clips.is_empty());
        let problem = &content.problems[0];
        assert!(problem.contains("no column clip"), "{problem}");
    }
}
