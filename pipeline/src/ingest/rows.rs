//! Rows of a clip, and of a file that was rejected.

use clip::check::{
    FLAG_CAPTION_OUTSIDE, FLAG_NO_CAPTION, FLAG_POOR_FIT, FLAG_REFERENCE_DROPPED, Teleports,
    check_with, starts_apart,
};
use clip::{
    EditOf, LabelProblem, Markers, Rejected, SourceClip, SourceMask, check_resampled,
    true_rate_note,
};
use datasets_spec::record::{
    CAPTION_BY_RULE, CAPTION_BY_SOURCE, HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow,
};
use datasets_spec::table::Quality;
use datasets_spec::{
    BlendMask, BodyPart, Fps, MASK_DEF_VERSION, Motion, MotionId, Resample, Skeleton,
};
use features::humanml3d::{self, Features};
use features::smpl_body;

use super::deal::Item;
use super::options::IngestOptions;
use super::plan::Planned;
use crate::likeness::Sketch;

/// Mean distance in metres between source and stored joints above which a clip is flagged: retargeted captures of
/// people measure 0.01 to 0.04.
pub(super) const FIT_ERROR_LIMIT_M: f32 = 0.05;

/// The rows of a clip, and the rows that depend on other clips.
pub(super) struct ClipRows {
    pub(super) motion: MotionRow,
    pub(super) features: Option<HumanMl3dRow>,
    pub(super) markers: Option<MarkerRow>,
    pub(super) edits: Vec<EditOf>,
    pub(super) masks: Vec<SourceMask>,
}

pub(super) fn part_names(parts: &[BodyPart]) -> Vec<String> {
    parts.iter().map(|part| part.name().to_owned()).collect()
}

pub(super) fn frames(count: usize) -> i32 {
    i32::try_from(count).unwrap_or(i32::MAX)
}

fn marker_row(
    markers: Markers,
    id: MotionId,
    item: &Item,
    source_hash: String,
    license: Option<String>,
) -> MarkerRow {
    MarkerRow {
        id,
        split: item.planned.split,
        source_name: item.source_name.to_owned(),
        source_path: item.planned.entry.file.clone(),
        source_hash,
        license,
        fps: markers.fps.get() as f32,
        n_frames: frames(markers.positions.len() / markers.labels.len().max(1)),
        labels: markers.labels,
        positions: markers.positions,
        residuals: markers.residuals.into_iter().map(|r| [r]).collect(),
        marker_set: markers.set,
        fit_residuals: markers.fit_residuals.into_iter().map(|r| [r]).collect(),
    }
}

/// The rows of a clip, and its labels that could not be used.
pub(super) fn clip_rows(
    mut clip: SourceClip,
    id: MotionId,
    item: &Item,
    source_hash: String,
    options: &IngestOptions,
) -> Result<(ClipRows, Vec<LabelProblem>), Rejected> {
    if !options.made_captions {
        clip.made_captions.clear();
    }
    let skeleton = &options.read.skeleton;
    if options.teleports != Teleports::Keep {
        drop_reference(&mut clip, skeleton, &item.planned.entry.file);
    }
    let target = options.fps.unwrap_or(clip.motion.fps());
    let (motion, quality) = stored(&mut clip, target, &item.planned.entry.file, options)?;
    let Planned { entry, prefix, .. } = item.planned;
    let mirrored_of = entry.mirrored_of.as_ref();
    let features = options
        .humanml3d_features
        .then(|| stored_features(&mut clip, &motion, target, skeleton));
    let features = features.transpose()?.map(|features| HumanMl3dRow {
        id: id.clone(),
        split: item.planned.split,
        recipe: humanml3d::RECIPE.to_owned(),
        fps: motion.fps().get() as f32,
        n_frames: frames(features.len()),
        features,
    });
    let caption_origins = caption_origins(&clip);
    let license = clip.license.or_else(|| options.license.clone());
    let markers = clip.markers.map(|markers| {
        let (id, hash) = (id.clone(), source_hash.clone());
        marker_row(markers, id, item, hash, license.clone())
    });
    let [centre_x, centre_y, centre_z] = Sketch::of(&motion, skeleton).centre().map(Some);
    let motion = MotionRow {
        id,
        split: item.planned.split,
        source: item.planned.format.as_str().to_owned(),
        source_name: item.source_name.to_owned(),
        source_path: entry.file.clone(),
        source_hash,
        license,
        mirrored_of: mirrored_of.map(|id| format!("{prefix}{id}")),
        skeleton: skeleton.name().to_owned(),
        fps: motion.fps().get() as f32,
        fps_source: clip.source_fps.get() as f32,
        start_frame: frames(clip.source_frames.start),
        end_frame: frames(clip.source_frames.end),
        n_frames: frames(motion.len()),
        transl: motion.transl().to_vec(),
        global_orient: motion.global_orient().to_vec(),
        body_pose: motion.body_pose().to_vec(),
        rotation_source: clip.rotation_source.as_str().to_owned(),
        fit_error_m: clip.fit_error_m,
        caption_origins,
        captions: [clip.captions, clip.made_captions].concat(),
        subject: clip.subject,
        inputs_hash: item.planned.inputs.clone(),
        part_captions: clip.part_captions,
        action: clip.action,
        style: clip.style,
        notes: clip.notes,
        content_hash: motion.content_hash(),
        centre_x,
        centre_y,
        centre_z,
        quality,
    };
    let rows = ClipRows {
        motion,
        features,
        markers,
        edits: clip.edits,
        masks: clip.masks,
    };
    Ok((rows, clip.label_problems))
}

/// Returns the motion of a clip at the rate `target`, checked, and its quality. The captions and masks of `clip` are
/// moved to its times and frames. If a jump is trimmed away, `clip` is cropped to what is kept.
fn stored(
    clip: &mut SourceClip,
    target: Fps,
    file: &str,
    options: &IngestOptions,
) -> Result<(Motion, Quality), Rejected> {
    check_resampled(clip.motion.len(), clip.motion.fps(), target)?;
    let by_rule = options.resample == Resample::HumanMl3d;
    // The published rule does not round the rate first.
    let stated = clip
        .stated_fps
        .filter(|stated| by_rule && *stated >= target);
    if let Some(stated) = stated {
        clip.motion.set_fps(stated);
        clip.source_fps = stated;
    }
    let motion = options
        .resample
        .apply(&clip.motion, target)
        .map_err(|error| Rejected::check("E-RESAMPLE", error.to_string()))?;
    let rates = clip.motion.fps().get() / target.get();
    let step = if by_rule { rates.floor() } else { rates };
    let source_frame = |frame: usize| clip.source_frame(frame as f64 * step);
    let (motion, mut quality, kept) = check_with(
        motion,
        &options.read.skeleton,
        options.teleports,
        source_frame,
    )?;
    let mut duration_secs = clip.motion.duration_secs();
    if let Some(kept) = kept {
        clip.narrow(&kept, step, file);
        duration_secs *= motion.len() as f64 * step / clip.motion.len() as f64;
        clip.notes.push(format!(
            "source frames {} to {} were kept, the longest stretch without a jump",
            clip.source_frames.start, clip.source_frames.end
        ));
    }
    quality.flags |= clip.flags | said_flags(clip, duration_secs as f32);
    clip.move_masks(motion.len(), target, file, |frame| frame / step);
    follow_rate(clip, clip.motion.fps().get() / step, target);
    Ok((motion, quality))
}

/// Notes that the true rate of a motion is not the stored one, and moves its captions to the stored times.
fn follow_rate(clip: &mut SourceClip, true_fps: f64, stored: Fps) {
    let Some(note) = true_rate_note(true_fps, stored) else {
        return;
    };
    clip.notes.push(note);
    let slower = (true_fps / stored.get()) as f32;
    for caption in clip.captions.iter_mut().chain(&mut clip.made_captions) {
        caption.from_s *= slower;
        caption.to_s *= slower;
    }
}

/// The clip's own features, if they describe the stored frames; otherwise features computed from the stored motion.
fn stored_features(
    clip: &mut SourceClip,
    motion: &Motion,
    target: Fps,
    skeleton: &Skeleton,
) -> Result<Vec<Features>, Rejected> {
    let carried = clip
        .features
        .take()
        .filter(|rows| rows.len() == motion.len());
    // HumanML3D uses the joints of SMPL, whose positions differ from SMPL-X's.
    let body = clip.body.clone();
    let body = body.unwrap_or_else(|| smpl_body(skeleton));
    if let Some(features) = carried.filter(|_| target == clip.motion.fps()) {
        return Ok(features);
    }
    let joints = humanml3d::joints_of_motion(motion, &body);
    humanml3d::features_of_joints(&joints)
        .map_err(|error| Rejected::check("E-FEATURES", error.to_string()))
}

/// Origin of each caption of a clip.
fn caption_origins(clip: &SourceClip) -> Vec<String> {
    let origins = [CAPTION_BY_SOURCE, CAPTION_BY_RULE];
    let counts = [clip.captions.len(), clip.made_captions.len()];
    let origins = origins.into_iter().zip(counts);
    origins
        .flat_map(|(origin, count)| std::iter::repeat_n(origin.to_owned(), count))
        .collect()
}

/// Drops the first frame if it is a reference pose (T-pose) from which the motion jumps.
fn drop_reference(clip: &mut SourceClip, skeleton: &Skeleton, file: &str) {
    if !starts_apart(&clip.motion, skeleton) {
        return;
    }
    let kept = 1..clip.motion.len();
    let Ok(motion) = clip.motion.crop(kept.clone()) else {
        return;
    };
    clip.notes.push(format!(
        "source frame {} is a reference pose from which the motion jumps; it was dropped",
        clip.source_frames.start
    ));
    clip.narrow(&kept, 1.0, file);
    clip.motion = motion;
    clip.flags |= FLAG_REFERENCE_DROPPED;
}

pub(super) fn said_flags(clip: &SourceClip, duration_secs: f32) -> u32 {
    // Times are written with one decimal at most, and a clip of n frames ends a frame early.
    const TOLERANCE_SECS: f32 = 0.15;
    let outside = clip.captions.iter().any(|caption| {
        caption.from_s > duration_secs || caption.to_s > duration_secs + TOLERANCE_SECS
    });
    let silent =
        clip.captions.is_empty() && clip.made_captions.is_empty() && clip.part_captions.is_empty();
    let poor = clip
        .fit_error_m
        .is_some_and(|error| error > FIT_ERROR_LIMIT_M);
    [
        (outside, FLAG_CAPTION_OUTSIDE),
        (silent, FLAG_NO_CAPTION),
        (poor, FLAG_POOR_FIT),
    ]
    .into_iter()
    .filter(|(found, _)| *found)
    .fold(0, |flags, (_, flag)| flags | flag)
}

/// The pair of a clip and the motion it edits; `None` if that motion's id is malformed. Whether that motion is in the
/// dataset is known once every shard is done.
pub(super) fn pair_row(edit: EditOf, item: &Item, target: &MotionId) -> Option<PairRow> {
    let source_id = MotionId::parse(&format!("{}{}", item.planned.prefix, edit.source_id)).ok()?;
    if let Some(row) = edit.made {
        return Some(PairRow {
            id: format!("{}{}", item.planned.prefix, row.id),
            split: item.planned.split,
            source_id,
            target_id: target.clone(),
            ..row
        });
    }
    Some(PairRow {
        id: format!("{source_id}+{target}"),
        split: item.planned.split,
        source: item.planned.format.as_str().to_owned(),
        kind: edit.kind.to_owned(),
        source_id,
        target_id: target.clone(),
        style: edit.style,
        parts: part_names(&edit.parts),
        instruction: edit.instruction,
        edit_type: None,
        accepted_by: None,
    })
}

/// A mask that comes with a clip. A mask without an id gets one once every shard is done.
pub(super) fn mask_row(mask: SourceMask, item: &Item, motion: &MotionId) -> MaskRow {
    if let Some(row) = mask.made {
        return MaskRow {
            id: format!("{}{}", item.planned.prefix, row.id),
            motion_id: motion.clone(),
            split: item.planned.split,
            ..row
        };
    }
    let blend = BlendMask::of_parts(&mask.parts);
    MaskRow {
        id: String::new(),
        motion_id: motion.clone(),
        split: item.planned.split,
        parts: part_names(&mask.parts),
        hard_joints: blend.hard().names(),
        soft_joints: blend.soft().names(),
        start: None,
        end: None,
        mask_def_version: MASK_DEF_VERSION,
        text: mask.text,
        text_origin: "imported".to_owned(),
        author: item.planned.format.as_str().to_owned(),
        accepted_by: None,
    }
}

#[cfg(test)]
mod tests {
    use clip::RotationSource;
    use datasets_spec::table::Caption;
    use datasets_spec::{Pose, Split};

    use super::*;

    fn still(fps: f64, frames: usize) -> SourceClip {
        let fps = Fps::new(fps).expect("a rate");
        let motion = Motion::from_poses(fps, &vec![Pose::REST; frames]).expect("valid");
        SourceClip::new(motion, RotationSource::Native)
    }

    #[test]
    fn the_published_rule_counts_by_the_stated_rate_and_keeps_captions_in_place() {
        let options = IngestOptions {
            resample: Resample::HumanMl3d,
            ..IngestOptions::default()
        };
        for (stated, frames) in [(59.99_f64, 76), (119.99, 31)] {
            let mut clip = still(stated.round(), 152);
            clip.stated_fps = Fps::new(stated).ok();
            let read = stored(&mut clip, Fps::STORE, "a.npz", &options);
            assert_eq!(read.expect("stored").0.len(), frames, "{stated} fps");
            assert_eq!(clip.source_fps.get(), stated);
        }
        let said = "its true rate is 30 fps, stored as 20 by the rule of HumanML3D";
        for (fps, times, notes) in [(30.0, (3.0, 6.0), &[said][..]), (60.0, (2.0, 4.0), &[][..])] {
            let mut clip = still(fps, 285);
            clip.captions.push(Caption {
                from_s: 2.0,
                to_s: 4.0,
                ..Caption::default()
            });
            stored(&mut clip, Fps::STORE, "a.bvh", &options).expect("stored");
            let caption = &clip.captions[0];
            assert_eq!((caption.from_s, caption.to_s), times);
            assert_eq!(clip.notes, notes);
        }
    }

    #[test]
    fn masks_need_the_frames_that_a_window_spans_at_the_stored_rate() {
        let read = |fps: f64, end: i32| {
            let mut clip = still(20.0, 60);
            let row = MaskRow {
                start: Some(10),
                end: Some(end),
                ..testkit::mask_row("a", Split::Train, BodyPart::LeftArm)
            };
            clip.masks.push(SourceMask::of_row(row));
            let fps = Fps::new(fps).expect("a rate");
            stored(&mut clip, fps, "a.pkl", &IngestOptions::default()).expect("stored");
            clip
        };
        for (fps, range) in [
            (20.0, (10, 45)),
            (10.0, (5, 23)),
            (12.5, (6, 28)),
            (15.0, (8, 34)),
            (30.0, (15, 68)),
        ] {
            let clip = read(fps, 45);
            let row = clip.masks[0].made.as_ref().expect("a row");
            assert_eq!(
                (row.start, row.end),
                (Some(range.0), Some(range.1)),
                "{fps} fps"
            );
            assert!(clip.label_problems.is_empty());
        }
        // 30 frames of 20 fps are 45 of 30 fps, and a window spans 46.
        let clip = read(30.0, 40);
        assert!(clip.masks.is_empty());
        let problem = clip.label_problems[0].to_string();
        assert!(problem.starts_with("a.pkl: mask "), "{problem}");
        assert!(
            problem.contains("at 30 fps") && problem.contains("46"),
            "{problem}"
        );
    }

    #[test]
    fn a_jump_is_told_by_its_frame_in_the_file() {
        let mut clip = still(120.0, 120);
        for frame in 63..120 {
            clip.motion.set_transl(frame, [5.0, 0.0, 0.0]);
        }
        let read = stored(&mut clip, Fps::STORE, "a.bvh", &IngestOptions::default());
        let reason = read.expect_err("100 m/s").reason;
        assert!(reason.contains("into frame 66,"), "{reason}");
    }
}
