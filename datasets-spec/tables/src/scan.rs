//! The scan by which polars reads a table of a dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use arrow_schema::DataType;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Column, RecordBatch, Row as _, ShardReader};
use datasets_spec::{Dataset, MotionId};
use polars::prelude as pl;
use rayon::prelude::*;

use crate::arrays::{polars_type, series};
use crate::derived::Derived;

/// Column with the row number, for [`crate::Condition`]. Queries do not use this name by chance.
pub(crate) const PLACE: &str = "__place";

pub(crate) struct Scan {
    dataset: Dataset,
    files: Vec<PathBuf>,
    stored: BTreeMap<&'static str, DataType>,
    schema: pl::SchemaRef,
}

impl Scan {
    /// The scan of a table; for motions, with the derived columns.
    pub(crate) fn new(
        dataset: &Dataset,
        table: &'static str,
        columns: Vec<Column>,
        with_places: bool,
    ) -> Result<Self, String> {
        let mut schema = pl::Schema::default();
        for column in &columns {
            schema.insert(column.name.into(), polars_type(&column.data_type)?);
        }
        if table == MotionRow::TABLE {
            for derived in Derived::ALL {
                schema.insert(derived.name().into(), polars_type(&derived.data_type())?);
            }
        }
        if with_places {
            schema.insert(PLACE.into(), pl::DataType::UInt32);
        }
        let files = dataset.files(table, None).into_iter();
        Ok(Self {
            dataset: dataset.clone(),
            files: files.map(|(path, _)| path).collect(),
            stored: columns
                .into_iter()
                .map(|column| (column.name, column.data_type))
                .collect(),
            schema: Arc::new(schema),
        })
    }

    pub(crate) fn frame(self) -> pl::PolarsResult<pl::LazyFrame> {
        let schema = Some(Arc::clone(&self.schema));
        let args = pl::ScanArgsAnonymous {
            schema,
            name: "DATASET",
            ..pl::ScanArgsAnonymous::default()
        };
        pl::LazyFrame::anonymous_scan(Arc::new(self), args)
    }

    fn read(&self, names: &[&str]) -> Result<pl::DataFrame, String> {
        let derived = names.iter().filter(|name| !self.stored.contains_key(*name));
        let derived: Vec<Derived> = derived.filter_map(|name| Derived::of_name(name)).collect();
        let mut wanted: BTreeSet<&str> = derived
            .iter()
            .flat_map(|derived| derived.needs())
            .copied()
            .collect();
        wanted.extend(names.iter().filter(|name| self.stored.contains_key(*name)));
        let wanted: Vec<&str> = wanted.into_iter().collect();
        let beside = derived
            .into_iter()
            .map(|derived| Ok((derived, derived.beside(&self.dataset)?)))
            .collect::<Result<Vec<_>, datasets_spec::Error>>()
            .map_err(|error| error.to_string())?;
        let mut parts = self
            .files
            .par_iter()
            .map(|path| {
                let shard = ShardReader::open(path).map_err(|error| error.to_string())?;
                let batches = shard.batches(&wanted).map_err(|error| error.to_string())?;
                batches
                    .iter()
                    .map(|batch| self.part(batch, names, &beside))
                    .collect::<Result<Vec<_>, String>>()
            })
            .collect::<Result<Vec<_>, String>>()?
            .into_iter()
            .flatten();
        let fails = |error: pl::PolarsError| error.to_string();
        let empty = || {
            let stored = names.iter().filter(|name| **name != PLACE);
            let fields = stored.filter_map(|name| {
                let data_type = self.schema.get(name)?.clone();
                Some(pl::Field::new((*name).into(), data_type))
            });
            pl::DataFrame::empty_with_schema(&fields.collect::<pl::Schema>())
        };
        let mut whole = parts.next().unwrap_or_else(empty);
        for part in parts {
            whole.vstack_mut(&part).map_err(fails)?;
        }
        if names.contains(&PLACE) {
            let height = u32::try_from(whole.height()).map_err(|error| error.to_string())?;
            let places = pl::UInt32Chunked::from_vec(PLACE.into(), (0..height).collect());
            whole
                .with_column(pl::IntoColumn::into_column(pl::IntoSeries::into_series(
                    places,
                )))
                .map_err(fails)?;
        }
        Ok(whole)
    }

    fn part(
        &self,
        batch: &RecordBatch,
        names: &[&str],
        beside: &[(Derived, BTreeSet<MotionId>)],
    ) -> Result<pl::DataFrame, String> {
        let mut columns = Vec::new();
        for name in names.iter().filter(|name| **name != PLACE) {
            let derived = beside.iter().find(|(derived, _)| derived.name() == *name);
            let made = match (batch.column_by_name(name), derived) {
                (Some(array), None) => {
                    // The types may differ in their nullability.
                    if let Some(expected) = self.stored.get(*name)
                        && polars_type(expected) != polars_type(array.data_type())
                    {
                        return Err(format!(
                            "column {name} is {}, not {expected}",
                            array.data_type()
                        ));
                    }
                    Some(series(name, array.as_ref())?)
                }
                (_, Some((derived, ids))) => {
                    let array = derived.of(batch, ids);
                    array.map(|array| series(name, &array)).transpose()?
                }
                (None, None) => None,
            };
            // Files of earlier formats lack columns.
            let missing = || {
                let data_type = self.schema.get(name).cloned().unwrap_or(pl::DataType::Null);
                pl::Series::full_null((*name).into(), batch.num_rows(), &data_type)
            };
            columns.push(pl::IntoColumn::into_column(made.unwrap_or_else(missing)));
        }
        pl::DataFrame::new(batch.num_rows(), columns).map_err(|error| error.to_string())
    }
}

impl pl::AnonymousScan for Scan {
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }

    fn allows_projection_pushdown(&self) -> bool {
        true
    }

    fn scan(&self, args: pl::AnonymousScanArgs) -> pl::PolarsResult<pl::DataFrame> {
        let names: Vec<&str> = match &args.with_columns {
            Some(names) => names.iter().map(|name| name.as_str()).collect(),
            None => self.schema.iter_names().map(|name| name.as_str()).collect(),
        };
        let whole = self
            .read(&names)
            .map_err(|problem| pl::PolarsError::ComputeError(problem.into()))?;
        Ok(match args.n_rows {
            Some(rows) => whole.head(Some(rows)),
            None => whole,
        })
    }
}
