//! LeRobot v3: one row per frame, with separate tables of episodes and tasks.
//!
//! A clip is an episode, its first caption (made ones are left out) its task, and `observation.state` a frame's 69 numbers:
//! translation, root orientation and body pose, as in the `motions` table.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::builder::{ListBuilder, StringBuilder};
use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Int64Array, RecordBatch, StringArray,
};
use arrow_schema::{DataType, Field};
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Progress, Split};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use serde_json::json;

use crate::Error;

/// Numbers of a frame.
const STATE_WIDTH: usize = 69;
/// Rows of a data file: about 30 MB.
const FILE_FRAMES: usize = 100_000;
/// Files per chunk, by the format.
const CHUNK_FILES: usize = 1000;
/// Task of a clip without a caption.
const NO_TASK: &str = "move";

/// Writes the data set and returns the number of clips.
///
/// # Errors
/// The dataset cannot be read, its clips differ in frame rate, or a file cannot be written.
pub(super) fn write(
    dataset: &Dataset,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    let total = dataset.manifest().rows(MotionRow::TABLE, None);
    progress.begin("export lerobot", Some(total));
    let mut writer = Writer::new(dataset, folder);
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let first = writer.episodes.len();
        for (path, _) in dataset.files(MotionRow::TABLE, Some(split)) {
            for row in read_rows::<MotionRow>(&path)? {
                writer.episode(&row)?;
                progress.advance(1);
            }
        }
        if writer.episodes.len() > first {
            let range = format!("{first}:{}", writer.episodes.len());
            splits.insert(split.as_str(), range);
        }
    }
    let count = writer.episodes.len() as u64;
    writer.finish(&splits)?;
    progress.finish(&format!("{count} episodes"));
    Ok(count)
}

/// Location of an episode's frames.
struct Episode {
    task: usize,
    length: usize,
    first_row: usize,
    file: usize,
}

struct Writer<'a> {
    dataset: &'a Dataset,
    folder: &'a Path,
    fps: Option<f32>,
    tasks: Vec<String>,
    task_places: BTreeMap<String, usize>,
    episodes: Vec<Episode>,
    /// Frames waiting for their file.
    states: Vec<[f32; STATE_WIDTH]>,
    pending_first: usize,
    files: usize,
    rows: usize,
    statistics: Statistics,
}

impl<'a> Writer<'a> {
    fn new(dataset: &'a Dataset, folder: &'a Path) -> Self {
        Self {
            dataset,
            folder,
            fps: None,
            tasks: Vec::new(),
            task_places: BTreeMap::new(),
            episodes: Vec::new(),
            states: Vec::new(),
            pending_first: 0,
            files: 0,
            rows: 0,
            statistics: Statistics::default(),
        }
    }

    fn episode(&mut self, row: &MotionRow) -> Result<(), Error> {
        let fps = *self.fps.get_or_insert(row.fps);
        if fps != row.fps {
            return Err(Error::MixedRates {
                first: fps,
                other: row.fps,
                motion: row.id.clone(),
            });
        }
        let said = row.stated_captions().next();
        let text = said.map(|caption| caption.text.as_str());
        let text = text.unwrap_or(NO_TASK).to_owned();
        let next = self.tasks.len();
        let task = *self.task_places.entry(text.clone()).or_insert(next);
        if task == next {
            self.tasks.push(text);
        }
        self.episodes.push(Episode {
            task,
            length: row.transl.len(),
            first_row: self.rows,
            file: self.files,
        });
        for ((transl, orient), pose) in row
            .transl
            .iter()
            .zip(&row.global_orient)
            .zip(&row.body_pose)
        {
            let mut state = [0.0; STATE_WIDTH];
            state[..3].copy_from_slice(transl);
            state[3..6].copy_from_slice(orient);
            state[6..].copy_from_slice(pose);
            self.statistics.take(&state);
            self.states.push(state);
        }
        self.rows += row.transl.len();
        // An episode lies in one file.
        if self.states.len() >= FILE_FRAMES {
            self.flush()?;
        }
        Ok(())
    }

    /// Writes the pending frames as a file.
    fn flush(&mut self) -> Result<(), Error> {
        if self.states.is_empty() {
            return Ok(());
        }
        let fps = f64::from(self.fps.unwrap_or(1.0));
        let (mut times, mut frames, mut episodes, mut tasks) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (index, episode) in self.episodes.iter().enumerate().skip(self.pending_first) {
            for frame in 0..episode.length {
                times.push((frame as f64 / fps) as f32);
                frames.push(frame as i64);
                episodes.push(index as i64);
                tasks.push(episode.task as i64);
            }
        }
        let first = self.rows - self.states.len();
        let columns: [(&str, ArrayRef); 6] = [
            ("observation.state", states_column(&self.states)),
            ("timestamp", Arc::new(Float32Array::from(times))),
            ("frame_index", Arc::new(Int64Array::from(frames))),
            ("episode_index", Arc::new(Int64Array::from(episodes))),
            ("index", whole_numbers(first..self.rows)),
            ("task_index", Arc::new(Int64Array::from(tasks))),
        ];
        write_parquet(&self.data_path(self.files), columns)?;
        self.files += 1;
        self.pending_first = self.episodes.len();
        self.states.clear();
        Ok(())
    }

    fn data_path(&self, file: usize) -> PathBuf {
        let (chunk, file) = (file / CHUNK_FILES, file % CHUNK_FILES);
        self.folder
            .join(format!("data/chunk-{chunk:03}/file-{file:03}.parquet"))
    }

    fn finish(mut self, splits: &BTreeMap<&str, String>) -> Result<(), Error> {
        self.flush()?;
        let meta = self.folder.join("meta");
        let tasks: [(&str, ArrayRef); 2] = [
            ("task_index", whole_numbers(0..self.tasks.len())),
            ("task", Arc::new(StringArray::from_iter_values(&self.tasks))),
        ];
        write_parquet(&meta.join("tasks.parquet"), tasks)?;
        let episodes = meta.join("episodes/chunk-000/file-000.parquet");
        write_parquet(&episodes, self.episode_columns())?;
        self.write_json("meta/info.json", &self.info(splits))?;
        self.write_json("meta/stats.json", &self.statistics.json())
    }

    fn episode_columns(&self) -> [(&'static str, ArrayRef); 7] {
        let column = |value: fn(&Episode) -> usize| whole_numbers(self.episodes.iter().map(value));
        let element = Field::new("element", DataType::Utf8, true);
        let mut tasks = ListBuilder::new(StringBuilder::new()).with_field(element);
        for episode in &self.episodes {
            tasks.append_value([Some(&self.tasks[episode.task])]);
        }
        [
            ("episode_index", whole_numbers(0..self.episodes.len())),
            ("tasks", Arc::new(tasks.finish())),
            ("length", column(|episode| episode.length)),
            (
                "data/chunk_index",
                column(|episode| episode.file / CHUNK_FILES),
            ),
            (
                "data/file_index",
                column(|episode| episode.file % CHUNK_FILES),
            ),
            ("dataset_from_index", column(|episode| episode.first_row)),
            (
                "dataset_to_index",
                column(|episode| episode.first_row + episode.length),
            ),
        ]
    }

    fn info(&self, splits: &BTreeMap<&str, String>) -> serde_json::Value {
        let scalar = |dtype: &str| json!({ "dtype": dtype, "shape": [1], "names": null });
        json!({
            "codebase_version": "v3.0",
            "robot_type": self.dataset.manifest().skeleton,
            "total_episodes": self.episodes.len(),
            "total_frames": self.rows,
            "total_tasks": self.tasks.len(),
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": self.fps.map_or(0, |fps| fps.round() as i64),
            "splits": splits,
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": {
                "observation.state": {
                    "dtype": "float32",
                    "shape": [STATE_WIDTH],
                    "names": state_names(),
                },
                "timestamp": scalar("float32"),
                "frame_index": scalar("int64"),
                "episode_index": scalar("int64"),
                "index": scalar("int64"),
                "task_index": scalar("int64"),
            },
        })
    }

    fn write_json(&self, name: &str, value: &serde_json::Value) -> Result<(), Error> {
        let path = self.folder.join(name);
        let text = format!("{value:#}\n");
        fs::write(&path, text).map_err(Error::io("write", &path))
    }
}

fn state_names() -> Vec<String> {
    let mut names: Vec<String> = ["x", "y", "z"]
        .map(|axis| format!("transl.{axis}"))
        .to_vec();
    for joint in kinematics::skeleton::JOINT_NAMES
        .iter()
        .take(STATE_WIDTH / 3 - 1)
    {
        names.extend(["x", "y", "z"].map(|axis| format!("{joint}.{axis}")));
    }
    names
}

fn whole_numbers(values: impl IntoIterator<Item = usize>) -> ArrayRef {
    let values = values.into_iter().map(|value| value as i64);
    Arc::new(Int64Array::from_iter_values(values))
}

/// The states as a column of arrays of 69 numbers.
fn states_column(states: &[[f32; STATE_WIDTH]]) -> ArrayRef {
    let element = Field::new("element", DataType::Float32, true);
    let numbers = Float32Array::from(states.as_flattened().to_vec());
    Arc::new(FixedSizeListArray::new(
        Arc::new(element),
        STATE_WIDTH as i32,
        Arc::new(numbers),
        None,
    ))
}

fn write_parquet<const N: usize>(path: &Path, columns: [(&str, ArrayRef); N]) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    }
    let file = File::create(path).map_err(Error::io("create", path))?;
    let write = || -> Result<File, ParquetError> {
        let columns = columns.map(|(name, values)| (name, values, true));
        let table = RecordBatch::try_from_iter_with_nullable(columns)?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let mut writer = ArrowWriter::try_new(file, table.schema(), Some(properties))?;
        writer.write(&table)?;
        writer.into_inner()
    };
    let file = write().map_err(datasets_spec::Error::parquet("write", path))?;
    file.sync_all().map_err(Error::io("sync", path))
}

/// Mean, deviation and range of each number of the state, by Welford's update.
struct Statistics {
    frames: u64,
    mean: [f64; STATE_WIDTH],
    scatter: [f64; STATE_WIDTH],
    least: [f32; STATE_WIDTH],
    most: [f32; STATE_WIDTH],
}

impl Default for Statistics {
    fn default() -> Self {
        Self {
            frames: 0,
            mean: [0.0; STATE_WIDTH],
            scatter: [0.0; STATE_WIDTH],
            least: [f32::INFINITY; STATE_WIDTH],
            most: [f32::NEG_INFINITY; STATE_WIDTH],
        }
    }
}

impl Statistics {
    fn take(&mut self, state: &[f32; STATE_WIDTH]) {
        self.frames += 1;
        for (column, value) in state.iter().enumerate() {
            let before = f64::from(*value) - self.mean[column];
            self.mean[column] += before / self.frames as f64;
            self.scatter[column] += before * (f64::from(*value) - self.mean[column]);
            self.least[column] = self.least[column].min(*value);
            self.most[column] = self.most[column].max(*value);
        }
    }

    fn json(&self) -> serde_json::Value {
        let deviation: Vec<f64> = self
            .scatter
            .iter()
            .map(|scatter| (scatter / self.frames.max(1) as f64).sqrt())
            .collect();
        json!({
            "observation.state": {
                "mean": self.mean.to_vec(),
                "std": deviation,
                "min": self.least.to_vec(),
                "max": self.most.to_vec(),
                "count": [self.frames],
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use arrow_array::cast::AsArray;
    use arrow_array::types::{Float32Type, Int64Type};
    use datasets_spec::dataset::commit_rows;
    use datasets_spec::table::Caption;
    use datasets_spec::{NoProgress, Skeleton};
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

    use super::*;
    use crate::compose::fixture::{motion_row, wandering};

    fn table(path: &Path) -> RecordBatch {
        let file = File::open(path).expect("written");
        let mut reader = ParquetRecordBatchReaderBuilder::try_new(file)
            .and_then(ParquetRecordBatchReaderBuilder::build)
            .expect("Parquet");
        reader.next().expect("rows").expect("a batch")
    }

    #[test]
    fn frames_are_rows_and_episodes_say_which() {
        let row = |id: &str, split, frames| motion_row(id, split, &wandering(id, frames));
        let mut said = row("b", Split::Val, 30);
        said.captions = vec![Caption {
            text: "wave".to_owned(),
            ..Caption::default()
        }];
        let rows = [row("a", Split::Train, 20), said];
        let dir = tempfile::tempdir().expect("temporary folder");
        let dataset = commit_rows(
            &dir.path().join("dataset"),
            &rows,
            Some(|row: &MotionRow| row.split),
            &Skeleton::smplx_neutral(),
            "plan",
            "test",
        )
        .expect("committed");
        let out = dir.path().join("out");
        assert_eq!(write(&dataset, &out, &NoProgress).expect("written"), 2);

        let data = table(&out.join("data/chunk-000/file-000.parquet"));
        assert_eq!(data.num_rows(), 50);
        let whole = |table: &RecordBatch, name: &str| {
            let column = table.column_by_name(name).expect("a column");
            column.as_primitive::<Int64Type>().values().to_vec()
        };
        assert_eq!(whole(&data, "index"), (0..50).collect::<Vec<i64>>());
        assert_eq!(whole(&data, "frame_index")[19..21], [19, 0]);
        assert_eq!(whole(&data, "episode_index")[19..21], [0, 1]);
        let states = data["observation.state"].as_fixed_size_list();
        let last = states.value(49);
        let last = last.as_primitive::<Float32Type>().values();
        assert_eq!(last[..3], rows[1].transl[29]);
        assert_eq!(last[3..6], rows[1].global_orient[29]);
        assert_eq!(last[6..], rows[1].body_pose[29]);

        let tasks = table(&out.join("meta/tasks.parquet"));
        let texts: Vec<_> = tasks["task"].as_string::<i32>().iter().flatten().collect();
        assert_eq!(texts, [NO_TASK, "wave"]);
        let episodes = table(&out.join("meta/episodes/chunk-000/file-000.parquet"));
        assert_eq!(whole(&episodes, "length"), [20, 30]);
        assert_eq!(whole(&episodes, "dataset_from_index"), [0, 20]);
        assert_eq!(whole(&episodes, "dataset_to_index"), [20, 50]);
        let said = episodes["tasks"].as_list::<i32>().value(1);
        assert_eq!(said.as_string::<i32>().value(0), "wave");
    }
}
