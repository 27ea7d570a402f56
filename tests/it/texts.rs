//! A model is trained, and edits, with vectors of an external text encoder.

use std::fs;
use std::path::Path;

use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};

use crate::baselines::SMALL_TMED;
use crate::train::Workshop;
use crate::util::{Ran, arg, json_of, npy, put, stance, text_of, typed, typed_with};

const WIDTH: usize = 26;

/// Vectors of all texts of a dataset. The vector of a text holds the counts of its letters.
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
        let listed: Value = typed("--json model texts {}", &[&workshop.dataset()]).done();
        let texts = serde_json::from_value(listed["texts"].clone());
        let mut texts: Vec<String> = texts.expect("a list of texts");
        texts.extend(more.iter().map(|text| (*text).to_owned()));
        let list = json!({ "texts": texts }).to_string();
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
        let shape = format!("{}, {WIDTH}", values.len() / WIDTH);
        let bytes: Vec<u8> = values.iter().copied().flat_map(f32::to_le_bytes).collect();
        put(&vectors, npy("<f4", &shape, &bytes));
        let line = "model table {} {} --encoder letters --out {}";
        typed(line, &[&texts, &vectors, &out])
    }
}

/// Facts about the text encoder in the record of a run.
fn frozen(workshop: &Workshop, run: &str) -> Value {
    let record: Value = json_of(workshop.path(run).join("config.json"));
    record["config"]["text"]["frozen"].clone()
}

#[test]
fn a_table_of_vectors_goes_from_training_into_editing() {
    let workshop = Workshop::open();
    let dataset = workshop.dataset();
    let vectors = TextTable::of(&workshop);
    let lines = stance(&["model", "texts", arg(&dataset)]).printed();
    assert_eq!(lines.lines().collect::<Vec<_>>(), vectors.texts);
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
    let frozen = frozen(&workshop, "editor");
    assert_eq!(frozen["encoder_hash"], "letters");
    assert_eq!(frozen["width"], WIDTH);

    let run = workshop.path("editor");
    // A training that is refused leaves the vectors of the run as they are.
    let (part, vectors) = (workshop.path("part"), run.join("embeddings.safetensors"));
    let line = "dataset select {} --where {} --out {}";
    typed(line, &[&dataset, &"n_frames > 100", &part]).expect_code(0);
    let stored = fs::read(&vectors).expect("vectors");
    let line = "train motionrefit {} --out {} --steps 4";
    let told = ["--config", arg(&settings), "--text-encoder", arg(&table)];
    typed_with(line, &[&part, &run], &told).expect_refused("dataset_hash");
    assert!(fs::read(&vectors).expect("vectors") == stored);

    // The run stores the vectors of the dataset's instructions.
    let items = workshop.path("items");
    let line = "items {} --split val --count 3 --out {}";
    typed(line, &[&dataset, &items]).expect_code(0);
    let clip = workshop.clip();
    let items = ["--items", arg(&items)];
    let spin = ["--motion", arg(&clip), "--text", "Spin twice."];
    let edit = |out: &str, what: &[&str], table: Option<&str>| {
        let (out, table) = (workshop.path(out), table.map(|name| workshop.path(name)));
        let table = table.iter().flat_map(|path| ["--text-encoder", arg(path)]);
        let more = [what, &table.collect::<Vec<_>>()].concat();
        typed_with("edit {} --out {}", &[&run, &out], &more)
    };
    let refused = |what: &[&str], table: &str, why: &str| {
        edit("refused", what, Some(table)).expect_refused(why);
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
    // So it is by a run that begins with the weights; without a table that run takes the vectors of the first.
    let begin = |more: &[&str]| {
        let start = ["--config", arg(&settings), "--init", arg(&run)];
        workshop.train_with("motionrefit", "begun", &[&start, more].concat())
    };
    let other = workshop.path("other.safetensors");
    begin(&["--text-encoder", arg(&other)]).expect_refused("has another vector for");
    assert!(!workshop.path("begun").exists());
    begin(&["--steps", "2"]).expect_code(0);
}

/// Writes a DistilBERT of one layer, whose vocabulary is the letters. Its weights depend on `phase`.
fn write_distilbert(folder: &Path, phase: f32) {
    const WIDTH: usize = 8;
    let letters: Vec<String> = ('a'..='z').map(String::from).collect();
    let pieces: Vec<String> = letters.iter().map(|letter| format!("##{letter}")).collect();
    let special = ["[PAD]", "[UNK]", "[CLS]", "[SEP]"].map(str::to_owned);
    let vocabulary = [&special[..], &letters, &pieces].concat();
    let (square, row) = (vec![WIDTH, WIDTH], vec![WIDTH]);
    let (words, places) = (vec![vocabulary.len(), WIDTH], vec![32, WIDTH]);
    let mut shapes = vec![
        ("embeddings.word_embeddings.weight".to_owned(), words),
        ("embeddings.position_embeddings.weight".to_owned(), places),
        ("embeddings.LayerNorm.weight".to_owned(), row.clone()),
        ("embeddings.LayerNorm.bias".to_owned(), row.clone()),
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
        shapes.push((format!("transformer.layer.0.{part}.bias"), row.clone()));
    }
    let data = shapes.iter().enumerate().map(|(place, (_, shape))| {
        let count: usize = shape.iter().product();
        let values = (0..count).map(|i| (0.7 * i as f32 + place as f32 + phase).sin());
        values.flat_map(f32::to_le_bytes).collect()
    });
    let data: Vec<Vec<u8>> = data.collect();
    let views = shapes.iter().zip(&data).map(|((name, shape), data)| {
        let view = TensorView::new(Dtype::F32, shape.clone(), data).expect("fits");
        (name.as_str(), view)
    });
    let weights = safetensors::serialize(views, None).expect("serialises");
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

    let hash = |run: &str| -> String {
        let frozen = frozen(&workshop, run);
        frozen["encoder_hash"].as_str().expect("a hash").to_owned()
    };
    // Both hashes are of the same network: one run has a scaled vector for each text, the other one for each token.
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
        typed_with("edit {} --out {}", &[&run, &out], &[&spin, told].concat())
    };
    edit("never", &[]).expect_refused("--text-encoder");
    edit("spun", &told).expect_code(0);
}
