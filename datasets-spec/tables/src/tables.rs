//! Queries over the tables of datasets.

use datasets_spec::Dataset;
use datasets_spec::record::{MotionRow, all_tables};
use datasets_spec::table::Row as _;
use polars::sql::SQLContext;

use crate::rewrite::{Names, problem_of, rewrite_query};
use crate::scan::Scan;
use crate::{Answer, Error};

/// The tables of one dataset by their names, or of several as `NAME.TABLE`.
pub struct Tables {
    context: SQLContext,
    names: Names,
}

impl Tables {
    /// The tables of a dataset. No rows are read before a query needs them.
    ///
    /// # Errors
    /// A table of this version cannot be registered, which means a bug.
    pub fn of(dataset: &Dataset) -> Result<Self, Error> {
        Self::new([(None, dataset)], false)
    }

    /// The tables of several datasets, each with a name.
    ///
    /// # Errors
    /// As [`Tables::of`].
    pub fn of_several(datasets: &[(String, Dataset)]) -> Result<Self, Error> {
        let named = datasets.iter();
        Self::new(
            named.map(|(name, dataset)| (Some(name.as_str()), dataset)),
            false,
        )
    }

    /// The tables of datasets, each with a name if there are several. `with_places` adds a column of row numbers to the
    /// motions.
    pub(crate) fn new<'a>(
        datasets: impl IntoIterator<Item = (Option<&'a str>, &'a Dataset)>,
        with_places: bool,
    ) -> Result<Self, Error> {
        let mut tables = Self {
            context: SQLContext::new(),
            names: Names::default(),
        };
        for (name, dataset) in datasets {
            for (table, columns) in all_tables() {
                let fails = |problem: String| Error::Sql {
                    text: table.to_owned(),
                    problem,
                };
                let with_places = with_places && table == MotionRow::TABLE;
                let full = tables.names.add(name, table, &columns);
                let scan = Scan::new(dataset, table, columns, with_places).map_err(fails)?;
                let frame = scan.frame().map_err(|error| fails(error.to_string()))?;
                tables.context.register(&full, frame);
            }
        }
        Ok(tables)
    }

    /// Answers a `SELECT`. Only the columns that it names are read.
    ///
    /// # Errors
    /// The query cannot be understood, names an unknown table or column, or a table cannot be read.
    pub fn ask(&mut self, query: &str) -> Result<Answer, Error> {
        let fails = |problem: String| Error::Sql {
            text: shortened(query),
            problem,
        };
        let rewritten = rewrite_query(query, &self.names).map_err(fails)?;
        let frame = self.context.execute(&rewritten);
        let answer = frame.and_then(polars::prelude::LazyFrame::collect);
        match answer {
            Ok(frame) => Ok(Answer::new(frame)),
            Err(error) => Err(fails(problem_of(&rewritten, &error, &self.names))),
        }
    }
}

/// The beginning of a query, for errors.
pub(crate) fn shortened(text: &str) -> String {
    const SHOWN: usize = 200;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
