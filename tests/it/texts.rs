//! A model is trained, and edits, with vectors of an external text encoder.

use std::fs;
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{ItemRow, MaskRow};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};

use crate::baselines::SMALL_TMED;
use crate::train::Workshop;
use crate::util::{Ran, commit, put};

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
        let listed: Value = workshop.json("model texts @dataset");
        let texts = serde_json::from_value(listed["texts"].clone());
        let mut texts: Vec<String> = texts.expect("a list of texts");
        texts.extend(more.iter().map(|text| (*text).to_owned()));
        let list = json!({ "texts": texts }).to_string();
        workshop.put("texts.json", list);
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
        let vectors = pickle::npy::encode(&[values.len() / WIDTH, WIDTH], values);
        self.workshop.put("vectors.npy", vectors);
        let line = "model table @texts.json @vectors.npy --encoder letters";
        self.workshop.typed(&format!("{line} --out @{name}"))
    }
}

#[test]
fn the_list_has_the_texts_of_all_items_even_if_the_training_split_has_no_masks() {
    let workshop = Workshop::open();
    let mut masks: Vec<MaskRow> = workshop.rows("dataset");
    masks.retain(|row| row.split == Split::Test);
    commit(
        &workshop.path("dataset"),
        &masks,
        |row| row.split,
        "only test",
    );
    workshop.run("items @dataset --split test --count all --out @items");
    let texts = TextTable::of(&workshop).texts;
    for item in workshop.rows::<ItemRow>("items") {
        assert!(texts.contains(&item.instruction), "{}", item.instruction);
    }
}

/// Facts about the text encoder in the record of a run.
fn frozen(workshop: &Workshop, run: &str) -> Value {
    workshop.record(run)["config"]["text"]["frozen"].clone()
}

#[test]
fn a_table_of_vectors_goes_from_training_into_editing() {
    let workshop = Workshop::open();
    let vectors = TextTable::of(&workshop);
    let lines = workshop.run("model texts @dataset").stdout;
    assert_eq!(lines.lines().collect::<Vec<_>>(), vectors.texts);
    vectors.write("letters.safetensors", 1.0).expect_code(0);
    let short = vectors.make("short.safetensors", &vectors.values[WIDTH..]);
    short.expect_refused("no row for each");

    let small = workshop.text("small.toml");
    let settings = format!("text.encoder = \"table\"\n{small}");
    workshop.put("table.toml", settings);
    let table = "--text-encoder @letters.safetensors";
    let train = |more: &str| {
        let line = "train motionrefit @dataset --out @editor --config @table.toml --steps 4";
        workshop.typed(&format!("{line} {more}"))
    };
    train("").expect_refused("--text-encoder");
    train(table).expect_code(0);
    // Settings and runs that learn their words would ignore the table.
    let learned = format!("train motionrefit @dataset --out @learned {table}");
    let why = "text.encoder is learned, which makes no use of --text-encoder";
    workshop.refused(&learned, why);
    assert!(!workshop.path("learned").exists());
    workshop.put("tmed.toml", "text.encoder = \"table\"\n");
    let tokens = format!("train tmed @dataset --out @tmed --config @tmed.toml {table}");
    workshop.refused(&tokens, "TMED reads tokens");
    let frozen = frozen(&workshop, "editor");
    assert_eq!(frozen["encoder_hash"], "letters");
    assert_eq!(frozen["width"], WIDTH);

    // A training that is refused leaves the vectors of the run as they are.
    workshop.run("dataset select @dataset --where 'n_frames > 100' --out @part");
    let stored = || fs::read(workshop.path("editor/embeddings.safetensors")).expect("vectors");
    let before = stored();
    let of_part = "train motionrefit @part --out @editor --config @table.toml --steps 4";
    workshop.refused(&format!("{of_part} {table}"), "dataset_hash");
    assert!(stored() == before);

    // The run stores the vectors of the dataset's instructions.
    workshop.run("items @dataset --split val --count 3 --out @items");
    let items = "--items @items";
    let spin = "--motion @walk.bvh --text 'Spin twice.'";
    let edit = |more: &str| workshop.typed(&format!("edit @editor {more}"));
    let refused = |what: &str, table: &str, why: &str| {
        edit(&format!("{what} --out @refused --text-encoder @{table}")).expect_refused(why);
    };
    edit(&format!("{items} --out @edits")).expect_code(0);
    refused(spin, "letters.safetensors", "\"Spin twice.\"");
    let vectors = TextTable::with(&workshop, &["Spin twice."]);
    vectors.write("more.safetensors", 1.0).expect_code(0);
    let spun = "--out @spun --text-encoder @more.safetensors";
    edit(&format!("{spin} {spun}")).expect_code(0);
    // Another encoder under the same name is refused.
    vectors.write("other.safetensors", 2.0).expect_code(0);
    let differs = "has another vector for";
    refused(spin, "other.safetensors", differs);
    refused(items, "other.safetensors", differs);
    // So it is by a run that begins with the weights; without a table that run takes the vectors of the first.
    let begin = "train motionrefit @dataset --out @begun --config @table.toml --init @editor";
    let other = format!("{begin} --text-encoder @other.safetensors");
    workshop.refused(&other, differs);
    assert!(!workshop.path("begun").exists());
    workshop.run(&format!("{begin} --steps 2"));
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
    workshop.run("model encoder --package @package --out @encoder");

    let small = workshop.text("small.toml");
    let train_into = |run: &str, model: &str, settings: &str, told: &str| {
        workshop.put(&format!("{run}.toml"), settings);
        let line = format!("train {model} @dataset --out @{run} --config @{run}.toml --steps 4");
        workshop.typed(&format!("{line} {told}"))
    };
    let train = |model: &str, settings: &str, told: &str| train_into(model, model, settings, told);
    let told = "--text-encoder @encoder";
    let editor = format!("text.encoder = \"bert\"\n{small}");
    train("motionrefit", &editor, "").expect_refused("--text-encoder");
    let states = format!("text.vectors = \"states\"\n{editor}");
    train("motionrefit", &states, told).expect_refused("one vector for each token");
    train("motionrefit", &editor, told).expect_code(0);
    let tokens = format!("text.encoder = \"bert\"\n{SMALL_TMED}");
    train("tmed", &tokens, told).expect_code(0);
    // A run that begins with the weights takes the vectors of the first, and needs no encoder.
    train_into("begun", "tmed", &tokens, "--init @tmed").expect_code(0);

    let hash = |run: &str| -> String {
        let frozen = frozen(&workshop, run);
        frozen["encoder_hash"].as_str().expect("a hash").to_owned()
    };
    // Both hashes are of the same network: one run has a scaled vector for each text, the other one for each token.
    let (pooled, states) = (hash("motionrefit"), hash("tmed"));
    let network = pooled.strip_prefix("rms10-");
    assert_eq!(network, states.strip_prefix("tokens-"));
    assert_eq!(hash("begun"), states);

    // Vectors left by a training that failed at its start are not mistaken for those of another encoder.
    write_distilbert(&path("other"), 0.5);
    let anew = path("anew");
    fs::create_dir_all(&anew).expect("made");
    let vectors = "embeddings.safetensors";
    fs::copy(path("motionrefit").join(vectors), anew.join(vectors)).expect("copied");
    let told_other = "--text-encoder @other";
    train_into("anew", "motionrefit", &editor, told_other).expect_code(0);
    assert_ne!(hash("anew"), pooled);
    assert!(hash("anew").starts_with("rms10-"));

    // An instruction that training has not shown needs the encoder.
    let edit = "edit @motionrefit --motion @walk.bvh --text 'Spin twice.' --out";
    let untold = format!("{edit} @never");
    workshop.refused(&untold, "--text-encoder");
    workshop.run(&format!("{edit} @spun {told}"));
    // One that does not exist is not passed over because the run has the vectors already.
    workshop.run("items @dataset --split val --count 1 --out @items");
    let items = "edit @motionrefit --items @items --out @edits --text-encoder";
    workshop.refused(&format!("{items} @nowhere"), "nowhere");
    workshop.run(&format!("{items} @encoder"));
}
