//! Conditions on clips.

use std::collections::BTreeSet;
use std::str::FromStr;

use datasets_spec::record::{MotionRow, all_tables};
use datasets_spec::table::{Row as _, read_column};
use datasets_spec::{Dataset, MotionId};

use crate::Error;
use crate::rewrite::{Names, check_columns, rewrite_condition};
use crate::scan::PLACE;
use crate::tables::{Tables, shortened};

/// A condition on the clips of a dataset: an expression of SQL over the columns of the table of motions. It may also
/// query the other tables, as in `id IN (SELECT motion_id FROM masks WHERE author = 'anna')`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Condition {
    text: String,
    sql: String,
}

impl FromStr for Condition {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let fails = |problem| Error::Sql {
            text: shortened(text),
            problem,
        };
        let mut names = Names::default();
        for (table, columns) in all_tables() {
            names.add(None, table, &columns);
        }
        let sql = rewrite_condition(text, &names).map_err(fails)?;
        check_columns(text, &names).map_err(fails)?;
        Ok(Self {
            text: text.to_owned(),
            sql,
        })
    }
}

impl Condition {
    /// The original text of the condition.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The condition in the SQL of polars, for a query of [`Tables`].
    pub fn sql(&self) -> &str {
        &self.sql
    }

    /// The dataset restricted to the clips for which the condition is true.
    ///
    /// # Errors
    /// As [`Condition::rows`].
    pub fn of(&self, dataset: &Dataset) -> Result<Dataset, Error> {
        let mut clips = BTreeSet::new();
        let files = dataset.files(MotionRow::TABLE, None);
        for ((path, _), rows) in files.iter().zip(self.rows(dataset)?) {
            let ids = read_column::<MotionRow, MotionId>(path, "id")?;
            clips.extend(rows.into_iter().filter_map(|row| ids.get(row).cloned()));
        }
        Ok(dataset.of_clips(&self.text, clips))
    }

    /// For each file of the table of motions, the places of the rows for which the condition is true. Only the columns
    /// that it names are read.
    ///
    /// # Errors
    /// A table cannot be read, or values cannot be compared as the condition does.
    pub fn rows(&self, dataset: &Dataset) -> Result<Vec<Vec<usize>>, Error> {
        let mut tables = Tables::new([(None, dataset)], true)?;
        let motions = MotionRow::TABLE;
        let query = format!("SELECT {PLACE} FROM {motions} WHERE {}", self.sql);
        let answer = tables.ask(&query).map_err(|error| match error {
            Error::Sql { problem, .. } => Error::Sql {
                text: shortened(&self.text),
                problem,
            },
            other => other,
        })?;
        let mut places = answer.places().into_iter().peekable();
        let mut rows = Vec::new();
        let mut start = 0;
        for (_, file) in dataset.files(motions, None) {
            let end = start + usize::try_from(file.rows).unwrap_or(usize::MAX);
            let mut of_file = Vec::new();
            while let Some(place) = places.next_if(|place| *place < end) {
                of_file.push(place - start);
            }
            rows.push(of_file);
            start = end;
        }
        Ok(rows)
    }
}

/// The dataset restricted to the clips for which a condition is true; the whole dataset without a condition.
///
/// # Errors
/// No clip fulfils it, or a table cannot be read.
pub fn chosen(dataset: &Dataset, condition: Option<&Condition>) -> Result<Dataset, Error> {
    let Some(condition) = condition else {
        return Ok(dataset.clone());
    };
    let chosen = condition.of(dataset)?;
    match chosen.num_chosen() {
        Some(0) => Err(Error::NoneChosen {
            path: dataset.root().to_owned(),
        }),
        _ => Ok(chosen),
    }
}
