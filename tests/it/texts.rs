//! A model is trained, and edits, with vectors of a text encoder that is not built in.

use std::fs;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use crate::train::Workshop;
use crate::util::{Ran, arg, stance};

const WIDTH: usize = 26;

#[derive(Deserialize)]
struct Listed {
    texts: Vec<String>,
}

/// Vectors of all texts of a dataset: how often each letter stands in each, an encoder that anybody can write.
pub(crate) struct TextTable<'a> {
    workshop: &'a Workshop,
    pub(crate) texts: Vec<String>,
    pub(crate) values: Vec<f32>,
}

impl<'a> TextTable<'a> {
    pub(crate) fn of(workshop: &'a Workshop) -> Self {
        Self::with(workshop, &[])
    }

    /// Vectors of further texts too.
    fn with(workshop: &'a Workshop, more: &[&str]) -> Self {
        let listed = stance(&["--json", "model", "texts", arg(&workshop.dataset())]).expect_code(0);
        let Listed { mut texts } = listed.json();
        texts.extend(more.iter().map(|text| (*text).to_owned()));
        let list = serde_json::json!({ "texts": texts }).to_string();
        fs::write(workshop.path("texts.json"), list).expect("writes");
        let count = |text: &String, letter: u8| {
            let letters = text.bytes().map(|byte| byte.to_ascii_lowercase());
            letters.filter(|&byte| byte == letter).count() as f32
        };
        let values = texts
            .iter()
            .flat_map(|text| (b'a'..=b'z').map(move |letter| count(text, letter)));
        Self {
            workshop,
            values: values.collect(),
            texts,
        }
    }

    /// Makes a table of the vectors times a number.
    pub(crate) fn write(&self, name: &str, scale: f32) -> Ran {
        let values: Vec<f32> = self.values.iter().map(|value| scale * value).collect();
        self.make(name, &values)
    }

    fn make(&self, name: &str, values: &[f32]) -> Ran {
        let path = |name: &str| self.workshop.path(name);
        let (texts, vectors, out) = (path("texts.json"), path("vectors.npy"), path(name));
        write_npy(&vectors, values);
        let made = ["model", "table", arg(&texts), arg(&vectors)];
        stance(&[&made[..], &["--encoder", "letters", "--out", arg(&out)]].concat())
    }
}

/// A NumPy file of format 1.0.
fn write_npy(path: &Path, values: &[f32]) {
    let rows = values.len() / WIDTH;
    let shape = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {WIDTH}), }}");
    // Magic, version, length and header together fill a multiple of 64 bytes.
    let header = format!("{shape:<117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    fs::write(path, bytes).expect("writes");
}

#[test]
fn a_table_of_vectors_goes_from_training_into_editing() {
    let workshop = Workshop::open();
    let dataset = workshop.dataset();
    let vectors = TextTable::of(&workshop);
    let lines = stance(&["model", "texts", arg(&dataset)]).expect_code(0);
    assert_eq!(lines.stdout.lines().collect::<Vec<_>>(), vectors.texts);
    vectors.write("letters.safetensors", 1.0).expect_code(0);
    let short = vectors.make("short.safetensors", &vectors.values[WIDTH..]);
    let said = short.expect_code(1).stderr;
    assert!(said.contains("no row for each"), "{said}");

    let small = fs::read_to_string(workshop.path("small.toml")).expect("settings");
    let settings = workshop.path("table.toml");
    fs::write(&settings, format!("text.encoder = \"table\"\n{small}")).expect("writes");
    let table = workshop.path("letters.safetensors");
    let train = |model: &str, more: &[&str]| {
        let settings = ["--config", arg(&settings), "--steps", "4"];
        workshop.train_with(model, "editor", &[&settings, more].concat())
    };
    let unnamed = train("motionrefit", &[]).expect_code(1);
    assert!(
        unnamed.stderr.contains("--text-encoder"),
        "{}",
        unnamed.stderr
    );
    train("motionrefit", &["--text-encoder", arg(&table)]).expect_code(0);
    let alone = workshop.path("tmed.toml");
    fs::write(&alone, "text.encoder = \"table\"\n").expect("writes");
    let told = ["--config", arg(&alone), "--text-encoder", arg(&table)];
    let tokens = workshop.train_with("tmed", "tmed", &told);
    let said = tokens.expect_code(1).stderr;
    assert!(said.contains("TMED reads tokens"), "{said}");
    let record = fs::read_to_string(workshop.path("editor/config.json")).expect("a record");
    let record: Value = serde_json::from_str(&record).expect("JSON");
    let frozen = &record["config"]["text"]["frozen"];
    assert_eq!(frozen["encoder_hash"], "letters");
    assert_eq!(frozen["width"], WIDTH);

    // The run keeps the vectors of the instructions of the dataset.
    let items = workshop.path("items");
    let draw = ["items", arg(&dataset), "--split", "val", "--count", "3"];
    stance(&[&draw[..], &["--out", arg(&items)]].concat()).expect_code(0);
    let run = workshop.path("editor");
    let clip = workshop.clip();
    let items = ["--items", arg(&items)];
    let spin = ["--motion", arg(&clip), "--text", "Spin twice."];
    let edit = |out: &str, what: &[&str], table: Option<&str>| {
        let (out, table) = (workshop.path(out), table.map(|name| workshop.path(name)));
        let mut args = vec!["edit", arg(&run), "--out", arg(&out)];
        args.extend(what);
        args.extend(table.iter().flat_map(|path| ["--text-encoder", arg(path)]));
        stance(&args)
    };
    let refused = |what: &[&str], table: &str, why: &str| {
        let said = edit("refused", what, Some(table)).expect_code(1).stderr;
        assert!(said.contains(why), "{said}");
    };
    edit("edits", &items, None).expect_code(0);
    refused(&spin, "letters.safetensors", "\"Spin twice.\"");
    let vectors = TextTable::with(&workshop, &["Spin twice."]);
    vectors.write("more.safetensors", 1.0).expect_code(0);
    edit("spun", &spin, Some("more.safetensors")).expect_code(0);
    // Another encoder under the same name.
    vectors.write("other.safetensors", 2.0).expect_code(0);
    refused(&spin, "other.safetensors", "has another vector for");
    refused(&items, "other.safetensors", "has another vector for");
}
