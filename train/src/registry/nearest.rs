//! The nearest neighbour in the training set: a system without a network. It returns the training target whose
//! instruction is closest to the given one. A model that is not better has only memorised its training data.

use std::collections::{BTreeMap, BTreeSet};

use burn::tensor::Device;
use compose::recording::{self, Kind, Settings};
use compose::{COMPOSED, ComposeConfig};
use datasets_spec::record::TripletRow;
use datasets_spec::{Dataset, Fps, Motion, Pose, Resample, Seed, Skeleton};
use glam::DQuat;
use kinematics::canonical::{Anchor, canonicalise, world_from_segment};
use kinematics::resample::grid;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use work::Context;

use crate::checkpoint::{Run, RunRecord, read_record};
use crate::error::motion_error;
use crate::kind::{Editing, Input, ModelKind, TrainRequest, Trained};
use crate::sample::EditTimes;
use crate::system::{
    EditConfig, EditRequest, EditSystem, Misfit, Remarks, SystemIdentity, SystemSource,
};
use crate::vocabulary::words_of;
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: KIND,
    about: "The training target whose instruction is closest: no network, a row to compare with",
    uses: &[Input::Compose],
    preset: |_| serde_json::Value::Null,
    train,
    open: Some(Editing { uses: &[], open }),
};

const KIND: &str = "nearest";
const TRIPLETS: &str = "triplets";
const NAME: &str = "Nearest neighbour";

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NearestConfig {
    /// Number of training triplets to choose from.
    triplets: u64,
    seed: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NearestRecord {
    train: NearestConfig,
    compose: ComposeConfig,
}

fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let preset = NearestConfig {
        triplets: 1_024,
        seed: 0,
    };
    let mut config = request.settings(&preset)?;
    config.seed = request.seed.unwrap_or(config.seed);
    let dataset = request.dataset;
    let record = RunRecord::new(
        KIND,
        &dataset.content_hash(&COMPOSED),
        &dataset.skeleton()?,
        NearestRecord {
            train: config,
            compose: request.compose.clone(),
        },
    );
    Run::open(request.start, &record)?;
    let run = request.start.run;
    let context = Context {
        progress: session.progress,
        holder: "stance train nearest",
    };
    let settings = Settings {
        kind: Kind::Triplets,
        count: config.triplets,
        config: request.compose.clone(),
        seed: Seed(config.seed),
        condition: dataset.condition().map(str::to_owned),
    };
    let triplets = run.join(TRIPLETS);
    let (made, left_out) = recording::record(dataset.root(), &triplets, &settings, &context)?;
    let rows: Vec<TripletRow> = made.read(None)?;
    let instructions: BTreeSet<&str> = rows.iter().map(|row| row.instruction.as_str()).collect();
    let (triplets, instructions) = (rows.len(), instructions.len());
    let short = match left_out {
        0 => String::new(),
        count => format!(", {count} masks or pairs too short and not used"),
    };
    Ok(Trained {
        is_complete: true,
        summary: format!(
            "{triplets} training targets with {instructions} instructions{short}; in {}",
            run.display()
        ),
        document: serde_json::json!({
            "triplets": triplets,
            "instructions": instructions,
            "left_out": left_out,
        }),
    })
}

struct Nearest {
    identity: SystemIdentity,
    fps: Fps,
    skeleton: Skeleton,
    instructions: Instructions,
    targets: BTreeMap<String, Vec<Motion>>,
}

fn open(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    _device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    let record = read_record::<NearestRecord>(&source.run, KIND)?;
    let folder = Dataset::open(&source.run.join(TRIPLETS))?;
    let mut targets: BTreeMap<String, Vec<Motion>> = BTreeMap::new();
    let mut fps = Fps::STORE;
    for row in folder.read::<TripletRow>(None)? {
        let edited = row.edited().map_err(motion_error(&row.id))?;
        fps = edited.fps();
        targets.entry(row.instruction).or_default().push(edited);
    }
    let settings = serde_json::json!({ "triplets": record.config.train.triplets });
    Ok(Box::new(Nearest {
        identity: SystemIdentity {
            name: config.name.clone().unwrap_or_else(|| NAME.to_owned()),
            checkpoint_hash: folder.manifest().root_hash.clone(),
            settings: settings.to_string(),
        },
        fps,
        skeleton: skeleton.clone(),
        instructions: Instructions::of(targets.keys().map(String::as_str)),
        targets,
    }))
}

impl EditSystem for Nearest {
    fn identity(&self) -> &SystemIdentity {
        &self.identity
    }

    fn fps(&self) -> Fps {
        self.fps
    }

    fn guidance(&self) -> f64 {
        1.0
    }

    fn remarks(&self, _motions: &[(usize, Fps)], texts: &[&str]) -> Remarks {
        let words = texts.iter().flat_map(|text| words_of(text));
        Remarks {
            unknown_words: words
                .filter(|word| !self.instructions.weights.contains_key(word))
                .collect(),
            ..Remarks::default()
        }
    }

    fn prepare(&mut self, _texts: &[String], _session: &Session<'_>) -> Result<(), Error> {
        Ok(())
    }

    fn edit(
        &self,
        requests: &[EditRequest<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<(Vec<(Motion, Misfit)>, EditTimes), Error> {
        let motions = requests.iter().map(|request| {
            session.go_on("editing")?;
            Ok((self.answer(request, seed)?, Misfit::default()))
        });
        let motions = motions.collect::<Result<_, Error>>()?;
        Ok((motions, EditTimes::default()))
    }
}

impl Nearest {
    /// The target of the closest instruction (one of them, if several have it), moved to the start of the original and
    /// cut to its length. If the target is shorter, its last pose is repeated.
    fn answer(&self, request: &EditRequest<'_>, seed: Seed) -> Result<Motion, Error> {
        let texts: Vec<&str> = request
            .instructions
            .iter()
            .map(|own| own.text.as_str())
            .collect();
        let closest = self.instructions.closest(&texts.join(" "));
        let targets = closest.and_then(|text| self.targets.get(text));
        let targets = targets.map_or(&[][..], Vec::as_slice);
        if targets.is_empty() {
            return Err(Error::item(
                request.id,
                "cannot be answered: the run holds no training targets",
            ));
        }
        let mut rng = seed.rng(&[KIND, request.id]);
        let target = &targets[rng.random_range(0..targets.len())];
        let target = Resample::Exact
            .apply(target, request.fps)
            .map_err(motion_error(request.id))?;
        let original = request.motion;
        let frames = grid(original.len(), original.fps(), request.fps).len();
        let mut poses = target.poses();
        poses.truncate(frames);
        self.move_to(&mut poses, &original.pose(0));
        let last = poses.last().copied().unwrap_or(Pose::REST);
        poses.resize(frames, last);
        Motion::from_poses(request.fps, &poses).map_err(motion_error(request.id))
    }

    /// Moves a motion to the ground position and heading of another motion's first pose. Heights are kept.
    fn move_to(&self, poses: &mut [Pose], start: &Pose) {
        canonicalise(poses, Anchor::Pelvis, &self.skeleton);
        let placement = world_from_segment(start, Anchor::Pelvis, &self.skeleton);
        let turn = DQuat::from_rotation_y(placement.yaw_rad);
        let pivot = self.skeleton.rest(0);
        for pose in poses {
            pose.transl = turn * (pose.transl + pivot) - pivot;
            pose.transl.x += placement.x;
            pose.transl.z += placement.z;
            pose.rotations[0] = turn * pose.rotations[0];
        }
    }
}

/// The training instructions as bags of words with TF-IDF weights, in which rare words count more.
struct Instructions {
    texts: Vec<(String, BTreeSet<String>)>,
    /// Inverse document frequency of each word: `ln(1 + N / n)` if n of the N instructions contain it.
    weights: BTreeMap<String, f64>,
}

impl Instructions {
    fn of<'a>(texts: impl Iterator<Item = &'a str>) -> Self {
        let texts: Vec<(String, BTreeSet<String>)> = texts
            .map(|text| (text.to_owned(), words_of(text).collect()))
            .collect();
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for (_, words) in &texts {
            for word in words {
                *counts.entry(word.clone()).or_default() += 1;
            }
        }
        let weight = |count: usize| (1.0 + texts.len() as f64 / count as f64).ln();
        let weights = counts
            .into_iter()
            .map(|(word, count)| (word, weight(count)));
        Self {
            weights: weights.collect(),
            texts,
        }
    }

    /// The instruction with the highest cosine similarity to a text; ties go to the first in alphabetical order. Words
    /// that occur in no instruction are ignored.
    fn closest(&self, text: &str) -> Option<&str> {
        let words: BTreeSet<String> = words_of(text).collect();
        let square = |word: &String| self.weights.get(word).map_or(0.0, |weight| weight * weight);
        let cosine = |own: &BTreeSet<String>| {
            let common: f64 = own.intersection(&words).map(square).sum();
            let length: f64 = own.iter().map(square).sum();
            common / length.sqrt().max(f64::MIN_POSITIVE)
        };
        let mut closest: Option<(f64, &str)> = None;
        for (text, own) in &self.texts {
            let found = cosine(own);
            if closest.is_none_or(|(best, _)| found > best) {
                closest = Some((found, text));
            }
        }
        closest.map(|(_, text)| text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closest_instruction_shares_the_rarest_words() {
        let texts = [
            "a person waves with the left arm",
            "a person waves with the right arm",
            "walk like an old person",
        ];
        let instructions = Instructions::of(texts.into_iter());
        let closest = |text: &str| instructions.closest(text).expect("a text");
        assert_eq!(closest(texts[1]), texts[1]);
        assert_eq!(closest("wave the LEFT arm!"), texts[0]);
        assert_eq!(closest("as an old one"), texts[2]);
        // Without common words, the first instruction is returned.
        assert_eq!(closest("jump"), texts[0]);
        let none = Instructions::of(std::iter::empty());
        assert!(none.closest("jump").is_none());
    }
}
