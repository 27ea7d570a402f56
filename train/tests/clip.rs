//! CLIP as a text encoder: parity with the reference, all file formats, and tables.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use datasets_spec::Seed;
use remote_store::hub::HubCache;
use safetensors::SafeTensors;
use train::Error;
use train::config::BertVectors;
use train::model::clip::{ClipConfig, ClipText};
use train::model::torch::{StateDictOptions, state_dict_from_torch};
use train::model::weights::{draw, to_safetensors};
use train::text::FrozenText;
use train::text::clip::{ClipEncoder, ClipFiles, ClipModel};
use train::text::table::EmbeddingTable;
use train::text::tokens::ClipTokenizer;
use train::vocabulary::TokenBatch;
use zip::write::SimpleFileOptions;

use crate::golden::{Golden, check};
use crate::shared::{Weights, as_safetensors, le_bytes, refused};

/// Tolerance that the recording states for single precision.
const TOLERANCE: f32 = 5e-5;

fn golden_config(golden: &Golden) -> ClipConfig {
    ClipConfig {
        num_tokens: golden.size("vocab_size"),
        context: golden.values("in.ids_zero_pad").1[1],
        width: golden.size("hidden_size"),
        num_layers: golden.size("num_hidden_layers"),
        num_heads: golden.size("num_attention_heads"),
        feed_forward: golden.size("intermediate_size"),
        projection: golden.size("projection_dim"),
        end_token: golden.size("eos_token_id"),
    }
}

fn golden_network(golden: &Golden, config: &ClipConfig) -> ClipText {
    let (bytes, path) = (golden.bytes(), &golden.0.path);
    ClipText::from_safetensors(config, &bytes, "weights.", path, &Device::flex())
        .expect("loads by name")
}

fn ids(golden: &Golden, name: &str) -> TokenBatch {
    let (values, shape) = golden.values(name);
    TokenBatch {
        ids: values.iter().map(|&id| id as i32).collect(),
        width: shape[1],
    }
}

#[test]
fn golden_clip_text() {
    let golden = Golden::read("clip_text");
    let config = golden_config(&golden);
    let network = golden_network(&golden, &config);
    assert_eq!(network.width(), config.projection);

    for case in ["zero_pad", "end_pad"] {
        let tokens = ids(&golden, &format!("in.ids_{case}"));
        let name = format!("out.{case}.last_hidden_state");
        let recorded = golden.values(&name).1[1];
        let hidden = network.hidden(&tokens).narrow(1, 0, recorded);
        check(hidden, &golden, &name, TOLERANCE);
        let name = format!("out.{case}.text_embeds");
        check(network.forward(&tokens), &golden, &name, TOLERANCE);
    }
    let end_pad = ids(&golden, "in.ids_end_pad");
    // The reference masks padding here, which changes nothing: padding comes after the end token, and causal attention
    // looks back only.
    let hidden = network.hidden(&end_pad);
    let pooled = network.project(hidden.clone(), &end_pad);
    let name = "out.end_pad_masked.text_embeds";
    check(pooled, &golden, name, TOLERANCE);
    // The vectors of padding tokens are recorded as zeros.
    let kept = golden.tensor::<2>("in.attention_mask");
    let masked = hidden * kept.unsqueeze_dim::<3>(2);
    let name = "out.end_pad_masked.last_hidden_state";
    check(masked, &golden, name, TOLERANCE);
}

#[test]
fn golden_clip_text_does_not_depend_on_what_follows_the_end() {
    let golden = Golden::read("clip_text");
    let config = golden_config(&golden);
    let whole = ids(&golden, "in.ids_zero_pad");
    let lengths = golden.lengths("in.attention_mask");
    let width = lengths.into_iter().max().expect("rows");
    let rows = whole.ids.chunks_exact(whole.width);
    let cut = TokenBatch {
        ids: rows.flat_map(|row| row[..width].to_vec()).collect(),
        width,
    };
    let name = "out.zero_pad.text_embeds";
    let found = golden_network(&golden, &config).forward(&cut);
    check(found, &golden, name, TOLERANCE);
    // Old configurations record 2 as the end token; for them the largest number is the end token.
    let legacy = ClipConfig {
        end_token: 2,
        ..config
    };
    let network = golden_network(&golden, &legacy);
    check(network.forward(&whole), &golden, name, TOLERANCE);
    let end_pad = network.forward(&ids(&golden, "in.ids_end_pad"));
    check(end_pad, &golden, "out.end_pad.text_embeds", TOLERANCE);
}

#[test]
fn golden_clip_tokens() {
    let Some(path) = std::env::var_os("STANCE_CLIP_TOKENIZER").map(PathBuf::from) else {
        skipped();
        return;
    };
    let golden = Golden::read("clip_tokens");
    let sentences = &golden.metadata()["sentences"];
    let sentences: Vec<String> = serde_json::from_str(sentences).expect("a list");
    let tokenizer = ClipTokenizer::read(&path).expect("a tokenizer of CLIP");
    assert_eq!(tokenizer.num_tokens(), ClipConfig::vit_b_32().num_tokens);
    for (name, expected) in &golden.0.tensors {
        if !name.starts_with("out.ids") {
            continue;
        }
        let context = expected.shape[1];
        for (sentence, row) in sentences.iter().zip(expected.values.chunks_exact(context)) {
            let mut found = tokenizer.encode(sentence, context).expect("encoded");
            found.resize(context, 0);
            let row: Vec<i32> = row.iter().map(|&id| id as i32).collect();
            assert_eq!(found, row, "{sentence:?}");
        }
    }
    let texts: Vec<&str> = sentences.iter().map(String::as_str).collect();
    let context = golden.values("out.ids").1[1];
    let batch = tokenizer.encode_batch(&texts, context).expect("encoded");
    let lengths = golden.indices("out.lengths").into_iter();
    assert_eq!(Some(batch.width), lengths.max());
}

#[expect(
    clippy::print_stderr,
    reason = "a test that checks nothing must say so"
)]
fn skipped() {
    eprintln!(
        "SKIPPED: STANCE_CLIP_TOKENIZER names no tokenizer.json or bpe_simple_vocab_16e6.txt.gz"
    );
}

/// A list of two merges; the vocabulary has 512 bytes, the merges, start and end.
const MERGES: &str = "#version: 0.2\nu p</w>\nu n</w>\n";

fn tiny_config() -> ClipConfig {
    ClipConfig {
        num_tokens: 516,
        context: 12,
        width: 8,
        num_layers: 1,
        num_heads: 2,
        feed_forward: 16,
        projection: 6,
        end_token: 515,
    }
}

const VISION: &str = "vision_model.encoder.layers.0.self_attn.q_proj.weight";

/// Weights of a network under Hugging Face's names, with a tensor of a vision tower and one of neither tower.
fn tiny_weights(seed: u64) -> Weights {
    let network =
        draw(ClipText::new(&tiny_config(), &Device::flex()), Seed(seed)).expect("known layers");
    let bytes = to_safetensors(&network, Path::new("memory")).expect("saved");
    let file = SafeTensors::deserialize(&bytes).expect("valid");
    let mut weights: Weights = file
        .iter()
        .map(|(name, view)| {
            let place = match name.split('.').next().expect("a name") {
                "token_embedding" | "position_embedding" => "text_model.embeddings.",
                "layers" => "text_model.encoder.",
                "final_layer_norm" => "text_model.",
                _ => "",
            };
            let values = view.data().as_chunks::<4>().0.iter();
            let values = values.map(|item| f32::from_le_bytes(*item)).collect();
            (format!("{place}{name}"), (view.shape().to_vec(), values))
        })
        .collect();
    weights.insert(VISION.to_owned(), (vec![2, 2], vec![1.0; 4]));
    weights.insert("logit_scale".to_owned(), (vec![], vec![2.5]));
    weights
}

/// A file of `torch.save` with a state dict, written with Python's opcodes. Storages are numbered; `around` lists the
/// keys of dictionaries that enclose the state dict.
fn as_torch(weights: &Weights, prefix: &str, around: &[&str]) -> Vec<u8> {
    let text = |text: &str| {
        let len = (text.len() as u32).to_le_bytes();
        [b"X", len.as_slice(), text.as_bytes()].concat()
    };
    let int = |number: usize| [b"J", (number as u32).to_le_bytes().as_slice()].concat();
    let tuple = |items: &[Vec<u8>]| [b"(", items.concat().as_slice(), b"t"].concat();
    let empty = b"ccollections\nOrderedDict\n)R".to_vec();

    let mut pickle = b"\x80\x02".to_vec();
    for key in around {
        // A checkpoint also holds plain values, such as the epoch.
        pickle.extend([b"}(", text("epoch").as_slice(), b"K\x07", &text(key)].concat());
    }
    pickle.extend([&empty, b"(".as_slice()].concat());
    for (number, (name, (shape, values))) in weights.iter().enumerate() {
        let storage = tuple(&[
            text("storage"),
            b"ctorch\nFloatStorage\n".to_vec(),
            text(&number.to_string()),
            text("cpu"),
            int(values.len()),
        ]);
        let sizes: Vec<_> = shape.iter().map(|&extent| int(extent)).collect();
        let strides: Vec<_> = (1..=shape.len())
            .map(|axis| int(shape[axis..].iter().product()))
            .collect();
        pickle.extend(text(&format!("{prefix}{name}")));
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n");
        pickle.extend(tuple(&[
            [storage.as_slice(), b"Q"].concat(),
            int(0),
            tuple(&sizes),
            tuple(&strides),
            b"\x89".to_vec(),
            empty.clone(),
        ]));
        pickle.push(b'R');
    }
    pickle.push(b'u');
    pickle.extend(vec![b'u'; around.len()]);
    pickle.push(b'.');

    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut put = |name: &str, content: &[u8]| {
        writer.start_file(name, options).expect("in memory");
        writer.write_all(content).expect("in memory");
    };
    put("archive/data.pkl", &pickle);
    for (number, (_, values)) in weights.values().enumerate() {
        put(&format!("archive/data/{number}"), &le_bytes(values));
    }
    writer.finish().expect("in memory").into_inner()
}

#[test]
fn a_state_dict_of_torch_becomes_safetensors() {
    let weights = tiny_weights(1);
    let path = Path::new("checkpoint.pth");
    let import =
        |bytes: &[u8], options: &StateDictOptions<'_>| state_dict_from_torch(bytes, path, options);
    let options = StateDictOptions::default();
    // Tensors are serialised in the order of their names, so equal weights have equal bytes.
    let expected = as_safetensors(&weights);
    for (prefix, around) in [
        ("", &[][..]),
        ("module.", &["model_state_dict"]),
        ("", &["state_dict"]),
    ] {
        let bytes = as_torch(&weights, prefix, around);
        assert_eq!(import(&bytes, &options).expect("read"), expected);
    }
    let kept = StateDictOptions {
        keep: &["vision_model."],
        ..options
    };
    let bytes = import(&as_torch(&weights, "", &[]), &kept).expect("read");
    let file = SafeTensors::deserialize(&bytes).expect("valid");
    assert_eq!(file.names(), [VISION]);

    // If a checkpoint has no known key, the error lists its keys.
    let elsewhere = as_torch(&weights, "", &["ema"]);
    refused(import(&elsewhere, &options), "ema, epoch");
    let twice = StateDictOptions {
        strip: &["a.", "b."],
        ..options
    };
    let names = BTreeMap::from(["a.x", "b.x"].map(|name| (name.to_owned(), (vec![1], vec![0.0]))));
    refused(import(&as_torch(&names, "", &[]), &twice), "become x");
    let cut = &elsewhere[..elsewhere.len() / 2];
    assert!(matches!(import(cut, &options), Err(Error::Weights { .. })));
}

/// A folder with the files of a tiny CLIP.
fn tiny_folder(seed: u64, weights: &str, tokenizer: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    let content = match weights {
        "model.safetensors" => as_safetensors(&tiny_weights(seed)),
        _ => as_torch(&tiny_weights(seed), "", &[]),
    };
    fs::write(dir.path().join(weights), content).expect("written");
    fs::write(dir.path().join(tokenizer), MERGES).expect("written");
    dir
}

fn tiny_encoder(seed: u64, weights: &str) -> ClipEncoder {
    let dir = tiny_folder(seed, weights, "merges.txt");
    let files = ClipFiles::in_folder(dir.path()).expect("complete");
    ClipEncoder::load(&tiny_config(), &files, &Device::flex()).expect("loaded")
}

#[test]
fn every_kind_of_file_gives_the_same_encoder() {
    let encoder = tiny_encoder(1, "model.safetensors");
    assert_eq!(encoder.width(BertVectors::Pooled), 6);
    let pickled = tiny_encoder(1, "pytorch_model.bin");
    assert_eq!(encoder.hash(), pickled.hash());
    let texts = ["up", "UN  up"];
    let [encoded, of_pickled] = [&encoder, &pickled].map(|encoder| {
        encoder
            .encode(&texts, BertVectors::Pooled)
            .expect("encoded")
    });
    assert_eq!(encoded, of_pickled);
    assert!(encoded.iter().map(Vec::len).eq([6, 6]));
    assert_ne!(encoded[0], encoded[1]);
    // The vectors are not normalised.
    let norm: f32 = encoded[0].iter().map(|value| value * value).sum();
    assert!((norm - 1.0).abs() > 1e-3, "{norm}");
    assert_ne!(encoder.hash(), tiny_encoder(2, "model.safetensors").hash());
}

#[test]
fn files_that_are_missing_or_of_another_size_are_named() {
    let dir = tiny_folder(1, "model.safetensors", "merges.txt");
    let files = ClipFiles::in_folder(dir.path()).expect("complete");
    let load = |config: &ClipConfig| ClipEncoder::load(config, &files, &Device::flex());
    let narrow = ClipConfig {
        projection: 5,
        ..tiny_config()
    };
    assert!(matches!(load(&narrow), Err(Error::Weights { .. })));
    fs::write(&files.tokenizer, format!("{MERGES}a n</w>\n")).expect("written");
    refused(load(&tiny_config()), "517 tokens, expected 516");

    fs::remove_file(&files.tokenizer).expect("removed");
    refused(ClipFiles::in_folder(dir.path()), "tokenizer.json");
    let cached = ClipFiles::in_cache(ClipModel::VitB32, &HubCache::new(dir.path()));
    refused(cached, "models--openai--clip-vit-base-patch32");
}

#[test]
fn a_table_holds_what_the_encoder_gives() {
    let encoder = tiny_encoder(1, "model.safetensors");
    let texts = ["wave", "up", "un-wave both arms", "up", ""];
    let mut seen = Vec::new();
    let mut note = |done, all| seen.push((done, all));
    let table =
        EmbeddingTable::compute(&encoder, BertVectors::Pooled, texts, &mut note).expect("encoded");
    assert_eq!(seen, [(4, 4)]);
    assert_eq!(table.texts(), ["", "un-wave both arms", "up", "wave"]);
    for text in texts {
        let alone = encoder.encode(&[text], BertVectors::Pooled);
        let found = table.get(text).expect("there");
        assert_eq!(found.len(), 6, "{text:?}");
        for (a, b) in found.iter().zip(&alone.expect("encoded")[0]) {
            // The tolerance covers sums of 16 f32 products in another order.
            assert!((a - b).abs() < 1e-5, "{text:?}: {a} {b}");
        }
    }
    table.check_texts(["up", "wave"]).expect("complete");
    let lacks = r#"lacks 2 texts, such as "Up", "down""#;
    refused(table.check_texts(["up", "Up", "down"]), lacks);
}

#[test]
fn a_table_comes_back_bit_for_bit_or_not_at_all() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("texts.safetensors");
    let encoder = tiny_encoder(1, "model.safetensors");
    let texts: Vec<String> = (0..150).map(|i| format!("turn {i} \"times\"\n")).collect();
    let compute = |texts: &mut dyn Iterator<Item = &str>| {
        let vectors = BertVectors::Pooled;
        EmbeddingTable::compute(&encoder, vectors, texts, &mut |_, _| {}).expect("encoded")
    };
    let table = compute(&mut texts.iter().map(String::as_str));
    table.save(&path).expect("saved");
    let bytes = fs::read(&path).expect("there");
    let back = EmbeddingTable::load(&path).expect("whole");
    assert_eq!(back, table);
    assert_eq!(back.hash(), table.hash());
    // The order of the texts does not matter.
    compute(&mut texts.iter().rev().map(String::as_str))
        .save(&path)
        .expect("saved");
    assert_eq!(fs::read(&path).expect("there"), bytes);

    for at in [bytes.len() - 1, bytes.len() / 2, 1] {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1;
        fs::write(&path, damaged).expect("written");
        refused(EmbeddingTable::load(&path), "is no table of text");
    }
    fs::write(&path, as_safetensors(&tiny_weights(1))).expect("written");
    refused(EmbeddingTable::load(&path), "does not say what it is");

    let empty = compute(&mut [].into_iter());
    empty.save(&path).expect("saved");
    assert_eq!(EmbeddingTable::load(&path).expect("whole"), empty);
}
