//! LeRobot v3: one row per frame, with separate tables of episodes and tasks.
//!
//! A clip is an episode, its first caption is its task, and `observation.state` holds the 69 numbers of a frame:
//! translation, root orientation and body pose, as in the `motions` table. The table of episodes has the clip's id,
//! split, labels, captions and licence in columns of their own, which LeRobot ignores. Captions made from file names
//! are left out.
//!
//! # Source
//! `lerobot` 0.4.4, whose tools `tests/python` runs on an export.

mod statistics;

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::builder::{ListBuilder, StringBuilder};
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Int64Array, ListArray, RecordBatch, StringArray,
};
use arrow_schema::{DataType, Field};
use datasets_spec::record::MotionRow;
use datasets_spec::{Progress, Split};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use serde_json::json;

use self::statistics::{STATE_WIDTH, Statistics};
use super::Exported;
use super::document::write_json;
use super::left_out::put;
use crate::Error;
use crate::clips::Clips;

/// A data file ends with the episode that reaches this number of rows: about 30 MB.
const FILE_FRAMES: usize = 100_000;
/// Rows of a file of the table of episodes: about 50 MB, most of it statistics.
const FILE_EPISODES: usize = 10_000;
const CHUNK_FILES: usize = 1000;
/// Task of a clip without a caption: nobody said what it does.
const NO_TASK: &str = "";

pub(super) fn write(
    clips: &Clips,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    progress.begin("export lerobot", Some(clips.len()));
    let mut writer = Writer {
        robot_type: clips.dataset().manifest().skeleton.clone(),
        folder: folder.to_owned(),
        ..Writer::default()
    };
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let first = writer.num_episodes;
        for shard in clips.shards(Some(split)) {
            for row in shard.read()? {
                writer.episode(row)?;
                progress.advance(1);
            }
        }
        if writer.num_episodes > first {
            splits.insert(split.as_str(), format!("{first}:{}", writer.num_episodes));
        }
    }
    let without_task = writer.without_task;
    writer.finish(&splits)?;
    progress.finish(&format!("{} episodes", clips.len()));
    let mut exported = Exported::of(clips.len());
    let left_out = &mut exported.left_out;
    put(left_out, "tasks_of_clips_without_captions", without_task);
    Ok(exported)
}

struct Episode {
    index: usize,
    task: usize,
    length: usize,
    first_row: usize,
    file: usize,
    statistics: Statistics,
    clip: MotionRow,
}

#[derive(Default)]
struct Writer {
    robot_type: String,
    folder: PathBuf,
    fps: Option<f32>,
    tasks: Vec<String>,
    task_places: BTreeMap<String, usize>,
    num_episodes: usize,
    /// Number of clips without a caption.
    without_task: u64,
    episodes: Vec<Episode>,
    /// Frames to be written to the next file; `places` holds the episode, frame and task of each.
    states: Vec<[f32; STATE_WIDTH]>,
    places: Vec<[usize; 3]>,
    files: usize,
    rows: usize,
    statistics: Option<Statistics>,
}

impl Writer {
    fn episode(&mut self, mut row: MotionRow) -> Result<(), Error> {
        let fps = *self.fps.get_or_insert(row.fps);
        if fps != row.fps {
            return Err(Error::refused(format!(
                "clip {} is at {} fps and others at {fps}; ingest with one --fps",
                row.id, row.fps
            )));
        }
        let said = row.stated_captions().next();
        let text = said.map(|caption| caption.text.as_str());
        self.without_task += u64::from(text.is_none());
        let text = text.unwrap_or(NO_TASK).to_owned();
        let next = self.tasks.len();
        let task = *self.task_places.entry(text.clone()).or_insert(next);
        if task == next {
            self.tasks.push(text);
        }
        let transl = std::mem::take(&mut row.transl);
        let orient = std::mem::take(&mut row.global_orient);
        let pose = std::mem::take(&mut row.body_pose);
        let frames = transl.iter().zip(&orient).zip(&pose);
        let states: Vec<[f32; STATE_WIDTH]> = frames
            .map(|((transl, orient), pose)| {
                let mut state = [0.0; STATE_WIDTH];
                state[..3].copy_from_slice(transl);
                state[3..6].copy_from_slice(orient);
                state[6..].copy_from_slice(pose);
                state
            })
            .collect();
        let statistics = Statistics::of(&states);
        match &mut self.statistics {
            Some(all) => all.add(&statistics),
            None => self.statistics = Some(statistics.clone()),
        }
        let index = self.num_episodes;
        self.episodes.push(Episode {
            index,
            task,
            length: states.len(),
            first_row: self.rows,
            file: self.files,
            statistics,
            clip: row,
        });
        self.num_episodes += 1;
        self.rows += states.len();
        let places = (0..states.len()).map(|frame| [index, frame, task]);
        self.places.extend(places);
        self.states.extend(states);
        // Checked after whole episodes: an episode is not split over files.
        if self.states.len() >= FILE_FRAMES {
            self.write_frames()?;
        }
        if self.episodes.len() == FILE_EPISODES {
            self.write_episodes()?;
        }
        Ok(())
    }

    fn write_frames(&mut self) -> Result<(), Error> {
        if self.states.is_empty() {
            return Ok(());
        }
        let fps = rate(self.fps);
        let place = |which: usize| whole_numbers(self.places.iter().map(|place| place[which]));
        let times = self
            .places
            .iter()
            .map(|place| (place[1] as f64 / fps) as f32);
        let first = self.rows - self.states.len();
        let columns: [(&str, ArrayRef); 6] = [
            ("observation.state", states_column(&self.states)),
            ("timestamp", Arc::new(Float32Array::from_iter_values(times))),
            ("frame_index", place(1)),
            ("episode_index", place(0)),
            ("index", whole_numbers(first..self.rows)),
            ("task_index", place(2)),
        ];
        write_parquet(&self.path("data", self.files), columns, HashMap::new())?;
        self.files += 1;
        self.places.clear();
        self.states.clear();
        Ok(())
    }

    fn write_episodes(&mut self) -> Result<(), Error> {
        let Some(first) = self.episodes.first() else {
            return Ok(());
        };
        let file = first.index / FILE_EPISODES;
        let columns = episode_columns(&self.episodes, &self.tasks, file);
        write_parquet(&self.path("meta/episodes", file), columns, HashMap::new())?;
        self.episodes.clear();
        Ok(())
    }

    fn path(&self, table: &str, file: usize) -> PathBuf {
        let (chunk, file) = (file / CHUNK_FILES, file % CHUNK_FILES);
        self.folder
            .join(format!("{table}/chunk-{chunk:03}/file-{file:03}.parquet"))
    }

    fn finish(mut self, splits: &BTreeMap<&str, String>) -> Result<(), Error> {
        self.write_frames()?;
        self.write_episodes()?;
        let tasks: [(&str, ArrayRef); 2] = [
            ("task_index", whole_numbers(0..self.tasks.len())),
            ("task", Arc::new(StringArray::from_iter_values(&self.tasks))),
        ];
        let path = self.folder.join("meta/tasks.parquet");
        write_parquet(&path, tasks, tasks_index())?;
        write_json(&self.folder, "meta/info.json", &self.info(splits))?;
        let statistics = self.statistics.as_ref().map(Statistics::json);
        let statistics = statistics.unwrap_or_default();
        write_json(&self.folder, "meta/stats.json", &statistics)
    }

    fn info(&self, splits: &BTreeMap<&str, String>) -> serde_json::Value {
        let scalar = |dtype: &str| json!({ "dtype": dtype, "shape": [1], "names": null });
        let fps = rate(self.fps);
        json!({
            "codebase_version": "v3.0",
            "robot_type": self.robot_type,
            "total_episodes": self.num_episodes,
            "total_frames": self.rows,
            "total_tasks": self.tasks.len(),
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": if fps.fract() == 0.0 { json!(fps as i64) } else { json!(fps) },
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
}

/// The rate as it was stated: 29.97 is stored in single precision, and must not become 29.969999313354492.
fn rate(fps: Option<f32>) -> f64 {
    let fps = fps.unwrap_or(1.0);
    fps.to_string().parse().unwrap_or(f64::from(fps))
}

/// Columns of a file of the table of episodes. Missing labels are empty texts, because pandas loses the type of a
/// column of nulls.
fn episode_columns(episodes: &[Episode], tasks: &[String], file: usize) -> Vec<(String, ArrayRef)> {
    let number = |value: &dyn Fn(&Episode) -> usize| whole_numbers(episodes.iter().map(value));
    let text = |value: &dyn Fn(&MotionRow) -> String| -> ArrayRef {
        let texts = episodes.iter().map(|episode| value(&episode.clip));
        Arc::new(StringArray::from_iter_values(texts))
    };
    let label = |label: &Option<String>| label.clone().unwrap_or_default();
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("episode_index", number(&|episode| episode.index)),
        (
            "tasks",
            texts_column(episodes.iter().map(|episode| vec![&*tasks[episode.task]])),
        ),
        ("length", number(&|episode| episode.length)),
        (
            "data/chunk_index",
            number(&|episode| episode.file / CHUNK_FILES),
        ),
        (
            "data/file_index",
            number(&|episode| episode.file % CHUNK_FILES),
        ),
        ("dataset_from_index", number(&|episode| episode.first_row)),
        (
            "dataset_to_index",
            number(&|episode| episode.first_row + episode.length),
        ),
        ("meta/episodes/chunk_index", number(&|_| file / CHUNK_FILES)),
        ("meta/episodes/file_index", number(&|_| file % CHUNK_FILES)),
        ("id", text(&|clip| clip.id.to_string())),
        ("split", text(&|clip| clip.split.to_string())),
        ("source", text(&|clip| clip.source.clone())),
        ("license", text(&|clip| label(&clip.license))),
        ("action", text(&|clip| label(&clip.action))),
        ("style", text(&|clip| label(&clip.style))),
        (
            "captions",
            texts_column(episodes.iter().map(|episode| {
                let said = episode.clip.stated_captions();
                said.map(|caption| caption.text.as_str()).collect()
            })),
        ),
    ];
    let counts = episodes.iter();
    let counts = counts.map(|episode| Some([Some(episode.statistics.frames as i64)]));
    let counts = ListArray::from_iter_primitive::<Int64Type, _, _>(counts);
    columns.push(("stats/observation.state/count", Arc::new(counts)));
    let mut columns: Vec<(String, ArrayRef)> = columns
        .into_iter()
        .map(|(name, values)| (name.to_owned(), values))
        .collect();
    let named = episodes.iter().map(|episode| episode.statistics.named());
    let named: Vec<_> = named.collect();
    let names = named.first().into_iter().flatten().map(|(name, _)| *name);
    for (place, name) in names.enumerate() {
        let values = named.iter().map(|named| Some(named[place].1.map(Some)));
        let values = ListArray::from_iter_primitive::<Float64Type, _, _>(values);
        let name = format!("stats/observation.state/{name}");
        columns.push((name, Arc::new(values)));
    }
    columns
}

fn texts_column<'a>(lists: impl Iterator<Item = Vec<&'a str>>) -> ArrayRef {
    let element = Field::new("element", DataType::Utf8, true);
    let mut column = ListBuilder::new(StringBuilder::new()).with_field(element);
    for list in lists {
        column.append_value(list.into_iter().map(Some));
    }
    Arc::new(column.finish())
}

/// Metadata that makes the text the pandas index of the tasks, because LeRobot looks up tasks by text.
fn tasks_index() -> HashMap<String, String> {
    let column = |name: &str, kind: &str, numpy: &str| {
        json!({
            "name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": null
        })
    };
    let description = json!({
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            column("task_index", "int64", "int64"),
            column("task", "unicode", "object"),
        ],
        "creator": { "library": "stance", "version": env!("CARGO_PKG_VERSION") },
        "pandas_version": "2.2.0",
    });
    HashMap::from([("pandas".to_owned(), description.to_string())])
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

fn write_parquet<N: AsRef<str>>(
    path: &Path,
    columns: impl IntoIterator<Item = (N, ArrayRef)>,
    facts: HashMap<String, String>,
) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(datasets_spec::Error::io("create folder", folder))?;
    }
    let file = File::create(path).map_err(datasets_spec::Error::io("create", path))?;
    let columns = columns
        .into_iter()
        .map(|(name, values)| (name, values, true));
    let write = || -> Result<File, ParquetError> {
        let table = RecordBatch::try_from_iter_with_nullable(columns)?;
        let schema = table.schema().as_ref().clone().with_metadata(facts);
        let table = table.with_schema(Arc::new(schema))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let mut writer = ArrowWriter::try_new(file, table.schema(), Some(properties))?;
        writer.write(&table)?;
        writer.into_inner()
    };
    let file = write().map_err(datasets_spec::Error::parquet("write", path))?;
    Ok(file
        .sync_all()
        .map_err(datasets_spec::Error::io("sync", path))?)
}

#[cfg(test)]
mod tests {
    use arrow_array::cast::AsArray;
    use arrow_array::types::{Float32Type, Int64Type};
    use datasets_spec::NoProgress;
    use datasets_spec::table::Caption;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use testkit::{commit, motion_row, wandering};

    use super::*;

    fn table(path: &Path) -> RecordBatch {
        let file = File::open(path).expect("written");
        let mut reader = ParquetRecordBatchReaderBuilder::try_new(file)
            .and_then(ParquetRecordBatchReaderBuilder::build)
            .expect("Parquet");
        reader.next().expect("rows").expect("a batch")
    }

    #[test]
    fn a_rate_is_written_as_it_was_stated() {
        assert_eq!(rate(Some(29.97)), 29.97);
        assert_eq!(rate(Some(20.0)), 20.0);
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
        let dataset = commit(&dir.path().join("dataset"), &rows, |row| row.split, "plan");
        let out = dir.path().join("out");
        let written = write(&Clips::all(&dataset), &out, &NoProgress);
        let written = written.expect("written");
        assert_eq!(written.clips, 2);
        let without_task = [("tasks_of_clips_without_captions".to_owned(), 1)];
        assert_eq!(written.left_out, without_task.into());

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
        let file = File::open(out.join("meta/tasks.parquet")).expect("written");
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).expect("Parquet");
        let index = &reader.schema().metadata()["pandas"];
        assert!(index.contains(r#""index_columns":["task"]"#), "{index}");
        let texts: Vec<_> = tasks["task"].as_string::<i32>().iter().flatten().collect();
        assert_eq!(texts, [NO_TASK, "wave"]);
        let episodes = table(&out.join("meta/episodes/chunk-000/file-000.parquet"));
        assert_eq!(whole(&episodes, "length"), [20, 30]);
        assert_eq!(whole(&episodes, "dataset_from_index"), [0, 20]);
        assert_eq!(whole(&episodes, "dataset_to_index"), [20, 50]);
        let said = episodes["tasks"].as_list::<i32>().value(1);
        assert_eq!(said.as_string::<i32>().value(0), "wave");
        assert_eq!(whole(&episodes, "meta/episodes/file_index"), [0, 0]);
        let ids: Vec<_> = episodes["id"].as_string::<i32>().iter().flatten().collect();
        assert_eq!(ids, ["a", "b"]);
    }
}
