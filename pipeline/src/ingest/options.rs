//! Options of an ingestion.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use clip::check::Teleports;
use datasets_spec::{Fps, Resample, Seed, Skeleton};
use features::humanml3d;
use formats::markers::MarkerSet;
use formats::retarget::UserMap;
use formats::source::body_model::Subjects;
use formats::source::{Format, ReadOptions, Unit, Up, format_named};
use serde::{Deserialize, Serialize};

use super::id_list::IdList;
use super::split_by::SplitBy;
use super::split_list::SplitList;
use crate::Error;
use crate::annotation::pairs::PairList;
use crate::facts::json;
use work::{absolute, hash_file};

/// Version of the code that turns files into rows. A dataset made by an older version is read again.
const INGEST_VERSION: u32 = 4;

/// Fact of a manifest: remarks for readers on its splits.
pub const REMARKS_FACT: &str = "remarks";

/// Fact of a manifest: lines of the list of pairs that gave no pair, as JSON.
pub(super) const REFUSED_PAIRS_FACT: &str = "refused_pairs";

/// Fact of a manifest: labels that could not be used, as JSON.
pub(super) const LABEL_PROBLEMS_FACT: &str = "label_problems";

/// Options of an ingestion.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IngestOptions {
    /// Rate to store at; `None` keeps the rate of each clip.
    pub fps: Option<Fps>,
    /// How clips are brought to that rate.
    pub resample: Resample,
    /// Accept this format only; files of other formats are skipped.
    #[serde(skip)]
    pub format: Option<Format>,
    /// Seed of the splits of a new dataset; an existing dataset keeps its seed.
    pub seed: Seed,
    /// Grouping whose clips share one drawn split (`None`: by clip), for a new dataset; an existing dataset keeps its
    /// own.
    pub split_by: Option<SplitBy>,
    /// A list of pairs. A styled clip in it gets the split of its original.
    pub pairs: Option<PairList>,
    /// Splits that the user states, which take precedence over published and drawn ones.
    pub splits: Option<SplitList>,
    /// The clips to read; without it, all of them.
    pub ids: Option<IdList>,
    /// Licence tag for clips whose source declares none.
    pub license: Option<String>,
    /// Keep captions that are made by rule from file names.
    pub made_captions: bool,
    /// How files are read: the skeleton the motions are posed on, and joint maps of the user.
    #[serde(skip)]
    pub read: ReadOptions,
    /// HumanML3D's `index.csv`, to cut its clips from the AMASS files among the sources.
    #[serde(skip)]
    pub humanml3d_index: Option<PathBuf>,
    /// Compute the features of the HumanML3D recipe and store them beside the motions.
    pub humanml3d_features: bool,
    /// Handling of motions with jumps.
    pub teleports: Teleports,
    /// Read everything again if the settings differ from those the dataset was made with.
    pub new_version: bool,
    /// Whether to remove clips whose files are missing or no longer give them.
    pub prune: bool,
    /// Commit although labels are lost, because their clips changed or were removed.
    pub drop_labels: bool,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            fps: Some(Fps::STORE),
            resample: Resample::Exact,
            format: None,
            seed: Seed(0),
            split_by: None,
            pairs: None,
            splits: None,
            ids: None,
            license: None,
            made_captions: true,
            read: ReadOptions::default(),
            humanml3d_index: None,
            humanml3d_features: false,
            teleports: Teleports::default(),
            new_version: false,
            prune: false,
            drop_labels: false,
        }
    }
}

/// The options as a plan keeps them. Files that are large are kept by their paths and hashes.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StoredOptions {
    options: IngestOptions,
    format: Option<String>,
    skeleton: Skeleton,
    user_map: Option<UserMap>,
    markers: Option<MarkerSet>,
    unit: Option<Unit>,
    up: Option<Up>,
    lenient: bool,
    /// Folder and hash.
    subjects: Option<(PathBuf, String)>,
    /// File and hash.
    humanml3d_index: Option<(PathBuf, String)>,
}

impl StoredOptions {
    pub(super) fn of(options: &IngestOptions) -> Result<Self, Error> {
        let subjects = options.read.subjects.as_ref().map(|subjects| {
            let folder = absolute(subjects.folder())?;
            Ok::<_, Error>((folder, subjects.hash().to_owned()))
        });
        let index = options
            .humanml3d_index
            .as_ref()
            .map(|index| Ok::<_, Error>((absolute(index)?, hash_file(index)?)));
        let read = options.read.clone();
        Ok(Self {
            options: options.clone(),
            format: options.format.map(|format| format.as_str().to_owned()),
            skeleton: read.skeleton,
            user_map: read.user_map,
            markers: read.markers,
            unit: read.unit,
            up: read.up,
            lenient: read.lenient,
            subjects: subjects.transpose()?,
            humanml3d_index: index.transpose()?,
        })
    }

    /// Restores the options. Files that are kept by their paths must still have the recorded hashes.
    pub(super) fn options(self) -> Result<IngestOptions, Error> {
        let changed = |path: PathBuf| Error::from(work::Error::SourceChanged { path });
        let mut subjects = None;
        if let Some((folder, hash)) = self.subjects {
            let read = Subjects::read(&folder)?;
            if read.hash() != hash {
                return Err(changed(folder));
            }
            subjects = Some(Arc::new(read));
        }
        let index = self.humanml3d_index;
        if let Some((index, hash)) = &index
            && hash_file(index)? != *hash
        {
            return Err(changed(index.clone()));
        }
        Ok(IngestOptions {
            format: self.format.and_then(|name| format_named(&name)),
            read: ReadOptions {
                skeleton: self.skeleton,
                user_map: self.user_map,
                markers: self.markers,
                unit: self.unit,
                up: self.up,
                lenient: self.lenient,
                subjects,
                ..ReadOptions::default()
            },
            humanml3d_index: index.map(|(index, _)| index),
            ..self.options
        })
    }
}

/// Lowest and highest rates to store at, in 1/s.
const FPS_LIMITS: [f64; 2] = [1.0, 1000.0];

impl IngestOptions {
    /// Checks the rate to store at.
    ///
    /// # Errors
    /// The rate is implausibly low or high.
    pub fn check_fps(fps: Fps) -> Result<(), Error> {
        let [lowest, highest] = FPS_LIMITS;
        match (lowest..=highest).contains(&fps.get()) {
            true => Ok(()),
            false => Err(Error::refused(format!(
                "cannot store motions at {} frames per second; choose {lowest} to {highest}, or native",
                fps.get()
            ))),
        }
    }
}

/// Fact of a manifest: the seed its splits were drawn with.
pub(super) const SEED_FACT: &str = "seed";

/// Fact of a manifest: hash of the list of pairs.
pub(super) const PAIRS_FACT: &str = "pairs";

/// Fact of a manifest: the settings its clips were read with, as JSON.
pub(super) const SETTINGS_FACT: &str = "ingest_settings";

const KEPT_BY_HASH: [&str; 5] = [
    "splits",
    "ids",
    "joint-map",
    "subject-models",
    "humanml3d-index",
];
pub(super) const SHARED_SETTINGS: [&str; 4] = ["fps", "resample", "skeleton", "features"];

/// The settings that decide how a clip is read, by name. All clips of a dataset are read with the same settings.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Settings(BTreeMap<String, String>);

impl Settings {
    pub(super) fn of(options: &IngestOptions) -> Self {
        let read = &options.read;
        let format = options.format.map(|format| format.as_str().to_owned());
        let skeleton = format!("{} {}", read.skeleton.name(), read.skeleton.hash());
        let subjects = read.subjects.as_ref();
        let subjects = subjects.map(|subjects| subjects.hash().to_owned());
        let features = options.humanml3d_features.then_some(humanml3d::RECIPE);
        let lower = |value: &dyn std::fmt::Debug| Some(format!("{value:?}").to_lowercase());
        let values = [
            ("rules", Some(INGEST_VERSION.to_string())),
            ("fps", Some(rate_name(options))),
            ("resample", lower(&options.resample)),
            ("format", format),
            ("seed", Some(options.seed.0.to_string())),
            ("license", options.license.clone()),
            ("skeleton", Some(skeleton)),
            ("joint-map", read.user_map.as_ref().map(UserMap::hash)),
            ("markers", read.markers.as_ref().map(MarkerSet::hash)),
            ("unit", read.unit.map(|unit| unit.to_string())),
            ("subject-models", subjects),
            ("features", features.map(str::to_owned)),
            ("made-captions", Some(options.made_captions.to_string())),
            ("splits", options.splits.as_ref().map(SplitList::hash)),
            ("ids", options.ids.as_ref().map(IdList::hash)),
            ("lenient", Some(read.lenient.to_string())),
            ("teleports", lower(&options.teleports)),
        ];
        let values = values.map(|(name, value)| {
            let value = value.unwrap_or_else(|| "none".to_owned());
            (name.to_owned(), value)
        });
        let mut settings = BTreeMap::from(values);
        // Datasets of earlier versions have no such setting.
        settings.extend(read.up.map(|up| ("up".to_owned(), up.to_string())));
        // An index that cannot be read is refused when the sources are planned.
        let index = options.humanml3d_index.as_ref();
        let index = index.map(|index| hash_file(index).unwrap_or_default());
        settings.extend(index.map(|hash| ("humanml3d-index".to_owned(), hash)));
        Self(settings)
    }

    pub(super) fn text(&self) -> String {
        json(self)
    }

    /// Whether two recorded settings read clips the same way: all are equal but the seed of the splits.
    pub(super) fn read_alike(a: &str, b: &str) -> bool {
        let [a, b] = [a, b].map(|text| {
            let mut settings: Self = serde_json::from_str(text).unwrap_or_default();
            settings.0.remove("seed");
            settings.0
        });
        !a.is_empty() && a == b
    }

    /// Describes the settings that differ from recorded ones; `None` if all are equal. `only` limits the names that are
    /// compared. `in_words` describes a setting that is recorded as a hash.
    pub(super) fn differing(
        &self,
        recorded: Option<&String>,
        only: Option<&[&str]>,
        in_words: &dyn Fn(&str) -> Option<String>,
    ) -> Option<String> {
        let Some(recorded) = recorded.and_then(|text| serde_json::from_str::<Self>(text).ok())
        else {
            return Some(
                "the settings were not recorded by an earlier version of the program".to_owned(),
            );
        };
        let names: BTreeSet<&String> = self.0.keys().chain(recorded.0.keys()).collect();
        let value = |settings: &Self, name: &str| {
            settings.0.get(name).map_or("none".to_owned(), Clone::clone)
        };
        let differing: Vec<String> = names
            .into_iter()
            .filter(|name| only.is_none_or(|only| only.contains(&name.as_str())))
            .map(|name| (name, value(&recorded, name), value(self, name)))
            .filter(|(_, recorded, now)| recorded != now)
            .map(|(name, recorded, now)| match in_words(name) {
                Some(words) => format!("{name} {words}"),
                None if KEPT_BY_HASH.contains(&name.as_str()) && now == "none" => {
                    format!("{name} was a file and is not given now")
                }
                None => format!("{name} was {recorded} and is now {now}"),
            })
            .collect();
        (!differing.is_empty()).then(|| differing.join("; "))
    }
}

pub(super) fn rate_name(options: &IngestOptions) -> String {
    options
        .fps
        .map_or("native".to_owned(), |fps| fps.get().to_string())
}
