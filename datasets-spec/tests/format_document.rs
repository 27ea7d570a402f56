//! Checks that the format document equals the code's schemas.

use datasets_spec::record::all_tables;
use datasets_spec::table::{Column, SCHEMA_VERSION};

fn listing(columns: &[Column]) -> String {
    let mut text =
        String::from("| column | type | null | unit | meaning |\n|---|---|---|---|---|\n");
    for column in columns {
        let null = if column.nullable { "yes" } else { "" };
        text += &format!(
            "| `{}` | {} | {null} | {} | {} |\n",
            column.name,
            column.type_name(),
            column.unit,
            column.doc
        );
    }
    text
}

#[test]
fn the_format_document_lists_every_table_and_column_as_it_is() {
    let document = include_str!("../docs/tables.md");
    for (table, columns) in all_tables() {
        let expected = format!("### `{table}`\n\n{}", listing(&columns));
        assert!(
            document.contains(&expected),
            "datasets-spec/docs/tables.md must hold this section:\n\n{expected}"
        );
    }
    assert!(document.contains(&format!("Schema version: **{SCHEMA_VERSION}**")));
    let listed = document.lines().filter(|line| line.starts_with("### `"));
    assert_eq!(listed.count(), all_tables().len());
}
