//! A model is trained, and edits, with vectors of an external text encoder.

use std::fs;
use std::path::Path;

use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::baselines::SMALL_TMED;
use crate::train::Workshop;
use crate::util::{Ran, arg, put, stance, text_of, typed};

const WIDTH: usize = 26;

#[derive(Deserialize)]
struct Listed {
    texts: Vec<String>,
}

/// Vectors of all texts of a dataset: the counts of letters in each text, an encoder that anybody can write.
pub(crate) struct TextTable<'a> {
    workshop: &'a Workshop,
    pub(crate) texts: Vec<String>,
    pub(crate) values: Vec<f32>,
}

impl<'a> TextTable<'a> {
    pub(crate) fn of(workshop: &'a Workshop) -> Self {
        Self::with(workshop, &[])
    }

    /// The table with vectors of further texts.
    fn with(workshop: &'a Workshop, more: &[&str]) -> Self {
        let listed = stance(&["--json", "model", "texts", arg(&workshop.dataset())]).expect_code(0);
        let Listed { mut texts } = listed.json();
        texts.extend(more.iter().map(|text| (*text).to_owned()));
        let list = serde_json::json!({ "texts": texts }).to_string();
        put(workshop.path("texts.json"), list);
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

    /// Makes a table of the vectors times `scale`.
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

/// Writes a NumPy file of format 1.0.
fn write_npy(path: &Path, values: &[f32]) {
    let rows = values.len() / WIDTH;
    let shape = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {WIDTH}), }}");
    // Magic, version, length and header together fill a multiple of 64 bytes.
    let header = format!("{shape:<117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    put(path, bytes);
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
    short.expect_refused("no row for each");

    let small = text_of(workshop.path("small.toml"));
    let settings = workshop.path("table.toml");
    put(&settings, format!("text.encoder = \"table\"\n{small}"));
    let table = workshop.path("letters.safetensors");
    let train = |model: &str, more: &[&str]| {
        let settings = ["--config", arg(&settings), "--steps", "4"];
        workshop.train_with(model, "editor", &[&settings, more].concat())
    };
    train("motionrefit", &[]).expect_refused("--text-encoder");
    train("motionrefit", &["--text-encoder", arg(&table)]).expect_code(0);
    let alone = workshop.path("tmed.toml");
    put(&alone, "text.encoder = \"table\"\n");
    let told = ["--config", arg(&alone), "--text-encoder", arg(&table)];
    let tokens = workshop.train_with("tmed", "tmed", &told);
    tokens.expect_refused("TMED reads tokens");
    let record = text_of(workshop.path("editor/config.json"));
    let record: Value = serde_json::from_str(&record).expect("JSON");
    let frozen = &record["config"]["text"]["frozen"];
    assert_eq!(frozen["encoder_hash"], "letters");
    assert_eq!(frozen["width"], WIDTH);

    // The run stores the vectors of the dataset's instructions.
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
        let said = edit("refused", what, Some(table)).refusal();
        assert!(said.contains(why), "{said}");
    };
    edit("edits", &items, None).expect_code(0);
    refused(&spin, "letters.safetensors", "\"Spin twice.\"");
    let vectors = TextTable::with(&workshop, &["Spin twice."]);
    vectors.write("more.safetensors", 1.0).expect_code(0);
    edit("spun", &spin, Some("more.safetensors")).expect_code(0);
    // Another encoder under the same name is refused.
    vectors.write("other.safetensors", 2.0).expect_code(0);
    refused(&spin, "other.safetensors", "has another vector for");
    refused(&items, "other.safetensors", "has another vector for");
}

/// Writes a DistilBERT of one layer, whose vocabulary is the letters. Its weights depend on `phase`.
fn write_distilbert(folder: &Path, phase: f32) {
    const WIDTH: usize = 8;
    let letters: Vec<String> = ('a'..='z').map(String::from).collect();
    let pieces: Vec<String> = letters.iter().map(|letter| format!("##{letter}")).collect();
    let special = ["[PAD]", "[UNK]", "[CLS]", "[SEP]"].map(str::to_owned);
    let vocabulary = [&special[..], &letters, &pieces].concat();
    let (square, row) = (vec![WIDTH, WIDTH], vec![WIDTH]);
    let mut shapes = vec![
        (
            "embeddings.word_embeddings.weight".to_owned(),
            vec![vocabulary.len(), WIDTH],
        ),
        (
            "embeddings.position_embeddings.weight".to_owned(),
            vec![32, WIDTH],
        ),
        ("embeddings.LayerNorm.weight".to_owned(), vec![WIDTH]),
        ("embeddings.LayerNorm.bias".to_owned(), vec![WIDTH]),
    ];
    for (part, shape) in [
        ("attention.q_lin", &square),
        ("attention.k_lin", &square),
        ("attention.v_lin", &square),
        ("attention.out_lin", &square),
        ("sa_layer_norm", &row),
        ("ffn.lin1", &square),
        ("ffn.lin2", &square),
        ("output_layer_norm", &row),
    ] {
        shapes.push((format!("transformer.layer.0.{part}.weight"), shape.clone()));
        shapes.push((format!("transformer.layer.0.{part}.bias"), vec![WIDTH]));
    }
    let data: Vec<Vec<u8>> = shapes
        .iter()
        .enumerate()
        .map(|(place, (_, shape))| {
            let count: usize = shape.iter().product();
            let values = (0..count).map(|i| (0.7 * i as f32 + place as f32 + phase).sin());
            values.flat_map(f32::to_le_bytes).collect()
        })
        .collect();
    let views = shapes.iter().zip(&data).map(|((name, shape), data)| {
        let view = TensorView::new(Dtype::F32, shape.clone(), data).expect("fits");
        (name.as_str(), view)
    });
    let weights = safetensors::serialize(views, None).expect("serialises");
    fs::create_dir_all(folder).expect("made");
    put(folder.join("model.safetensors"), weights);
    put(folder.join("vocab.txt"), vocabulary.join("\n"));
    let config = json!({
        "model_type": "distilbert", "vocab_size": vocabulary.len(), "max_position_embeddings": 32,
        "dim": WIDTH, "n_layers": 1, "n_heads": 2, "hidden_dim": WIDTH, "activation": "gelu",
    });
    put(folder.join("config.json"), config.to_string());
}

#[test]
fn an_encoder_of_a_package_tells_one_model_texts_and_another_tokens() {
    let workshop = Workshop::open();
    let path = |name: &str| workshop.path(name);
    write_distilbert(&path("package/model"), 0.0);
    let (package, encoder) = (path("package"), path("encoder"));
    typed("model encoder --package {} --out {}", &[&package, &encoder]).expect_code(0);

    let small = text_of(path("small.toml"));
    let train_into = |run: &str, model: &str, settings: &str, told: &[&str]| {
        let config = path(&format!("{run}.toml"));
        put(&config, settings);
        let settings = ["--config", arg(&config), "--steps", "4"];
        workshop.train_with(model, run, &[&settings, told].concat())
    };
    let train =
        |model: &str, settings: &str, told: &[&str]| train_into(model, model, settings, told);
    let told = ["--text-encoder", arg(&encoder)];
    let editor = format!("text.encoder = \"bert\"\n{small}");
    train("motionrefit", &editor, &[]).expect_refused("--text-encoder");
    let states = format!("text.vectors = \"states\"\n{editor}");
    train("motionrefit", &states, &told).expect_refused("one vector for each token");
    train("motionrefit", &editor, &told).expect_code(0);
    let tokens = format!("text.encoder = \"bert\"\n{SMALL_TMED}");
    train("tmed", &tokens, &told).expect_code(0);

    let hash = |run: &str| {
        let record = text_of(path(run).join("config.json"));
        let record: Value = serde_json::from_str(&record).expect("JSON");
        let hash = &record["config"]["text"]["frozen"]["encoder_hash"];
        hash.as_str().expect("a hash").to_owned()
    };
    // The same network gives one vector scaled to a length, and one for each token.
    let (pooled, states) = (hash("motionrefit"), hash("tmed"));
    assert_eq!(
        pooled.strip_prefix("rms10-"),
        states.strip_prefix("tokens-")
    );

    // Vectors left by a training that failed at its start are not mistaken for those of another encoder.
    let other = path("other");
    write_distilbert(&other, 0.5);
    let anew = path("anew");
    fs::create_dir_all(&anew).expect("made");
    let vectors = "embeddings.safetensors";
    fs::copy(path("motionrefit").join(vectors), anew.join(vectors)).expect("copied");
    let told_other = ["--text-encoder", arg(&other)];
    train_into("anew", "motionrefit", &editor, &told_other).expect_code(0);
    assert_ne!(hash("anew"), pooled);
    assert!(hash("anew").starts_with("rms10-"));

    // An instruction that training has not shown needs the encoder.
    let (run, clip) = (path("motionrefit"), workshop.clip());
    let edit = |out: &str, told: &[&str]| {
        let out = path(out);
        let spin = ["--motion", arg(&clip), "--text", "Spin twice."];
        let args = [&["edit", arg(&run), "--out", arg(&out)][..], &spin, told].concat();
        stance(&args)
    };
    edit("never", &[]).expect_refused("--text-encoder");
    edit("spun", &told).expect_code(0);
}
