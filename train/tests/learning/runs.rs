//! Runs are continued, extended and begun with the weights of others, on any number of threads.

use super::*;

#[test]
fn an_interrupted_run_ends_as_an_uninterrupted_one() {
    let files = [
        "last/denoiser.safetensors",
        "best/denoiser.safetensors",
        "last/text.safetensors",
        "best/text.safetensors",
        "last/state.json",
    ];
    // The first run stops between two lines of the metrics, right after a checkpoint, and after its end.
    for (config, stops, files) in [
        (small_config(25), &[7, 3, 100][..], &files[..]),
        (rich_config(25), &[13, 100], &files[..2]),
    ] {
        let ([whole, _], reports) = check_continued(stops, files, |run, session| {
            let report = train_motionrefit(run, &config, corpus(&waves(20)), session);
            report.expect("trains")
        });
        assert!(!reports[0].is_complete);
        if config.run.optimizer.ema_decay.is_some() {
            // The editor uses the averaged weights.
            let weights = |name: &str| std::fs::read(whole.path().join("checkpoint").join(name));
            let [last, best] = [files[0], files[1]].map(|name| weights(name).expect("weights"));
            assert!(last != best);
        }
    }
}

#[test]
fn a_run_killed_between_two_checkpoints_of_a_step_writes_both_again() {
    // The last step is validated for the first time, and ends an epoch that is kept.
    let mut config = small_config(3);
    config.run.keep_epochs = 1;
    let files = ["best", "epoch-1", "last"].map(|slot| format!("{slot}/denoiser.safetensors"));
    let files = files.each_ref().map(String::as_str);
    let source = waves(20);
    let whole = tempfile::tempdir().expect("a folder");
    train(whole.path(), &config, &source);
    for slot in ["best", "epoch-1", "last"] {
        let killed = tempfile::tempdir().expect("a folder");
        // A file stands where a checkpoint would be written, so the run ends there.
        let checkpoints = killed.path().join("checkpoint");
        let obstacle = checkpoints.join(format!(".{slot}.new"));
        std::fs::create_dir(&checkpoints).expect("a folder");
        std::fs::write(&obstacle, "").expect("writes");
        refused(try_to_train(killed.path(), &config, &source), "cannot");
        std::fs::remove_file(&obstacle).expect("removed");
        train(killed.path(), &config, &source);
        assert_eq!(logged_losses(killed.path()), logged_losses(whole.path()));
        check_same(whole.path(), killed.path(), &files);
    }
}

/// A run that uses everything a checkpoint stores: micro-batches, clipped gradients, averaged weights, dropout.
fn rich_config(num_steps: u64) -> TrainConfig {
    let mut config = small_config(num_steps);
    config.model.dropout = 0.1;
    config.run.micro_batch_size = Some(3);
    config.run.optimizer.max_gradient_norm = Some(0.5);
    config.run.optimizer.ema_decay = Some(0.9);
    config.diffusion.previous = PreviousFrames::Encoded;
    config.diffusion.prediction = Prediction::Gated;
    config.diffusion.tell_frames = true;
    config
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let losses = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let dir = tempfile::tempdir().expect("a folder");
        let mut config = rich_config(10);
        // A step has three micro-batches, of 16, 16 and 8 windows.
        (config.run.batch_size, config.run.micro_batch_size) = (40, None);
        let act = || train(dir.path(), &config, &waves(20));
        pool.expect("a pool").install(act);
        logged_losses(dir.path())
    });
    assert_eq!(losses[0], losses[1]);
    assert_eq!(losses[0], losses[2]);
}

#[test]
fn a_batch_in_parts_and_on_several_devices_is_the_whole_batch() {
    let source = waves(20);
    let losses = |micro_batch_size: usize, more_devices: &[Device]| {
        let mut config = small_config(10);
        config.run.micro_batch_size = Some(micro_batch_size);
        let dir = tempfile::tempdir().expect("a folder");
        let trained = quietly(|session| {
            let session = Session {
                more_devices,
                ..*session
            };
            train_motionrefit(dir.path(), &config, corpus(&source), &session)
        });
        trained.expect("trains");
        logged_losses(dir.path())
    };
    let whole = losses(8, &[]);
    let parts = losses(3, &[]);
    let spread = losses(3, &[Device::flex(), Device::flex()]);
    // Each device computes the same micro-batches in the same order.
    assert_eq!(parts, spread);
    for ((step, whole), (_, parts)) in whole.iter().zip(&parts) {
        // The tolerance covers sums in another order, over ten steps of the optimiser.
        let is_near = (whole - parts).abs() < 1e-4 * whole;
        assert!(is_near, "{step}: {whole} {parts}");
    }
}

#[test]
fn epochs_are_counted_and_their_checkpoints_kept() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(1);
    // 20 items in steps of 8 make an epoch of three steps.
    config.run.length = RunLength {
        epochs: Some(5),
        steps: 100,
    };
    config.run.keep_epochs = 2;
    let report = train(dir.path(), &config, &waves(20));
    assert_eq!(report.steps, 15);
    for (epoch, is_kept) in [(1, false), (2, true), (3, false), (4, true), (5, false)] {
        let loaded = Editor::load(dir.path(), Slot::Epoch(epoch), &Device::flex());
        assert_eq!(loaded.is_ok(), is_kept, "{epoch}");
    }
}

#[test]
fn a_run_with_damaged_weights_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let source = waves(8);
    train(dir.path(), &small_config(1), &source);
    let weights = dir.path().join("checkpoint/last/denoiser.safetensors");
    let mut bytes = std::fs::read(&weights).expect("weights");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&weights, bytes).expect("damaged");
    let damaged = try_to_train(dir.path(), &small_config(1), &source);
    refused(damaged, "is corrupt");
}

#[test]
fn a_run_is_extended_and_says_so() {
    let dir = tempfile::tempdir().expect("a folder");
    let run = dir.path();
    let source = waves(8);
    train(run, &small_config(4), &source);
    let mut longer = small_config(9);
    longer.run.optimizer.learning_rate *= 0.5;
    let unasked = try_to_train(run, &longer, &source);
    assert!(
        matches!(&unasked, Err(Error::OtherRun { field, .. }) if field.starts_with("config.train."))
    );
    refused(unasked, "--extend");
    let extend = Start {
        extend: true,
        ..Start::from(run)
    };
    let done = try_to_train(extend, &longer, &source).expect("extended");
    assert_eq!((done.steps, done.is_complete), (9, true));
    let lineage = record(run)["lineage"].clone();
    let ancestor = &lineage[0];
    assert_eq!(ancestor["by"], "extend");
    assert_eq!(ancestor["step"], 4);
    let steps = &ancestor["changed"]["config.train.length.steps"];
    assert_eq!(*steps, serde_json::json!([4, 9]));
    // Repeating the command does nothing, with and without `--extend`.
    for start in [extend, Start::from(run)] {
        let again = try_to_train(start, &longer, &source).expect("there");
        assert_eq!(again.steps, 9);
    }
    assert_eq!(record(run)["lineage"], lineage);
    // Neither another network nor a length that the run has already passed is accepted.
    let mut wider = longer.clone();
    wider.model.width *= 2;
    assert!(matches!(
        try_to_train(extend, &wider, &source),
        Err(Error::OtherRun { field, .. }) if field == "config.train.model.width"
    ));
    assert!(matches!(
        try_to_train(extend, &small_config(5), &source),
        Err(Error::Config { field, .. }) if field == "length"
    ));
    assert_eq!(record(run)["config"]["train"]["length"]["steps"], 9);
    let other = tempfile::tempdir().expect("a folder");
    let nothing = Start {
        run: other.path(),
        ..extend
    };
    let begun = try_to_train(nothing, &longer, &source);
    refused(begun, "is not a motionrefit run");
}

#[test]
fn a_run_begins_with_the_weights_of_another() {
    let [first, second, third, fourth] = [(); 4].map(|()| tempfile::tempdir().expect("a folder"));
    train(first.path(), &small_config(10), &waves(8));
    // A learning rate of zero does not change the weights.
    let mut still = small_config(1);
    still.run.optimizer.learning_rate = 0.0;
    let start = Start {
        init: Some(first.path()),
        ..Start::from(second.path())
    };
    let other = waves(12);
    try_to_train(start, &still, &other).expect("trains");
    check_same(first.path(), second.path(), &["best/denoiser.safetensors"]);
    let editor = Editor::load(first.path(), Slot::Best, &Device::flex()).expect("loads");
    let lineage = &record(second.path())["lineage"];
    assert_eq!(lineage[0]["by"], "init");
    assert_eq!(lineage[0]["weights"], editor.hash());
    // The run continues without the other run being given again.
    train(second.path(), &still, &other);
    train(third.path(), &small_config(2), &waves(8));
    let swapped = Start {
        init: Some(third.path()),
        ..start
    };
    let swapped = try_to_train(swapped, &still, &other);
    assert!(matches!(swapped, Err(Error::OtherRun { .. })));
    // A network of another shape cannot start from these weights.
    let mut wider = still.clone();
    wider.model.width *= 2;
    let misfit = Start {
        run: fourth.path(),
        ..start
    };
    let misfit = try_to_train(misfit, &wider, &other);
    assert!(matches!(misfit, Err(Error::Weights { .. })));
}

#[test]
fn a_loss_that_is_no_number_ends_the_run_and_is_never_best() {
    let dir = tempfile::tempdir().expect("a folder");
    let source = waves(8);
    let broken = Waves {
        is_broken: true,
        ..waves(8)
    };
    let corpus = Corpus {
        val: &broken,
        ..corpus(&source)
    };
    let config = small_config(4);
    let ended = quietly(|session| train_motionrefit(dir.path(), &config, corpus, session));
    assert!(matches!(
        ended,
        Err(Error::Diverged {
            step: 4,
            kept: 0,
            ..
        })
    ));
    refused(ended, "validation loss");
    assert!(!dir.path().join("checkpoint/best").exists());
    let other = tempfile::tempdir().expect("a folder");
    assert!(matches!(
        try_to_train(other.path(), &config, &broken),
        Err(Error::Diverged {
            what: "training",
            step: 0,
            ..
        })
    ));
}
