//! Folders of features per clip, with captions, split lists and statistics: HumanML3D-272, BABEL-272,
//! MotionMillion, and the 201 features of HY-Motion in the same form.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::{Range, RangeInclusive};
use std::path::{Path, PathBuf};

use datasets_spec::record::MotionRow;
use datasets_spec::{Motion, Progress, Skeleton, Split};
use pickle::npy;
use rayon::prelude::*;

use super::humanml3d::{caption_line, ids, names};
use super::paths::{safe_stem, unique};
use crate::Error;
use crate::feature::{Statistics, hy_motion, representation_272};
use crate::filter::Clips;

type Features<const WIDTH: usize> = Vec<[f32; WIDTH]>;

/// How features are computed.
pub(super) struct Recipe<const WIDTH: usize> {
    features: fn(&Motion, &Skeleton) -> Result<Features<WIDTH>, kinematics::Error>,
    /// Groups in which the deviation is averaged.
    groups: &'static [(&'static str, Range<usize>)],
}

/// The 272 features.
pub(super) const DIM_272: Recipe<{ representation_272::WIDTH }> = Recipe {
    features: representation_272::features_of_motion,
    groups: &representation_272::GROUPS,
};

/// The 201 features.
pub(super) const DIM_201: Recipe<{ hy_motion::WIDTH }> = Recipe {
    features: hy_motion::features_of_motion,
    groups: &[],
};

/// Names of the folders and files.
pub(super) struct Form {
    motions: &'static str,
    mean: &'static str,
    std: &'static str,
    /// Folders of split lists, with the numbers of frames of the clips in them.
    lists: &'static [(&'static str, RangeInclusive<usize>)],
    /// Clips are named by their ids, captions are plain lines, and a list `all.txt` joins those of the splits.
    /// Otherwise names and captions are those of HumanML3D.
    is_plain: bool,
}

const ANY_LENGTH: RangeInclusive<usize> = 0..=usize::MAX;

/// HumanML3D-272.
pub(super) const HUMANML3D_272: Form = Form {
    motions: "motion_data",
    mean: "mean_std/Mean.npy",
    std: "mean_std/Std.npy",
    lists: &[("split", ANY_LENGTH)],
    is_plain: false,
};

/// BABEL-272.
pub(super) const BABEL_272: Form = Form {
    mean: "t2m_babel_mean_std/Mean.npy",
    std: "t2m_babel_mean_std/Std.npy",
    ..HUMANML3D_272
};

/// MotionMillion. Its lists for generation and for tokenisers take clips of some lengths; `any_length` holds all
/// clips, so that none loses its split.
pub(super) const MOTIONMILLION: Form = Form {
    motions: "motion_data/vector_272",
    mean: "mean_std/vector_272/mean.npy",
    std: "mean_std/vector_272/std.npy",
    lists: &[
        ("split/version1/t2m_60_300", 60..=300),
        ("split/version1/tokenizer_96", 96..=usize::MAX),
        ("split/version1/any_length", ANY_LENGTH),
    ],
    is_plain: true,
};

/// HY-Motion, of whose training folders only the statistics are published.
pub(super) const HY_MOTION: Form = Form {
    mean: "stats/Mean.npy",
    std: "stats/Std.npy",
    ..HUMANML3D_272
};

/// Writes a folder of features, and returns how many clips are in it. `ids.csv` lists the name, the split and the
/// licence of each id. Captions made from file names are left out; plain captions cannot hold a time, so those of a
/// part of the clip are too.
///
/// # Errors
/// The dataset cannot be read or a file cannot be written.
pub(super) fn write<const WIDTH: usize>(
    clips: &Clips,
    folder: &Path,
    form: &Form,
    recipe: &Recipe<WIDTH>,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    let skeleton = clips.dataset().skeleton()?;
    let mut writer = Writer {
        root: folder.to_owned(),
        form,
        names: if form.is_plain {
            paths(clips)?
        } else {
            names(clips)?
        },
        statistics: Statistics::<WIDTH>::default(),
        listed: BTreeMap::new(),
        ids: csv::Writer::from_writer(Vec::new()),
    };
    writer.note(["name", "id", "split", "license"])?;
    progress.begin("export features", Some(clips.len()));
    for shard in clips.shards(None) {
        let rows = shard.read()?;
        let features: Vec<Features<WIDTH>> = rows
            .par_iter()
            .map(|row| {
                let features = (recipe.features)(&row.motion()?, &skeleton)?;
                progress.advance(1);
                Ok(features)
            })
            .collect::<Result<_, Error>>()?;
        for (row, features) in rows.iter().zip(&features) {
            writer.take(row, features)?;
        }
    }
    writer.finish(recipe.groups)?;
    progress.finish(&format!("{} clips", clips.len()));
    Ok(clips.len())
}

/// The path each motion gets, by its id.
fn paths(clips: &Clips) -> Result<BTreeMap<String, String>, Error> {
    let mut taken = BTreeSet::new();
    let ids = ids(clips)?.into_iter();
    Ok(ids
        .map(|(id, _)| {
            let path = unique(safe_stem(&id, ".npy"), &mut taken);
            (id, path)
        })
        .collect())
}

/// A folder that is being written.
struct Writer<'a, const WIDTH: usize> {
    root: PathBuf,
    form: &'a Form,
    names: BTreeMap<String, String>,
    statistics: Statistics<WIDTH>,
    /// Names and lengths of the clips of each split.
    listed: BTreeMap<Split, Vec<(String, usize)>>,
    ids: csv::Writer<Vec<u8>>,
}

impl<const WIDTH: usize> Writer<'_, WIDTH> {
    fn take(&mut self, row: &MotionRow, features: &[[f32; WIDTH]]) -> Result<(), Error> {
        let id = row.id.as_str();
        let name = self.names.get(id).cloned().unwrap_or_default();
        let license = row.license.as_deref().unwrap_or_default();
        self.note([&name, id, row.split.as_str(), license])?;
        let motion = format!("{}/{name}.npy", self.form.motions);
        let vector = npy::encode(&[features.len(), WIDTH], features.as_flattened());
        self.file(&motion, &vector)?;
        let lines: String = match self.form.is_plain {
            false => row.stated_captions().map(caption_line).collect(),
            true => row
                .stated_captions()
                .filter(|caption| caption.from_s == 0.0 && caption.to_s == 0.0)
                .map(|caption| caption.text.replace(['\r', '\n'], " ") + "\n")
                .collect(),
        };
        // Loaders open the file of every clip; a clip whose file is empty is passed over.
        self.file(&format!("texts/{name}.txt"), lines.as_bytes())?;
        self.statistics.take(features);
        let listed = self.listed.entry(row.split).or_default();
        listed.push((name, features.len()));
        Ok(())
    }

    fn finish(self, groups: &[(&str, Range<usize>)]) -> Result<(), Error> {
        for (folder, lengths) in self.form.lists {
            let names = |splits: &[Split]| -> String {
                let listed = splits.iter().filter_map(|split| self.listed.get(split));
                let fitting = listed.flatten().filter(|(_, len)| lengths.contains(len));
                let mut names: Vec<&str> = fitting.map(|(name, _)| name.as_str()).collect();
                names.sort_unstable();
                names.iter().flat_map(|name| [*name, "\n"]).collect()
            };
            for split in Split::ALL {
                self.file(&format!("{folder}/{split}.txt"), names(&[split]).as_bytes())?;
            }
            if self.form.is_plain {
                self.file(&format!("{folder}/all.txt"), names(&Split::ALL).as_bytes())?;
            }
        }
        let mean = npy::encode(&[WIDTH], &self.statistics.mean());
        self.file(self.form.mean, &mean)?;
        let std = npy::encode(&[WIDTH], &self.statistics.std_by(groups));
        self.file(self.form.std, &std)?;
        let lines = self.ids.into_inner().unwrap_or_default();
        file(&self.root, "ids.csv", &lines)
    }

    fn note(&mut self, fields: [&str; 4]) -> Result<(), Error> {
        let written = self.ids.write_record(fields).map_err(std::io::Error::from);
        written.map_err(Error::io("write", self.root.join("ids.csv")))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<(), Error> {
        file(&self.root, name, bytes)
    }
}

fn file(root: &Path, name: &str, bytes: &[u8]) -> Result<(), Error> {
    let path = root.join(name);
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
    }
    fs::write(&path, bytes).map_err(Error::io("write", &path))
}
