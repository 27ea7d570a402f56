//! Networks under the names of released ones.

use super::*;

#[test]
fn the_released_pose_network_begins_as_pytorchs_layers_do() {
    let workshop = Workshop::open();
    let train = "train j2s @dataset --preset official --steps 6 --seed 3";
    workshop.run(&format!("{train} --out @poses"));
    let metrics = json_lines(&workshop.text("poses/metrics.jsonl"));
    let losses = metrics.iter().filter_map(|line| line.get("val_loss"));
    let losses: Vec<&Value> = losses.collect();
    assert_eq!(losses.len(), 6);
    let is_finite = |loss: &&Value| loss.as_f64().is_some_and(f64::is_finite);
    assert!(losses.iter().all(is_finite), "{losses:?}");
    let weights = tensors(&workshop.path("poses/checkpoint/best/model.safetensors"));
    let running = weights
        .iter()
        .filter(|(name, _)| name.ends_with("running_var"));
    let bytes = running.flat_map(|(_, bytes)| bytes.as_chunks::<4>().0);
    let variances: Vec<f32> = bytes.map(|bytes| f32::from_le_bytes(*bytes)).collect();
    assert_eq!(variances.len(), 128);
    // The report and the weights beside it are of the best checkpoint, which edits use.
    assert_eq!(tensors(&workshop.path("poses/model.safetensors")), weights);
    // So short a run has shorter intervals than the preset, and records them. Earlier versions recorded those of the
    // preset; such a run goes on.
    let mut record = workshop.record("poses");
    for (interval, of_preset) in [("log_every", 100), ("val_every", 200)] {
        assert_eq!(record["config"][interval], 1);
        record["config"][interval] = of_preset.into();
    }
    workshop.put("one/config.json", record.to_string());
    // The running statistics of batch normalisation do not depend on the number of threads.
    workshop.run(&format!("{train} --out @one --threads 1"));
    let [several, one] = ["poses", "one"].map(|run| {
        let weights = format!("{run}/checkpoint/last/model.safetensors");
        fs::read(workshop.path(&weights)).expect("weights")
    });
    assert!(several == one);
    assert_eq!(workshop.record("one"), record);
    assert!(variances.iter().all(|&variance| variance > 0.0));
}

/// The tensors of a safetensors file by name.
fn tensors(path: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = fs::read(path).expect("weights");
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
    let tensors = file.tensors().into_iter();
    let tensors = tensors.map(|(name, tensor)| (name, tensor.data().to_vec()));
    let mut tensors: Vec<_> = tensors.collect();
    tensors.sort();
    tensors
}

#[test]
fn networks_go_out_under_the_released_names_and_come_back() {
    let workshop = Workshop::open();
    workshop.trained("coordinator", "guide", SMALL, "--steps 2");
    workshop.run("model export @guide --out @out");
    let exported = tensors(&workshop.path("out/coordinator.safetensors"));
    let names: Vec<&str> = exported.iter().map(|(name, _)| name.as_str()).collect();
    for name in [
        "positional_encoder.pos_encoding",
        "embed_prog_ind.sequence_pos_encoder.pos_encoding",
        "pred.2.bias",
        "transformer.layers.0.self_attn.in_proj_weight",
    ] {
        assert!(names.contains(&name), "{name}");
    }
    let import = |file: &str| {
        workshop.typed(&format!(
            "model import @{file} --model coordinator --out @back"
        ))
    };
    workshop.refused("model export @guide --out @out", "not empty");
    let other = "model import @out/coordinator.safetensors --out @other";
    workshop.refused(other, "another network");
    import("out/coordinator.safetensors").expect_code(0);
    // The settings come back too: the preset has other numbers of heads and layers.
    for part in ["train", "normalizer", "compose"] {
        let of = |run: &str| workshop.record(run)["config"][part].clone();
        assert!(of("guide").is_object(), "{part}");
        assert_eq!(of("back"), of("guide"), "{part}");
    }
    import("out/coordinator.safetensors --preset tiny").expect_refused("leave --preset out");
    let other = format!("{other} --text-encoder @nowhere");
    workshop.refused(&other, "leave --text-encoder out");
    // A network of another skeleton stays one.
    copy_all(&workshop.path("out"), &workshop.path("ours"));
    let mut stated: Value = json_of(workshop.path("ours/settings.json"));
    stated["skeleton"] = json!({"name": "ours", "hash": "ab"});
    workshop.put("ours/settings.json", stated.to_string());
    workshop.run("model import @ours/coordinator.safetensors --model coordinator --out @third");
    let record = workshop.record("third");
    assert_eq!(
        [&record["skeleton"], &record["skeleton_hash"]],
        ["ours", "ab"]
    );
    let [guide, back] = ["guide", "back"].map(|run| {
        let best = workshop.path(run).join("checkpoint/best");
        tensors(&best.join("coordinator.safetensors"))
    });
    assert!(guide == back);
    let path = workshop.path("out/coordinator.safetensors");
    let mut bytes = fs::read(path).expect("weights");
    let hash = blake3::hash(&bytes).to_hex();
    assert_eq!(workshop.record("back")["imported"], hash.as_str());
    import("out/coordinator.safetensors").expect_code(0);
    // Other weights do not take the place of those of the run.
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
    let bias = file.tensor("pred.2.bias").expect("a tensor").data();
    let place = bias.as_ptr().addr() - bytes.as_ptr().addr();
    bytes[place] ^= 1;
    workshop.put("out/other.safetensors", bytes);
    import("out/other.safetensors").expect_refused("holds the import of another file");
    for unused in ["--heads 2", "--stats nowhere", "--text-encoder nowhere"] {
        let option = unused.split(' ').next().expect("an option");
        let no_use = format!("the import of coordinator makes no use of {option}");
        import(&format!("out/other.safetensors {unused}")).expect_refused(&no_use);
    }
    workshop.put("broken.pth", b"PK\x03\x04 no archive");
    import("broken.pth --range @out/range.json").expect_refused("broken.pth");
    let turned = r#"{"min": [1, 1, 1], "max": [-1, 2, 2]}"#;
    workshop.put("turned.json", turned);
    let range = "out/coordinator.safetensors --range @turned.json";
    import(range).expect_refused("min must be below max");
}
