//! Filters of clips: conditions on the metadata columns of the table of motions, written as in SQL.
//!
//! ```text
//! split = 'train' and not flags.poor_fit
//! n_frames >= 40 and (style in ('old', 'proud') or captions like '%walk%')
//! ```
//!
//! A missing value is as in SQL: a comparison with it is neither true nor false, and only clips for which
//! the whole condition is true are chosen. A test of a list holds if it holds for one of its texts.

mod clips;
mod columns;
mod grammar;

use std::collections::BTreeMap;
use std::str::FromStr;

use datasets_spec::table::ShardReader;

pub use self::clips::{Clips, Shard};
pub(crate) use self::clips::{Part, check_content};
use self::columns::{Column, Kind, Values};
use self::grammar::{Comparison, Expression, Test, Value};
use crate::Error;

/// A condition on clips.
#[derive(Clone, Debug, PartialEq)]
pub struct Filter {
    text: String,
    expression: Expression,
    columns: BTreeMap<String, Column>,
}

impl FromStr for Filter {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let refused = |(at, problem): (usize, String)| Error::Filter {
            text: text.to_owned(),
            at: text.get(..at).unwrap_or(text).chars().count() + 1,
            problem,
        };
        let mut expression = grammar::parse(text).map_err(refused)?;
        let mut columns = BTreeMap::new();
        bind(&mut expression, &mut columns).map_err(refused)?;
        Ok(Self {
            text: text.to_owned(),
            expression,
            columns,
        })
    }
}

impl Filter {
    /// The condition as it was written.
    pub fn text(&self) -> &str {
        &self.text
    }
}

/// Finds the columns of a condition, and brings its numbers to their precision.
fn bind(
    expression: &mut Expression,
    columns: &mut BTreeMap<String, Column>,
) -> Result<(), (usize, String)> {
    let (name, at, test) = match expression {
        Expression::All(inner) | Expression::Any(inner) => {
            return inner.iter_mut().try_for_each(|inner| bind(inner, columns));
        }
        Expression::Not(inner) => return bind(inner, columns),
        Expression::Test { column, at, test } => (column, *at, test),
    };
    let column = columns::find(name).map_err(|problem| (at, problem))?;
    columns.insert(name.clone(), column);
    let number = matches!(
        column.kind,
        Kind::Whole | Kind::Single | Kind::Seconds | Kind::MaxSpeed | Kind::FootSkate
    );
    let flag = matches!(column.kind, Kind::Flag(_));
    let is = match (flag, number) {
        (true, _) => "is true or false: write it alone, or after `not`",
        (false, true) => "holds numbers: compare it with one, such as 30",
        (false, false) => "holds texts: compare it with one in quotes, such as 'walk'",
    };
    let fits = match test {
        Test::Holds => flag,
        Test::IsNull => !flag,
        Test::Like(_) => !flag && !number,
        Test::Compare(_, value) => suits(value, flag, number),
        Test::In(values) => values.iter_mut().all(|value| suits(value, flag, number)),
    };
    match fits {
        true => Ok(()),
        false => Err((at, format!("column {name} {is}"))),
    }
}

/// Whether a value may be compared with a column. Single precision is that of the stored rates.
fn suits(value: &mut Value, flag: bool, number: bool) -> bool {
    match value {
        Value::Number(value) => {
            *value = f64::from(*value as f32);
            number
        }
        Value::Text(_) => !flag && !number,
    }
}

impl Filter {
    /// The rows of a shard for which the condition is true. Only the columns that it names are read.
    pub(crate) fn rows(&self, shard: &ShardReader) -> Result<Vec<usize>, Error> {
        let mut values = BTreeMap::new();
        for (name, column) in &self.columns {
            values.insert(name.as_str(), column.read(shard)?);
        }
        let rows = 0..shard.num_rows();
        Ok(rows
            .filter(|&row| holds(&self.expression, &values, row) == Some(true))
            .collect())
    }
}

/// Whether a condition holds for a row; none if that is not known.
fn holds(expression: &Expression, values: &BTreeMap<&str, Values>, row: usize) -> Option<bool> {
    let fold = |inner: &[Expression], decisive: bool| {
        let mut known = true;
        for expression in inner {
            match holds(expression, values, row) {
                Some(found) if found == decisive => return Some(decisive),
                Some(_) => {}
                None => known = false,
            }
        }
        known.then_some(!decisive)
    };
    match expression {
        Expression::All(inner) => fold(inner, false),
        Expression::Any(inner) => fold(inner, true),
        Expression::Not(inner) => holds(inner, values, row).map(|found| !found),
        Expression::Test { column, test, .. } => match values.get(column.as_str())? {
            Values::Truths(truths) => truths.get(row).copied(),
            Values::Numbers(numbers) => number_passes(test, numbers.get(row).copied()?),
            Values::Texts(texts) => texts_pass(test, texts.get(row)?),
        },
    }
}

fn number_passes(test: &Test, number: Option<f64>) -> Option<bool> {
    let compared = |comparison: Comparison, value: &Value| match value {
        Value::Number(value) => Some(ordered(comparison, number?.partial_cmp(value)?)),
        Value::Text(_) => None,
    };
    match test {
        Test::IsNull => Some(number.is_none()),
        Test::Compare(comparison, value) => compared(*comparison, value),
        Test::In(values) => {
            number?;
            let mut values = values.iter();
            Some(values.any(|value| compared(Comparison::Equal, value) == Some(true)))
        }
        Test::Like(_) | Test::Holds => None,
    }
}

fn texts_pass(test: &Test, texts: &[String]) -> Option<bool> {
    let compared = |text: &str, comparison: Comparison, value: &Value| match value {
        Value::Text(value) => ordered(comparison, text.cmp(value)),
        Value::Number(_) => false,
    };
    if *test == Test::IsNull {
        return Some(texts.is_empty());
    }
    let passes = |text: &String| match test {
        Test::Compare(comparison, value) => compared(text, *comparison, value),
        Test::In(values) => {
            let mut values = values.iter();
            values.any(|value| compared(text, Comparison::Equal, value))
        }
        Test::Like(pattern) => matches_pattern(text, pattern),
        Test::IsNull | Test::Holds => false,
    };
    (!texts.is_empty()).then(|| texts.iter().any(passes))
}

fn ordered(comparison: Comparison, order: std::cmp::Ordering) -> bool {
    match comparison {
        Comparison::Equal => order.is_eq(),
        Comparison::Unequal => order.is_ne(),
        Comparison::Less => order.is_lt(),
        Comparison::AtMost => order.is_le(),
        Comparison::Greater => order.is_gt(),
        Comparison::AtLeast => order.is_ge(),
    }
}

/// Whether a text is of a pattern, in which `%` stands for any characters and `_` for one.
fn matches_pattern(text: &str, pattern: &str) -> bool {
    let (text, pattern): (Vec<char>, Vec<char>) =
        (text.chars().collect(), pattern.chars().collect());
    // reached[i]: the pattern so far matches the first i characters.
    let mut reached = vec![false; text.len() + 1];
    reached[0] = true;
    for part in pattern {
        let mut next = vec![false; text.len() + 1];
        for at in 0..=text.len() {
            next[at] = match part {
                '%' => reached[at] || (at > 0 && next[at - 1]),
                part => at > 0 && reached[at - 1] && (part == '_' || part == text[at - 1]),
            };
        }
        reached = next;
    }
    reached[text.len()]
}

#[cfg(test)]
mod tests {
    use datasets_spec::Split;
    use datasets_spec::table::{Caption, Quality, write_rows};

    use super::*;
    use crate::check::FLAG_POOR_FIT;
    use crate::compose::fixture::{motion_row, wandering};

    /// The rows of four clips that a filter chooses.
    fn chosen(text: &str) -> Vec<usize> {
        let row = |id: &str, split, frames| motion_row(id, split, &wandering(id, frames));
        let mut rows = vec![
            row("a", Split::Train, 20),
            row("b", Split::Train, 30),
            row("c", Split::Val, 40),
            row("it's", Split::Test, 50),
        ];
        rows[1].quality = Quality {
            flags: FLAG_POOR_FIT,
            ..rows[1].quality
        };
        rows[1].style = Some("old".to_owned());
        rows[2].style = Some("proud".to_owned());
        rows[2].fps = 29.97;
        rows[2].captions = ["walk slowly", "go"]
            .map(|text| Caption {
                text: text.to_owned(),
                ..Caption::default()
            })
            .to_vec();
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("rows.parquet");
        let bytes = write_rows(Vec::new(), &path, &rows, &[]).expect("written");
        std::fs::write(&path, bytes).expect("written");
        let filter: Filter = text
            .parse()
            .unwrap_or_else(|error| panic!("{text}: {error}"));
        filter
            .rows(&ShardReader::open(&path).expect("opened"))
            .expect("read")
    }

    #[test]
    fn conditions_choose_rows() {
        for (text, rows) in [
            ("split = 'train' and not flags.poor_fit", &[0usize][..]),
            ("flags.poor-fit", &[1]),
            ("n_frames > 20 and n_frames <= 40", &[1, 2]),
            ("fps = 29.97", &[2]),
            ("seconds >= 1.5", &[1, 3]),
            ("captions like '%walk%'", &[2]),
            ("captions is null", &[0, 1, 3]),
            ("id in ('a', 'it''s')", &[0, 3]),
            ("id like '_'", &[0, 1, 2]),
            ("style = 'old' or split = \"test\"", &[1, 3]),
            // A missing style is neither old nor something else.
            ("not style = 'old'", &[2]),
            ("style != 'old'", &[2]),
            ("style is null or style != 'old'", &[0, 2, 3]),
            ("fit_error_m < 1 or id = 'c'", &[2]),
        ] {
            assert_eq!(chosen(text), rows, "{text}");
        }
    }

    #[test]
    fn mistakes_name_the_column_its_place_and_what_there_is() {
        for (text, said) in [
            (
                "split = 'train' and spilt = 'x'",
                "at character 21: there is no column \"spilt\"; the columns are id, split,",
            ),
            ("flags.slow", "flags.poor_fit"),
            ("transl is null", "there is no column \"transl\""),
            (
                "n_frames = 'x'",
                "at character 1: column n_frames holds numbers",
            ),
            ("split = 3", "column split holds texts"),
            ("flags.fast = 1", "column flags.fast is true or false"),
            ("split", "column split holds texts"),
            ("split = ", "expected a number, or a text in quotes"),
        ] {
            let error = text.parse::<Filter>().expect_err(text).to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
    }

    #[test]
    fn patterns_match_whole_texts() {
        for (text, pattern, matches) in [
            ("walk", "walk", true),
            ("walk", "wal", false),
            ("walk", "%al%", true),
            ("walk", "w__k", true),
            ("walk", "_", false),
            ("", "%", true),
            ("ab", "%b%b", false),
        ] {
            assert_eq!(matches_pattern(text, pattern), matches, "{text} {pattern}");
        }
    }
}
