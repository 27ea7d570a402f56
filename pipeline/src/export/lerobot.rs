//! LeRobot v3: one row a frame, episodes and tasks in tables of their own.
//!
//! A clip is an episode, its first caption its task, and `observation.state` a frame's 69 numbers:
//! translation, root orientation and body pose, as in the `motions` table.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Progress, Split};
use polars::prelude::*;
use serde_json::json;

use crate::Error;

/// Numbers of a frame.
const STATE_WIDTH: usize = 69;
/// Rows of a data file: about 30 MB.
const FILE_FRAMES: usize = 100_000;
/// Files of a chunk, as the format has it.
const CHUNK_FILES: usize = 1000;
/// What a clip without a caption is said to do.
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

/// Where an episode's frames are.
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
        let said = row.captions.first().map(|caption| caption.text.as_str());
        let text = said.unwrap_or(NO_TASK).to_owned();
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

    /// Writes the waiting frames as a file.
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
        let indices: Vec<i64> = (first..self.rows).map(|row| row as i64).collect();
        let state = fixed_width(&self.states)?;
        let mut table = DataFrame::new_infer_height(vec![
            state,
            Column::new("timestamp".into(), times),
            Column::new("frame_index".into(), frames),
            Column::new("episode_index".into(), episodes),
            Column::new("index".into(), indices),
            Column::new("task_index".into(), tasks),
        ])
        .map_err(Error::table("lerobot data"))?;
        let path = self.data_path(self.files);
        write_parquet(&path, &mut table)?;
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
        let indices: Vec<i64> = (0..self.tasks.len() as i64).collect();
        let mut tasks = DataFrame::new_infer_height(vec![
            Column::new("task_index".into(), indices),
            Column::new("task".into(), self.tasks.clone()),
        ])
        .map_err(Error::table("lerobot tasks"))?;
        write_parquet(&meta.join("tasks.parquet"), &mut tasks)?;
        let mut episodes = self.episode_table()?;
        write_parquet(
            &meta.join("episodes/chunk-000/file-000.parquet"),
            &mut episodes,
        )?;
        self.write_json("meta/info.json", &self.info(splits))?;
        self.write_json("meta/stats.json", &self.statistics.json())
    }

    fn episode_table(&self) -> Result<DataFrame, Error> {
        let column = |name: &str, value: &dyn Fn(usize, &Episode) -> i64| {
            let values: Vec<i64> = self
                .episodes
                .iter()
                .enumerate()
                .map(|(index, episode)| value(index, episode))
                .collect();
            Column::new(name.into(), values)
        };
        let tasks: Vec<Series> = self
            .episodes
            .iter()
            .map(|episode| Series::new("".into(), [self.tasks[episode.task].as_str()]))
            .collect();
        DataFrame::new_infer_height(vec![
            column("episode_index", &|index, _| index as i64),
            Column::new("tasks".into(), tasks),
            column("length", &|_, episode| episode.length as i64),
            column("data/chunk_index", &|_, episode| {
                (episode.file / CHUNK_FILES) as i64
            }),
            column("data/file_index", &|_, episode| {
                (episode.file % CHUNK_FILES) as i64
            }),
            column("dataset_from_index", &|_, episode| episode.first_row as i64),
            column("dataset_to_index", &|_, episode| {
                (episode.first_row + episode.length) as i64
            }),
        ])
        .map_err(Error::table("lerobot episodes"))
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

/// The states as a column of arrays of 69 numbers.
fn fixed_width(states: &[[f32; STATE_WIDTH]]) -> Result<Column, Error> {
    let flat = Series::new("observation.state".into(), states.as_flattened());
    let shape = [
        ReshapeDimension::Infer,
        ReshapeDimension::new_dimension(STATE_WIDTH as u64),
    ];
    let arrays = flat
        .reshape_array(&shape)
        .map_err(Error::table("lerobot states"))?;
    Ok(arrays.into())
}

fn write_parquet(path: &Path, table: &mut DataFrame) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    }
    let mut file = File::create(path).map_err(Error::io("create", path))?;
    ParquetWriter::new(&mut file)
        .finish(table)
        .map_err(Error::table("lerobot file"))?;
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
