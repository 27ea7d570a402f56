//! The coordinator learns which windows were composed.

use super::*;

/// Natural windows, whose two halves swing together, and composed windows, whose halves come from two natural ones.
struct Swings {
    first: u64,
}

impl Swings {
    fn window(item: u64) -> Vec<f32> {
        let is_composed = item % 2 == 1;
        let phase = |part: u64| (item * 7 + part * 3) as f32 * 0.9;
        (0..WINDOW_NUMBERS)
            .map(|index| {
                let (frame, channel) = (index / FRAME_WIDTH, index % FRAME_WIDTH);
                let part = u64::from(is_composed && channel >= FRAME_WIDTH / 2);
                0.5 * (0.5 * frame as f32 + phase(part)).sin()
            })
            .collect()
    }
}

impl WindowSource<CoordinatorBatch> for Swings {
    fn epoch_len(&self) -> u64 {
        512
    }

    fn window_len(&self) -> usize {
        WINDOW_NUMBERS
    }

    fn fill(
        &self,
        _epoch: u64,
        first: u64,
        num_items: usize,
        batch: &mut CoordinatorBatch,
    ) -> Result<(), train::Error> {
        let first = self.first + first;
        let items = first..first + num_items as u64;
        batch.windows = items.clone().flat_map(Self::window).collect();
        batch.composed = items.map(|item| (item % 2) as f32).collect();
        Ok(())
    }
}

#[test]
fn the_coordinator_learns_what_was_composed() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = CoordinatorConfig::preset(Preset::Tiny);
    config.model = small_config(1).model;
    config.run.optimizer.learning_rate = 3e-3;
    config.run.batch_size = 32;
    config.run.micro_batch_size = Some(20);
    config.run.length = RunLength::of_steps(150);
    (config.run.val_every, config.val_windows) = (50, 64);
    let report = quietly(|session| {
        let segments = Segments {
            train: &Swings { first: 0 },
            val: &Swings { first: 2_000 },
            normalizer: METRES,
            skeleton: &SKELETON,
            dataset_hash: "0",
            compose: &COMPOSE,
        };
        train_coordinator(dir.path(), &config, segments, session)
    })
    .expect("trains");
    // An untrained coordinator is at chance: the loss is ln 2.
    assert!((report.first_loss.expect("a line") - 0.69).abs() < 0.2);
    assert!(report.best_val_loss.expect("validated") < 0.2);
    let judge = TrainedCoordinator::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let windows: Vec<f32> = (1000..1064).flat_map(Swings::window).collect();
    let wrong = judge
        .probabilities(&windows)
        .iter()
        .enumerate()
        .filter(|&(item, &p)| (p > 0.5) != (item % 2 == 1))
        .count();
    assert!(wrong < 8, "{wrong} of 64");

    // The coordinator does not guide an editor with another normaliser.
    let editor_dir = tempfile::tempdir().expect("a folder");
    train(editor_dir.path(), &small_config(10), &waves(20));
    let editor = Editor::load(editor_dir.path(), Slot::Best, &Device::flex()).expect("loads");
    refused(editor.with_coordinator(judge), "does not fit");
}
