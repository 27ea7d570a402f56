//! Rows of the tables of a version.

use std::collections::BTreeMap;

use datasets_spec::manifest::Manifest;

/// Rows of each table.
pub(super) fn rows_of(manifest: &Manifest) -> BTreeMap<String, u64> {
    let tables = manifest.tables.keys();
    tables
        .map(|table| (table.clone(), manifest.rows(table, None)))
        .collect()
}
