//! A small dataset of the built-in corpus, on which tests train every network.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use burn::tensor::Device;
use compose::{ItemConfig, ItemCount};
use corpus::{CLIPS_PER_TAKE, CorpusOptions, write_corpus};
use datasets_spec::record::ItemRow;
use datasets_spec::{Dataset, NoProgress, Progress, Seed, Split};
use pipeline::annotation::masks::MaskConfig;
use pipeline::ingest::ingest;
use pipeline::stage::{self, Context, IngestConfig, Judged};
use serde_json::{Value, json};
use train::Session;
use train::checkpoint::Start;
use train::config::{Preset, RunLength, TrainConfig};
use train::kind::TrainRequest;
use train::model::pass::Arithmetic;
use train::registry;
use train::text::source::TextEncoderSource;

/// A dataset in a temporary folder, which is removed with this value.
pub struct Data {
    folder: tempfile::TempDir,
}

impl Data {
    /// Makes the dataset from the built-in corpus.
    pub fn make() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let (sources, dataset) = (folder.path().join("corpus"), folder.path().join("dataset"));
        let options = CorpusOptions {
            seed: Seed(0),
            clips: CLIPS_PER_TAKE,
            adjusted: 0,
        };
        write_corpus(&sources, &options, &NoProgress).expect("a corpus");
        let options = IngestConfig::default().options(Seed(0)).expect("options");
        ingest(&[sources], &dataset, &options, "a test", &NoProgress).expect("ingested");
        let context = Context {
            progress: &NoProgress,
            holder: "a test",
        };
        stage::masks(
            &dataset,
            &MaskConfig::default(),
            Judged::Keep,
            None,
            &context,
        )
        .expect("masks");
        Self { folder }
    }

    /// The folder of the dataset.
    pub fn dataset(&self) -> PathBuf {
        self.folder.path().join("dataset")
    }

    /// A folder for a run.
    pub fn run(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

/// Runs `act` in a session on a device.
pub fn on<T>(
    device: &Device,
    progress: &dyn Progress,
    stop: &AtomicBool,
    act: impl FnOnce(&Session<'_>) -> T,
) -> T {
    let begun = Instant::now();
    act(&Session {
        device,
        more_devices: &[],
        arithmetic: Arithmetic::default(),
        progress,
        stop,
        clock: &|| begun.elapsed(),
    })
}

/// Runs `act` in a session that is stopped after a number of steps. Steps of earlier sessions count: a session begins
/// by reporting them.
pub fn stopped_after<T>(steps: u64, device: &Device, act: impl FnOnce(&Session<'_>) -> T) -> T {
    let stop = AtomicBool::new(false);
    let progress = StopAfter {
        stop: &stop,
        left: AtomicU64::new(steps),
    };
    on(device, &progress, &stop, act)
}

struct StopAfter<'a> {
    stop: &'a AtomicBool,
    left: AtomicU64,
}

impl Progress for StopAfter<'_> {
    fn begin(&self, _stage: &str, _total: Option<u64>) {}
    fn advance(&self, count: u64) {
        let left = self.left.load(Ordering::Relaxed).saturating_sub(count);
        self.left.store(left, Ordering::Relaxed);
        self.stop.store(left == 0, Ordering::Relaxed);
    }
    fn message(&self, _text: &str) {}
    fn finish(&self, _summary: &str) {}
}

/// Settings of a short run of a network: a line of metrics every `log_every` steps, and one validation at the end.
pub fn settings(network: &str, steps: u64, log_every: u64) -> Value {
    let mut own = json!({
        "batch_size": 4,
        "length": { "steps": steps },
        "log_every": log_every,
        "val_every": steps,
    });
    let more = match network {
        "motionrefit" => json!({
            "val_windows": 8,
            "diffusion": { "num_steps": 10, "schedule": "official" },
        }),
        "coordinator" => json!({
            "val_windows": 8, "diffusion_steps": 10, "noise_steps": 5, "schedule": "official",
        }),
        "tmed" => json!({ "val_clips": 4, "diffusion": { "num_steps": 10 } }),
        "mdm" => json!({ "diffusion_steps": 10 }),
        "mld" => {
            let autoencoder = own.clone();
            json!({ "diffusion_steps": 20, "sampling_steps": 10, "autoencoder": autoencoder })
        }
        "j2s" => json!({ "width": 64 }),
        _ => json!({}),
    };
    let (Some(settings), Some(more)) = (own.as_object_mut(), more.as_object()) else {
        unreachable!("both are objects");
    };
    settings.extend(more.clone());
    own
}

/// Trains the network with the given name, or continues its run.
pub fn train(data: &Data, network: &str, run: &Path, own: &Value, session: &Session<'_>) {
    let kind = registry::model(network).expect("a network");
    let request = TrainRequest {
        dataset: &Dataset::open(&data.dataset()).expect("a dataset"),
        start: Start::from(run),
        preset: Preset::Tiny,
        own,
        compose: &TrainConfig::compose_preset(Preset::Tiny),
        windows: None,
        text_encoder: &TextEncoderSource::default(),
        seed: Some(3),
        length: own["length"]["steps"].as_u64().map(RunLength::of_steps),
        memory: None,
    };
    if let Err(error) = (kind.train)(&request, session) {
        panic!("{network}: {error}");
    }
}

/// Two items of the test split.
pub fn items(data: &Data) -> Vec<ItemRow> {
    let context = Context {
        progress: &NoProgress,
        holder: "a test",
    };
    let config = ItemConfig {
        count: ItemCount::Exactly(2),
        ..ItemConfig::default()
    };
    let dataset = Dataset::open(&data.dataset()).expect("a dataset");
    let place = data.run("items");
    let drawn = stage::items(&dataset, &place, Split::Test, &config, Seed(0), &context);
    drawn.expect("items").dataset.read(None).expect("rows")
}
