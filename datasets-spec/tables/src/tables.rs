//! Queries over the tables of datasets.

use datasets_spec::Dataset;
use datasets_spec::record::{MotionRow, all_tables};
use datasets_spec::table::Row as _;
use polars::prelude::{DataFrame, PolarsResult, SortMultipleOptions};
use polars::sql::SQLContext;

use crate::rewrite::{Names, Order, Rewritten, problem_of, rewrite_query};
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

    /// Answers a `SELECT`. Only the columns that it names are read. Rows of a query that groups or joins are sorted by
    /// their columns where its `ORDER BY` does not tell them apart, since polars returns them in no fixed order.
    ///
    /// # Errors
    /// The query cannot be understood, names an unknown table or column, or takes a part of rows in no fixed order, or a
    /// table cannot be read.
    pub fn ask(&mut self, query: &str) -> Result<Answer, Error> {
        let fails = |problem: String| Error::Sql {
            text: shortened(query),
            problem,
        };
        let rewritten = rewrite_query(query, &self.names).map_err(fails)?;
        let answer = match rewritten.order {
            Order::Fixed => self.collect(&rewritten.text),
            Order::Partial => self.collect_ordered(&rewritten),
            Order::None => self
                .collect(&rewritten.text)
                .and_then(|frame| sorted(&frame)),
        };
        match answer {
            Ok(frame) => Ok(Answer::new(frame)),
            Err(error) => Err(fails(problem_of(&rewritten.text, &error, &self.names))),
        }
    }

    fn collect(&mut self, text: &str) -> PolarsResult<DataFrame> {
        self.context.execute(text)?.collect()
    }

    /// The rows of a query that orders them, and those that are equal in its order by their other columns.
    fn collect_ordered(&mut self, query: &Rewritten) -> PolarsResult<DataFrame> {
        let schema = self.context.execute(&query.text)?.collect_schema()?;
        let columns = schema.iter().filter(|(_, dtype)| !dtype.is_nested());
        let names: Vec<&str> = columns.map(|(name, _)| name.as_str()).collect();
        // Polars may refuse a column, such as one that both tables of a join have. Then the query's own order must do.
        self.collect(&query.ordered_by(&names))
            .or_else(|_| self.collect(&query.text))
    }
}

/// The rows sorted by all columns but lists and structs, which have no order.
fn sorted(frame: &DataFrame) -> PolarsResult<DataFrame> {
    let columns = frame.columns().iter();
    let columns = columns.filter(|column| !column.dtype().is_nested());
    let names = columns.map(|column| column.name());
    frame.sort(
        names,
        SortMultipleOptions::default().with_maintain_order(true),
    )
}

/// The beginning of a query, for errors.
pub(crate) fn shortened(text: &str) -> String {
    const SHOWN: usize = 200;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
