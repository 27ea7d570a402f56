//! Croissant metadata: machine-readable descriptions of a dataset's files and fields.
//!
//! # Source
//! MLCommons Croissant 1.0.

use serde_json::{Value, json};

use crate::license::licenses;
use crate::manifest::Manifest;
use crate::record::all_tables;
use crate::table::Column;

pub(crate) const FILE: &str = "croissant.json";
/// A table with more files than this is described by a path pattern instead of a list of its files.
const MOST_FILES: usize = 100;

/// The text of a dataset's metadata, made from its manifest only.
pub(crate) fn text(manifest: &Manifest) -> String {
    let mut distribution = Vec::new();
    let mut record_sets = Vec::new();
    for (table, columns) in all_tables() {
        let Some(files) = manifest.tables.get(table) else {
            continue;
        };
        let files: Vec<_> = files.iter().filter(|file| file.rows > 0).collect();
        if files.is_empty() {
            continue;
        }
        let pattern = files.len() > MOST_FILES || files.iter().any(|file| file.sha256.is_empty());
        if pattern {
            let id = format!("{table}-files");
            distribution.push(json!({
                "@type": "cr:FileSet",
                "@id": id,
                "name": id,
                "encodingFormat": "application/x-parquet",
                "includes": format!("data/{table}/*.parquet"),
            }));
            let source = json!({ "fileSet": { "@id": id } });
            record_sets.push(record_set(table, table, &columns, &source));
            continue;
        }
        for file in files {
            distribution.push(json!({
                "@type": "cr:FileObject",
                "@id": file.path,
                "name": file.path,
                "contentUrl": file.path,
                "contentSize": format!("{} B", file.bytes),
                "encodingFormat": "application/x-parquet",
                "sha256": file.sha256,
            }));
            // A Croissant field refers to one file, so every file has its own record set.
            let id = file
                .path
                .trim_start_matches("data/")
                .trim_end_matches(".parquet");
            let source = json!({ "fileObject": { "@id": file.path } });
            record_sets.push(record_set(id, table, &columns, &source));
        }
    }
    let mut document = json!({
        "@context": context(),
        "@type": "sc:Dataset",
        "name": "motion-dataset",
        "description": format!(
            "Human motion as SMPL-X parameters on skeleton {}, y up, metres, radians.",
            manifest.skeleton
        ),
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "version": format!("{}.0.0", manifest.version),
        "distribution": distribution,
        "recordSet": record_sets,
    });
    let licenses: Vec<String> = licenses(manifest)
        .into_keys()
        .filter(|tag| !tag.is_empty())
        .map(|tag| license_url(&tag))
        .collect();
    if !licenses.is_empty() {
        document["license"] = json!(licenses);
    }
    let mut text = serde_json::to_string_pretty(&document).unwrap_or_default();
    text.push('\n');
    text
}

/// URL of an SPDX licence; the tag itself for other licences.
fn license_url(tag: &str) -> String {
    let is_of_identifier = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '+' | '-');
    match !tag.starts_with("LicenseRef-") && tag.chars().all(is_of_identifier) {
        true => format!("https://spdx.org/licenses/{tag}.html"),
        false => tag.to_owned(),
    }
}

fn record_set(id: &str, table: &str, columns: &[Column], source: &Value) -> Value {
    // Croissant cannot express lists of structures; readers find those columns in the Parquet schema.
    let (hidden, shown): (Vec<&Column>, Vec<&Column>) = columns
        .iter()
        .partition(|column| column.type_name().contains("struct"));
    let fields: Vec<Value> = shown
        .into_iter()
        .map(|column| field(id, column, source))
        .collect();
    let mut description = format!("Rows of table {table}.");
    if !hidden.is_empty() {
        let names: Vec<&str> = hidden.iter().map(|column| column.name).collect();
        description += &format!(
            " The files also have these columns of structures, which this format cannot describe: {}.",
            names.join(", ")
        );
    }
    json!({
        "@type": "cr:RecordSet",
        "@id": id,
        "name": id,
        "description": description,
        "field": fields,
    })
}

fn field(set: &str, column: &Column, source: &Value) -> Value {
    let kind = column.type_name();
    let data_type = if kind.contains("f32") || kind.contains("f64") {
        "sc:Float"
    } else if kind.contains("utf8") {
        "sc:Text"
    } else {
        "sc:Integer"
    };
    let mut description = column.doc.to_owned();
    if !column.unit.is_empty() {
        description += &format!(" [{}]", column.unit);
    }
    let mut field = json!({
        "@type": "cr:Field",
        "@id": format!("{set}/{}", column.name),
        "name": column.name,
        "description": description,
        "dataType": data_type,
        "source": source,
    });
    field["source"]["extract"] = json!({ "column": column.name });
    let width = kind
        .strip_prefix("list<fixed_size_list<f32, ")
        .and_then(|rest| rest.strip_suffix(">>"));
    if let Some(width) = width {
        field["isArray"] = json!(true);
        field["arrayShape"] = json!(format!("-1,{width}"));
    } else if kind.starts_with("list<") {
        field["repeated"] = json!(true);
    }
    field
}

fn context() -> Value {
    json!({
        "@language": "en",
        "@vocab": "https://schema.org/",
        "citeAs": "cr:citeAs",
        "column": "cr:column",
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "data": { "@id": "cr:data", "@type": "@json" },
        "dataType": { "@id": "cr:dataType", "@type": "@vocab" },
        "dct": "http://purl.org/dc/terms/",
        "equivalentProperty": "cr:equivalentProperty",
        "examples": { "@id": "cr:examples", "@type": "@json" },
        "extract": "cr:extract",
        "field": "cr:field",
        "fileProperty": "cr:fileProperty",
        "fileObject": "cr:fileObject",
        "fileSet": "cr:fileSet",
        "format": "cr:format",
        "includes": "cr:includes",
        "isArray": "cr:isArray",
        "arrayShape": "cr:arrayShape",
        "isLiveDataset": "cr:isLiveDataset",
        "jsonPath": "cr:jsonPath",
        "key": "cr:key",
        "md5": "cr:md5",
        "parentField": "cr:parentField",
        "path": "cr:path",
        "recordSet": "cr:recordSet",
        "references": "cr:references",
        "regex": "cr:regex",
        "repeated": "cr:repeated",
        "replace": "cr:replace",
        "sc": "https://schema.org/",
        "separator": "cr:separator",
        "source": "cr:source",
        "subField": "cr:subField",
        "transform": "cr:transform",
    })
}
