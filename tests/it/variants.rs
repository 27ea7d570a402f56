//! Candidates of fine-grained pairs: made by a generator or elsewhere, and shown to annotators.

use annotate::store::{NewTask, open_sqlite};
use annotate::wire::{Answer, TaskKind, Verdict};
use datasets_spec::record::{MotionRow, PairRow};
use serde_json::Value;

use crate::annotate::bare_task;
use crate::train::Workshop;
use crate::util::commit;

/// Settings of a generator that is trained in a second.
pub(crate) const SMALL: &str = "
    batch_size = 8
    val_every = 3
    diffusion_steps = 40
    sampling_steps = 4
    [model]
    width = 32
    num_layers = 3
    num_heads = 4
    feed_forward = 64
    [autoencoder]
    batch_size = 8
    val_every = 3
    [autoencoder.model]
    width = 32
    num_layers = 3
    num_heads = 4
    feed_forward = 64
";

/// Bounds that also accept pairs of an untrained network.
pub(crate) const ANY: &str =
    "--min-distance 0 --max-distance 1000 --max-skate 1000 --max-drift 1000";

/// Checks that settings with which the generator makes nothing are refused, and options that would have no effect.
fn refuse_what_makes_none(workshop: &Workshop) {
    workshop.put("texts.txt", "The person is waving.\n");
    for (more, said) in [
        (
            "captions --variants 0",
            "setting variants is not usable: it must be at least 1",
        ),
        (
            "captions --relative-noise nan",
            "setting relative_noise is not usable",
        ),
        (
            "captions --text-encoder none",
            "makes no use of --text-encoder",
        ),
        (
            "@texts.txt --where 'fps > 0'",
            "--where chooses clips of the dataset",
        ),
    ] {
        let line = format!("variants @dataset --generator @mld --out @none --instructions {more}");
        workshop.typed(&line).expect_refused(said);
    }
    // A folder in which no dataset can be written is refused before anything is generated.
    workshop.put("damaged/meta/manifest-1.json", "{");
    let line = "variants @dataset --generator @mld --instructions captions --out @damaged";
    let said = workshop.refused(line, "manifest-1.json").stderr;
    assert!(!said.contains("candidate pairs"), "{said}");
    // Without a generator nothing is sampled.
    let ran = workshop.typed("variants @dataset --variants 8 --out @none");
    ran.expect_code(2).expect_said("--generator");
}

#[test]
fn variants_of_captions_come_to_annotators_in_bundles_of_eight() {
    let workshop = Workshop::open();
    workshop.trained("mld", "mld", SMALL, "--steps 3");
    let made = |out: &str| -> Value {
        workshop.json(&format!(
            "variants @dataset --generator @mld --instructions captions --count 3 --out @{out} {ANY}"
        ))
    };
    refuse_what_makes_none(&workshop);
    // The body of a generator is that of the dataset.
    let mut other = workshop.record("mld");
    other["skeleton_hash"] = "another".into();
    workshop.put("other/config.json", other.to_string());
    let other = "variants @dataset --generator @other --instructions captions --out @none";
    workshop.refused(other, "the generator in");
    for refused in ["--extend", "--init @mld"] {
        let line = format!("train mld @dataset --out @mld {refused}");
        workshop.refused(&line, "MLD consists of two runs");
    }
    let first = made("candidates");
    let count = |of: &Value, name: &str| of["counts"][name].as_u64().expect("a count");
    assert_eq!((count(&first, "bases"), count(&first, "variants")), (3, 48));
    let left_out = "broken lengths identical different sliding drifting floating".split(' ');
    let left_out: u64 = left_out.map(|name| count(&first, name)).sum();
    let kept = count(&first, "kept");
    assert_eq!(kept + left_out, 24, "every pair is counted: {first}");
    assert!(first["latent_std"].as_f64().is_some_and(|std| std > 0.0));
    workshop.run("verify @candidates");

    let pairs: Vec<PairRow> = workshop.rows("candidates");
    let motions: Vec<MotionRow> = workshop.rows("candidates");
    assert_eq!((pairs.len() as u64, motions.len()), (kept, 2 * pairs.len()));
    for pair in &pairs {
        let of = |id| motions.iter().find(|row| row.id == id).expect("a motion");
        let (source, target) = (of(pair.source_id.clone()), of(pair.target_id.clone()));
        assert_eq!(source.n_frames, target.n_frames);
        assert_eq!(source.captions[0].text, pair.instruction);
        assert!(pair.source_id.as_str().starts_with("seed0/batch0000/"));
    }

    // The same command makes nothing again; in another folder it gives the same bytes.
    let repeated = made("candidates");
    assert!(repeated["counts"].is_null() && repeated["root_hash"] == first["root_hash"]);
    assert_eq!(made("again")["root_hash"], first["root_hash"]);
    workshop.refused("variants @candidates --out @again", "another dataset");

    // Variants that were made elsewhere are motions named base/variant.
    let elsewhere: Value = workshop.json(&format!("variants @candidates --out @paired {ANY}"));
    assert_eq!(count(&elsewhere, "variants"), 2 * kept);
    assert_eq!(elsewhere["pairs"], kept);

    workshop.run("annotate @candidates user add ann");
    workshop.run("annotate @candidates import");
    let store = workshop.path("candidates/annotate/store.sqlite");
    let store = open_sqlite(&store).expect("a store");
    let claimed = store.claim(1, TaskKind::Pair, 0, 0).expect("claimed");
    let Ok((detail, _)) = claimed else {
        panic!("the candidates are tasks");
    };
    let hint = detail.task.hint.as_deref();
    let of_base = pairs.iter().filter(|pair| hint == Some(&pair.instruction));
    let expected = of_base.count();
    assert!((1..=8).contains(&expected), "{expected}");
    assert_eq!(detail.bundle.len(), expected);
    let masks = store.claim(1, TaskKind::MaskText, 0, 0).expect("an answer");
    assert!(masks.is_err(), "variants are no mask tasks");

    // Pairs that were all judged unusable are removed from the dataset, and none is made again.
    let import = |store: &str| -> Value {
        workshop.json(&format!("annotate @paired --store @{store} import"))
    };
    assert_eq!(count(&import("first.sqlite"), "new_tasks"), kept);
    let file = workshop.path("first.sqlite");
    let store = open_sqlite(&file).expect("a store");
    let judged = store.pairs().expect("pairs").into_iter();
    let judged = judged.map(|(key, source, target)| NewTask {
        kind: TaskKind::Pair,
        target: Some(target),
        accepted: Some(Answer::Pair {
            verdict: Verdict::Unclear,
            parts: Vec::new(),
            edit_type: None,
            text: String::new(),
            suggestion: None,
            note: String::new(),
        }),
        ..bare_task(key, &source)
    });
    let done = store.import(None, judged.collect(), 0).expect("imports");
    assert_eq!(done.filled as u64, kept);
    workshop.run("annotate @paired --store @first.sqlite export");
    assert_eq!(workshop.rows::<PairRow>("paired").len(), 0);
    let counts = &import("second.sqlite")["counts"];
    assert!(counts["new_tasks"].is_null(), "{counts}");

    // The same condition chooses other clips now. What was paired of the former ones is not taken for their result.
    let some = format!("variants @candidates --out @some {ANY} --where has_pair");
    workshop.run(&some);
    workshop.run(&some);
    let dataset = workshop.path("candidates");
    commit(&dataset, &pairs[1..], |row| row.split, "fewer");
    workshop.refused(&some, "another dataset");
}
