//! Solves the clip of a subject from a parsed capture.

use std::collections::BTreeMap;

use datasets_spec::Fps;
use glam::DVec3;

use super::error::{SolveError, some_of};
use super::label::{Subject, Subjects};
use super::solve::Solvable;
use crate::source::ReadOptions;
use crate::source::unit::{Unit, misfit, suspected};
use clip::{Markers, Rejected, RotationSource, SourceClip, rejected};

/// Code of captures whose markers cannot be solved.
const CODE: &str = "E-MARKERS";
/// Code of captures whose unit is wrong.
pub(crate) const UNIT_CODE: &str = "E-UNIT";

/// Contents of a marker file.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The markers in metres, in the file's own axes.
    pub markers: Markers,
    pub(crate) unit: CaptureUnit,
    /// Decisions of the reader that a user may want to check.
    pub notes: Vec<String>,
    pub(crate) flags: u32,
}

impl Capture {
    /// The clip of the subject with this key of [`super::keys`]. The key is empty if the capture has one subject.
    ///
    /// # Errors
    /// As [`Capture::check`]; `E-MARKERS` also if no body fits the markers.
    pub(crate) fn clip(self, key: &str, options: &ReadOptions) -> Result<SourceClip, Rejected> {
        let (unit, flags) = (self.unit, self.flags);
        let (subject, markers, notes) = self.subject(key, options)?;
        let solved = Solvable::find(markers, &subject, options)
            .and_then(|solvable| solvable.solve(&options.skeleton))
            .map_err(|error| unit.rejected(error))?;
        let known = solved.markers.fit_residuals.iter().copied();
        let known: Vec<f32> = known.filter(|residual| *residual >= 0.0).collect();
        let mut clip = SourceClip::new(solved.motion, RotationSource::Fitted);
        clip.fit_error_m = Some(known.iter().sum::<f32>() / known.len().max(1) as f32);
        // The name of a file's only subject is dropped: it is often that of a template, and the folder's label may name
        // the person.
        clip.subject = Some(subject.name).filter(|name| !key.is_empty() && !name.is_empty());
        clip.flags = flags | solved.flags;
        clip.notes.extend(notes);
        clip.notes.extend(solved.notes);
        clip.markers = Some(solved.markers);
        Ok(clip)
    }

    /// Whether a motion can be solved for a subject, without solving it.
    ///
    /// # Errors
    /// `E-MARKERS` if the labels match no known set, too few body parts have markers, or the person's height is
    /// implausible; `E-UNIT` if that height is plausible in another unit; `E-TOO-SHORT` for fewer than 2 frames.
    pub fn check(self, key: &str, options: &ReadOptions) -> Result<(), Rejected> {
        let unit = self.unit;
        let (subject, markers, _) = self.subject(key, options)?;
        let solvable = Solvable::find(markers, &subject, options);
        solvable.map(drop).map_err(|error| unit.rejected(error))
    }

    /// A subject, its markers, and notes. If there is only one subject, it gets all markers.
    fn subject(
        self,
        key: &str,
        options: &ReadOptions,
    ) -> Result<(Subject, Markers, Vec<String>), Rejected> {
        let Self {
            mut markers,
            mut notes,
            ..
        } = self;
        let mut subjects = Subjects::of(&markers.labels, options.markers.as_ref());
        let keys = subjects.keys();
        let place = match key {
            "" => 0,
            key => keys.iter().position(|other| other == key).ok_or_else(|| {
                rejected!(CODE, "found no subject {key} among {}", keys.join(", "))
            })?,
        };
        let mut subject = subjects.people.swap_remove(place);
        if !subjects.others.is_empty() {
            let others = some_of(subjects.others.iter().map(String::as_str));
            notes.push(format!("points of no person: {others}"));
        }
        if keys.len() > 1 {
            markers = only(&markers, &mut subject);
        }
        if markers.positions.len() / markers.labels.len().max(1) < 2 {
            let reason = "found 1 frame, expected at least 2";
            return Err(Rejected::read("E-TOO-SHORT", reason));
        }
        Ok((subject, markers, notes))
    }
}

/// Keeps only the columns of one subject, and renumbers `subject.columns` from 0.
fn only(markers: &Markers, subject: &mut Subject) -> Markers {
    let count = markers.labels.len().max(1);
    let columns = std::mem::take(&mut subject.columns);
    let frames = markers.positions.len() / count;
    let starts = (0..frames).map(|frame| frame * count);
    let kept = starts.flat_map(|start| columns.iter().map(move |column| start + column));
    let labels = columns.iter().map(|column| markers.labels[*column].clone());
    subject.columns = (0..columns.len()).collect();
    Markers {
        labels: labels.collect(),
        positions: kept.clone().map(|at| markers.positions[at]).collect(),
        residuals: kept.map(|at| markers.residuals[at]).collect(),
        ..markers.clone()
    }
}

/// Largest plausible distance in metres of a marker from the origin. Greater ones suggest a wrong unit or number
/// format.
pub(crate) const MAX_DISTANCE_M: f64 = 100.0;

/// Positions of the markers of a capture in metres.
#[derive(Default)]
pub(crate) struct Positions {
    /// All markers of the first frame, then of the next; zeros where a marker is not seen.
    pub(crate) places: Vec<[f32; 3]>,
    /// Residuals in metres in the same order; negative where a marker is not seen.
    residuals: Vec<f32>,
    pub(crate) seen: usize,
    /// Markers that were recorded but are too far away; they count as not seen.
    pub(crate) far: usize,
}

impl Positions {
    /// Adds a marker's position and residual in metres; `None` for a marker that is not seen.
    pub(crate) fn add(&mut self, seen: Option<(DVec3, f64)>) {
        let plausible = seen.filter(|(place, _)| place.length() < MAX_DISTANCE_M);
        self.seen += usize::from(seen.is_some());
        self.far += usize::from(seen.is_some() && plausible.is_none());
        let (place, residual) = plausible.unwrap_or((DVec3::ZERO, -1.0));
        self.places.push(place.as_vec3().to_array());
        self.residuals.push(residual as f32);
    }

    /// Whether so many markers (more than 10%) are too far away that the unit or number format must be wrong.
    pub(crate) fn are_implausible(&self) -> bool {
        const MAX_IMPLAUSIBLE: f64 = 0.1;
        self.far as f64 > MAX_IMPLAUSIBLE * self.seen as f64
    }

    /// The markers, and a note on the number of markers that are too far away.
    pub(crate) fn markers(self, fps: Fps, labels: Vec<String>) -> (Markers, Option<String>) {
        let Self { far, .. } = self;
        let note = format!("{far} positions farther than {MAX_DISTANCE_M} m count as not seen");
        let markers = Markers {
            fps,
            labels,
            positions: self.places,
            residuals: self.residuals,
            set: None,
            fit_residuals: Vec::new(),
        };
        (markers, (far > 0).then_some(note))
    }
}

/// Makes marker names unique: the second marker of a name gets the suffix `.2`, the third `.3`.
pub(crate) fn unique_labels(stated: impl Iterator<Item = String>) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    stated
        .map(|label| {
            let times = seen.entry(label.clone()).or_insert(0);
            *times += 1;
            match *times {
                1 => label,
                again => format!("{label}.{again}"),
            }
        })
        .collect()
}

/// A capture's unit, and a phrase for messages that says where the unit comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaptureUnit {
    pub(crate) unit: Unit,
    pub(crate) said: &'static str,
}

impl CaptureUnit {
    /// The rejection of a capture in this unit that cannot be solved.
    fn rejected(self, error: SolveError) -> Rejected {
        if let SolveError::Height { metres, .. } = error {
            let height = metres / self.unit.metres();
            if !suspected(height).is_empty() {
                return Rejected::read(UNIT_CODE, misfit(height, self.unit, self.said));
            }
        }
        Rejected::read(CODE, error.to_string())
    }

    /// The user's unit, else the file's, else millimetres (metres for a small capture volume). Also returns a note on
    /// where the unit comes from, unless the file states it. `seen` holds the observed points, in the file's unit.
    pub(crate) fn find(
        by_user: Option<Unit>,
        text: &str,
        seen: impl Iterator<Item = DVec3>,
    ) -> (Self, Option<String>) {
        /// A capture volume smaller than this many units is not in millimetres.
        const SMALLEST_VOLUME: f64 = 20.0;
        if let Some(unit) = by_user {
            let said = "as --unit says";
            let note = format!("unit {unit} {said}; the file says {text:?}");
            return (Self { unit, said }, Some(note));
        }
        if let Some(unit) = Unit::named(text) {
            let said = "as the file says";
            return (Self { unit, said }, None);
        }
        let largest = seen.fold(0.0, |largest: f64, point| {
            largest.max(point.abs().max_element())
        });
        let (name, unit) = if largest < SMALLEST_VOLUME {
            ("metres", Unit::METRE)
        } else {
            ("millimetres", Unit::MILLIMETRE)
        };
        let said = "assumed because the file states none";
        let note = format!("unit {text:?} is none; {name} assumed");
        (Self { unit, said }, Some(note))
    }

    /// The rejection of a capture whose median extent suggests another unit; `None` for other captures. `frames` holds
    /// the seen points of each frame.
    pub(crate) fn doubt(
        self,
        frames: impl Iterator<Item = impl Iterator<Item = DVec3>>,
    ) -> Option<Rejected> {
        let mut extents: Vec<f64> = Vec::new();
        for frame in frames {
            let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            let (least, most) =
                frame.fold(empty, |(least, most), at| (least.min(at), most.max(at)));
            let extent = (most - least).max_element();
            if extent.is_finite() {
                extents.push(extent);
            }
        }
        extents.sort_by(f64::total_cmp);
        let extent = *extents.get(extents.len() / 2)?;
        let is_suspect = !suspected(extent).is_empty();
        is_suspect.then(|| Rejected::read(UNIT_CODE, misfit(extent, self.unit, self.said)))
    }
}
