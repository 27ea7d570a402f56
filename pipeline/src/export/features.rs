//! Folders of features per clip, with captions, split lists and statistics: HumanML3D-272, BABEL-272,
//! MotionMillion, and the 201 features of HY-Motion in the same form.

use std::collections::BTreeMap;
use std::ops::{Range, RangeInclusive};
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Motion, Skeleton, Split};
use features::{Statistics, hy_motion, representation_272};
use pickle::npy;

use super::by_clip::{ByClip, Note, labels, sorted_lines};
use super::clips::stems;
use super::document::{Lines, file, read_features};
use super::humanml3d::{caption_line, names};
use super::paths::{safe_stem, unique};
use crate::Error;
use crate::clips::Clips;

type Features<const WIDTH: usize> = Vec<[f32; WIDTH]>;

pub(super) struct Recipe<const WIDTH: usize> {
    features: fn(&Motion, &Skeleton) -> Result<Features<WIDTH>, kinematics::Error>,
    /// Groups of columns whose deviations are averaged.
    groups: &'static [(&'static str, Range<usize>)],
}

pub(super) const DIM_272: Recipe<{ representation_272::WIDTH }> = Recipe {
    features: representation_272::features_of_motion,
    groups: &representation_272::GROUPS,
};

pub(super) const DIM_201: Recipe<{ hy_motion::WIDTH }> = Recipe {
    features: hy_motion::features_of_motion,
    groups: &[],
};

pub(super) struct Form {
    motions: &'static str,
    mean: &'static str,
    std: &'static str,
    /// Folders of split lists, with the frame counts of the clips that they list.
    lists: &'static [(&'static str, RangeInclusive<usize>)],
    /// Whether clips are named by their ids, captions are plain lines, and a list `all.txt` joins those of the splits.
    /// Otherwise names and captions are those of HumanML3D.
    is_plain: bool,
}

const ANY_LENGTH: RangeInclusive<usize> = 0..=usize::MAX;

pub(super) const HUMANML3D_272: Form = Form {
    motions: "motion_data",
    mean: "mean_std/Mean.npy",
    std: "mean_std/Std.npy",
    lists: &[("split", ANY_LENGTH)],
    is_plain: false,
};

pub(super) const BABEL_272: Form = Form {
    mean: "t2m_babel_mean_std/Mean.npy",
    std: "t2m_babel_mean_std/Std.npy",
    ..HUMANML3D_272
};

/// MotionMillion. Its lists for generation and for tokenisers take only clips of certain lengths; `any_length` holds
/// all clips, so that none loses its split.
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

/// HY-Motion. Only the statistics of its training folders are published, so the rest is as in [`HUMANML3D_272`].
pub(super) const HY_MOTION: Form = Form {
    mean: "stats/Mean.npy",
    std: "stats/Std.npy",
    ..HUMANML3D_272
};

/// A folder of features. `ids.csv` lists the name, the split and the licence of each id. Captions made from file names
/// are left out. Plain captions cannot store times, so captions of a part of a clip are left out there.
pub(super) struct FeatureFolder<const WIDTH: usize> {
    form: &'static Form,
    recipe: &'static Recipe<WIDTH>,
    skeleton: Skeleton,
    names: BTreeMap<String, String>,
}

impl<const WIDTH: usize> FeatureFolder<WIDTH> {
    pub(super) fn new(
        clips: &Clips,
        form: &'static Form,
        recipe: &'static Recipe<WIDTH>,
    ) -> Result<Self, Error> {
        Ok(Self {
            form,
            recipe,
            skeleton: clips.dataset().skeleton()?,
            names: if form.is_plain {
                stems(clips, |id, taken| unique(safe_stem(id, ".npy"), taken))?
            } else {
                names(clips)?
            },
        })
    }

    fn name(&self, id: &str) -> &str {
        self.names.get(id).map_or("", String::as_str)
    }

    fn motion(&self, name: &str) -> String {
        format!("{}/{name}.npy", self.form.motions)
    }
}

impl<const WIDTH: usize> ByClip for FeatureFolder<WIDTH> {
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error> {
        let name = self.name(row.id.as_str());
        let features = (self.recipe.features)(&row.motion()?, &self.skeleton)?;
        let vector = npy::encode(&[features.len(), WIDTH], features.as_flattened());
        file(folder, &self.motion(name), &vector)?;
        let lines: String = match self.form.is_plain {
            false => row.stated_captions().map(caption_line).collect(),
            true => row
                .stated_captions()
                .filter(|caption| caption.from_s == 0.0 && caption.to_s == 0.0)
                .map(|caption| caption.text.replace(['\r', '\n'], " ") + "\n")
                .collect(),
        };
        // Written even if empty: a loader opens the text of every clip, and skips a clip whose text is empty.
        file(folder, &format!("texts/{name}.txt"), lines.as_bytes())?;
        Ok(None)
    }

    fn finish(&self, clips: &Clips, _: &[Note], folder: &Path) -> Result<u64, Error> {
        let mut statistics = Statistics::<WIDTH>::default();
        let mut listed: BTreeMap<Split, Vec<(&str, usize)>> = BTreeMap::new();
        let mut lines = Lines::new(["name", "id", "split", "license"]);
        for (id, split, license) in labels(clips)? {
            let name = self.name(&id);
            lines.take([name, &id, split.as_str(), &license]);
            let features = read_features::<WIDTH>(&folder.join(self.motion(name)))?;
            statistics.take(&features);
            let listed = listed.entry(split).or_default();
            listed.push((name, features.len()));
        }
        for (list, lengths) in self.form.lists {
            let names = |splits: &[Split]| -> String {
                let listed = splits.iter().filter_map(|split| listed.get(split));
                let fitting = listed.flatten().filter(|(_, len)| lengths.contains(len));
                sorted_lines(fitting.map(|(name, _)| *name).collect())
            };
            for split in Split::ALL {
                let path = format!("{list}/{split}.txt");
                file(folder, &path, names(&[split]).as_bytes())?;
            }
            if self.form.is_plain {
                let path = format!("{list}/all.txt");
                file(folder, &path, names(&Split::ALL).as_bytes())?;
            }
        }
        let mean = npy::encode(&[WIDTH], &statistics.mean());
        file(folder, self.form.mean, &mean)?;
        let std = npy::encode(&[WIDTH], &statistics.std_by(self.recipe.groups));
        file(folder, self.form.std, &std)?;
        file(folder, "ids.csv", &lines.into_bytes())?;
        Ok(clips.len())
    }
}
