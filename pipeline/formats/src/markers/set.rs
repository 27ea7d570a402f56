//! Marker sets: their labels, and where each marker sits on the body.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use datasets_spec::Joint;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::part::Part;

/// A label in upper case, without the subject before a colon.
pub fn bare_label(label: &str) -> String {
    let bare = label.rsplit(':').next().unwrap_or(label);
    bare.trim().to_uppercase()
}

/// Placement of a marker: its joint, and its offset from the joint at rest in metres, x to the body's left,
/// y up and z to the front. In the rest pose the arms are stretched to the sides, palms down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// The joint that carries the marker.
    pub joint: Joint,
    /// Offset of the marker from the joint at rest.
    pub offset: DVec3,
}

impl Placement {
    /// The same place on the other side of the body.
    fn mirrored(self) -> Self {
        Self {
            joint: self.joint.mirrored(),
            offset: self.offset * DVec3::new(-1.0, 1.0, 1.0),
        }
    }
}

/// A marker set, as JSON:
///
/// ```json
/// {"name": "our lab", "like": "cmu-41",
///  "markers": {"M01": "LFHD", "*KneeOut": {"joint": "left_knee", "offset": [0.06, 0, 0]}},
///  "optional": {"M99": "RBAC"}, "at_rest": ["head"]}
/// ```
///
/// `markers` maps each label to a placement: either a joint and the offset from it, or a label of the set `like`
/// (without `like`, of any built-in set) whose placement is used. `*` in a label stands for `L` and `R`; the stated
/// placement is the left one. A capture matches the set if it has 70% of `markers`; those in `optional` are used if
/// present. Without `markers`, the set has those of `like`. `at_rest` names body parts that may have no markers; they
/// then keep the rest pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkerSet {
    name: String,
    markers: BTreeMap<String, Placement>,
    optional: BTreeMap<String, Placement>,
    at_rest: BTreeSet<Part>,
}

/// Error of parsing a marker set.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MarkerSetError {
    /// The text is not JSON, or has unknown fields.
    #[error(
        "a marker set is JSON with name and markers and, if needed, like, optional, at_rest and source; a marker \
         is a label of a known set, or a joint and an offset of three numbers"
    )]
    Syntax(#[from] serde_json::Error),
    /// The set names an unknown set, label or joint, a label occurs twice, an offset is too long, or there are no
    /// markers. The text says which.
    #[error("marker set {0}")]
    Content(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    /// Where the set is described; not used by the program.
    #[serde(default, rename = "source")]
    _source: Option<String>,
    like: Option<String>,
    #[serde(default)]
    markers: BTreeMap<String, Place>,
    #[serde(default)]
    optional: BTreeMap<String, Place>,
    #[serde(default)]
    at_rest: BTreeSet<Part>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Place {
    Of(String),
    At { joint: String, offset: [f64; 3] },
}

/// Largest distance in metres of a marker from the joint that carries it.
const MAX_OFFSET_M: f64 = 0.6;

/// The built-in sets as JSON. The set that another names in `like` comes first.
const FILES: [&str; 10] = [
    include_str!("sets/cmu-41.json"),
    include_str!("sets/plug-in-gait.json"),
    include_str!("sets/vicon-front-waist-53.json"),
    include_str!("sets/plug-in-gait-lower-body.json"),
    include_str!("sets/opensim-gait.json"),
    include_str!("sets/helen-hayes.json"),
    include_str!("sets/helen-hayes-c3d.json"),
    include_str!("sets/helen-hayes-lower-body.json"),
    include_str!("sets/qualisys-animation.json"),
    include_str!("sets/qualisys-sports.json"),
];

static SETS: LazyLock<Vec<MarkerSet>> = LazyLock::new(|| {
    let mut sets: Vec<MarkerSet> = Vec::with_capacity(FILES.len());
    for file in FILES {
        let set = MarkerSet::read(file, &sets).expect("a test parses every built-in set");
        sets.push(set);
    }
    sets
});

/// The built-in marker sets. Each file in `sets/` says where its set is described.
pub fn marker_sets() -> &'static [MarkerSet] {
    &SETS
}

impl MarkerSet {
    /// Parses the JSON text of a set.
    ///
    /// # Errors
    /// The text is not JSON of this form, or a marker has no placement.
    pub fn parse(text: &str) -> Result<Self, MarkerSetError> {
        Self::read(text, marker_sets())
    }

    fn read(text: &str, known: &[Self]) -> Result<Self, MarkerSetError> {
        let file: File = serde_json::from_str(text)?;
        let like = match &file.like {
            None => None,
            Some(name) => Some(known.iter().find(|set| set.name == *name).ok_or_else(|| {
                let names: Vec<&str> = known.iter().map(|set| set.name.as_str()).collect();
                let names = names.join(", ");
                MarkerSetError::Content(format!("is like {name}, which is none of {names}"))
            })?),
        };
        let mut markers = placements(&file.markers, like, known)?;
        let mut optional = placements(&file.optional, like, known)?;
        if let Some(label) = optional.keys().find(|label| markers.contains_key(*label)) {
            return Err(twice(label));
        }
        if let Some(like) = like.filter(|_| markers.is_empty()) {
            markers.clone_from(&like.markers);
            let others = like.optional.iter();
            optional.extend(others.map(|(label, place)| (label.clone(), *place)));
            optional.retain(|label, _| !markers.contains_key(label));
        }
        if markers.is_empty() {
            let reason = "has no markers; name them, or name a set that it is like";
            return Err(MarkerSetError::Content(reason.to_owned()));
        }
        Ok(Self {
            name: file.name,
            markers,
            optional,
            at_rest: file.at_rest,
        })
    }

    /// Name of the set.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Labels of the set without the optional ones, in upper case.
    pub fn labels(&self) -> impl Iterator<Item = &str> {
        self.markers.keys().map(String::as_str)
    }

    /// Placement of the marker with a label in any case; `None` if the set does not have it.
    pub fn placement(&self, label: &str) -> Option<Placement> {
        let label = label.to_uppercase();
        let place = self.markers.get(&label);
        place.or_else(|| self.optional.get(&label)).copied()
    }

    /// Parts of the body that may be without markers.
    pub(super) fn at_rest(&self) -> &BTreeSet<Part> {
        &self.at_rest
    }

    /// BLAKE3 hash of the set, in hexadecimal.
    pub fn hash(&self) -> String {
        let text = serde_json::to_string(self).expect("names and numbers serialise");
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }
}

fn twice(label: &str) -> MarkerSetError {
    MarkerSetError::Content(format!("names {label} twice"))
}

/// The placements of labels, for both sides if a label has a `*`.
fn placements(
    stated: &BTreeMap<String, Place>,
    like: Option<&MarkerSet>,
    known: &[MarkerSet],
) -> Result<BTreeMap<String, Placement>, MarkerSetError> {
    let mut placements = BTreeMap::new();
    for (label, place) in stated {
        let sides: &[&str] = match label.contains('*') {
            true => &["L", "R"],
            false => &[""],
        };
        for side in sides {
            let name = bare_label(&label.replace('*', side));
            let found = place.find(&name, side, like, known)?;
            if placements.insert(name.clone(), found).is_some() {
                return Err(twice(&name));
            }
        }
    }
    Ok(placements)
}

impl Place {
    /// The placement of a label. `side` is `L` or `R`, or empty for labels without a `*`.
    fn find(
        &self,
        label: &str,
        side: &str,
        like: Option<&MarkerSet>,
        known: &[MarkerSet],
    ) -> Result<Placement, MarkerSetError> {
        let refused = MarkerSetError::Content;
        match self {
            Self::Of(place) => {
                let place = place.replace('*', side);
                let sets = like.map_or(known, std::slice::from_ref);
                let found = sets.iter().find_map(|set| set.placement(&place));
                found.ok_or_else(|| {
                    let set = like.map_or("no built-in set", MarkerSet::name);
                    refused(format!(
                        "puts {label} where {place} is, which {set} does not have"
                    ))
                })
            }
            Self::At { joint, offset } => {
                let parsed = joint.parse().map_err(|_| {
                    let known = "which is no SMPL-X body joint such as left_knee";
                    refused(format!("puts {label} on {joint}, {known}"))
                })?;
                let offset = DVec3::from_array(*offset);
                let metres = offset.length();
                if !metres.is_finite() || metres > MAX_OFFSET_M {
                    return Err(refused(format!(
                        "puts {label} {metres} m from {joint}; offsets are in metres, below {MAX_OFFSET_M}"
                    )));
                }
                let left = Placement {
                    joint: parsed,
                    offset,
                };
                Ok(if side == "R" { left.mirrored() } else { left })
            }
        }
    }
}

/// A set, and how many of its labels a capture has.
pub(super) struct Match<'a> {
    pub(super) set: &'a MarkerSet,
    /// Number of the set's labels in the capture, without optional ones.
    pub(super) found: usize,
    pub(super) missing: Vec<&'a str>,
}

impl<'a> Match<'a> {
    fn of(set: &'a MarkerSet, bare: &BTreeSet<String>) -> Self {
        let (found, missing): (Vec<&str>, Vec<&str>) =
            set.labels().partition(|label| bare.contains(*label));
        Self {
            set,
            found: found.len(),
            missing,
        }
    }

    fn share(&self) -> f64 {
        self.found as f64 / self.set.markers.len() as f64
    }

    /// Whether the capture has enough of the labels to match this set.
    pub(super) fn is_whole(&self) -> bool {
        /// Minimum share of the labels.
        const MIN_SHARE: f64 = 0.7;
        self.share() >= MIN_SHARE
    }
}

/// The best match for labels in upper case without a subject: the user's set if the labels match it
/// ([`Match::is_whole`]), else the matching set with the most labels present, else the set with the largest share
/// present. The first of equals wins. `None` if no set has any of the labels.
pub(super) fn nearest<'a>(
    bare: &BTreeSet<String>,
    own: Option<&'a MarkerSet>,
) -> Option<Match<'a>> {
    let own = own.map(|set| Match::of(set, bare));
    if own.as_ref().is_some_and(Match::is_whole) {
        return own;
    }
    let all = own.into_iter();
    let all = all.chain(marker_sets().iter().map(|set| Match::of(set, bare)));
    let better = |best: &Match<'_>, other: &Match<'_>| match (best.is_whole(), other.is_whole()) {
        (true, true) => other.found > best.found,
        (false, false) => other.share() > best.share(),
        (best, _) => !best,
    };
    all.reduce(|best, other| if better(&best, &other) { other } else { best })
        .filter(|best| best.found > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> &'static MarkerSet {
        let mut sets = marker_sets().iter();
        sets.find(|set| set.name == name).expect("built in")
    }

    #[test]
    fn built_in_sets_are_whole_and_have_two_sides() {
        for (name, size) in [
            ("cmu-41", 41),
            ("plug-in-gait", 35),
            ("vicon-front-waist-53", 53),
            ("plug-in-gait-lower-body", 16),
            ("opensim-gait", 27),
            ("helen-hayes", 21),
            ("helen-hayes-c3d", 21),
            ("helen-hayes-lower-body", 15),
            ("qualisys-animation", 44),
            ("qualisys-sports", 41),
        ] {
            assert_eq!(named(name).labels().count(), size, "{name}");
        }
        assert_eq!(marker_sets().len(), FILES.len());
        let [left, right] =
            ["LKNE", "rkne"].map(|label| named("cmu-41").placement(label).expect("known"));
        assert_eq!(left.joint, Joint::LeftKnee);
        assert_eq!(right.joint, Joint::RightKnee);
        assert_eq!(left.mirrored(), right);
        let short = named("helen-hayes-c3d").placement("RSHA");
        assert_eq!(short, named("helen-hayes").placement("R.Shank"));
        assert!(named("cmu-41").placement("Channel101").is_none());
    }

    #[test]
    fn the_nearest_set_is_the_largest_whole_one_or_the_users() {
        let bare = |set: &MarkerSet, skip: usize| -> BTreeSet<String> {
            set.labels().skip(skip).map(str::to_owned).collect()
        };
        // A capture of the CMU set has most labels of Plug-in Gait.
        let of = |labels: &BTreeSet<String>| {
            let found = nearest(labels, None).expect("found");
            let name = found.set.name.clone();
            (name, found.missing.len(), found.is_whole())
        };
        assert_eq!(of(&bare(named("cmu-41"), 0)), ("cmu-41".into(), 0, true));
        let gait = bare(named("plug-in-gait"), 3);
        assert_eq!(of(&gait), ("plug-in-gait".into(), 3, true));
        let half = bare(named("vicon-front-waist-53"), 30);
        assert!(!of(&half).2);
        assert!(nearest(&BTreeSet::from(["M1".to_owned()]), None).is_none());
        let own = r#"{"name": "own", "markers": {"LKNE": "LKNE", "RKNE": "RKNE", "C7": "C7"}}"#;
        let own = MarkerSet::parse(own).expect("valid");
        let found = nearest(&bare(named("cmu-41"), 0), Some(&own)).expect("found");
        assert_eq!(found.set.name, "own");
    }

    #[test]
    fn a_users_set_maps_labels_and_places_markers() {
        let set = MarkerSet::parse(
            r#"{"name": "lab", "like": "cmu-41",
                "markers": {"m1": "lfhd", "*_Shin": {"joint": "left_knee", "offset": [0.04, -0.2, 0.02]}},
                "optional": {"*Hand": "*FIN"}, "at_rest": ["head", "left_arm"]}"#,
        )
        .expect("valid");
        assert_eq!(set.placement("M1"), named("cmu-41").placement("LFHD"));
        assert_eq!(set.placement("r_shin"), named("cmu-41").placement("RSHN"));
        assert_eq!(set.placement("RHAND"), named("cmu-41").placement("RFIN"));
        assert_eq!(set.labels().count(), 3);
        assert_eq!(set.at_rest.len(), 2);
        let legs = r#"{"name": "legs", "like": "plug-in-gait-lower-body", "at_rest": ["trunk"]}"#;
        let legs = MarkerSet::parse(legs).expect("valid");
        assert_eq!(legs.labels().count(), 16);
        assert_ne!(legs.hash(), set.hash());
    }

    #[test]
    fn what_is_no_set_says_what_is_wrong() {
        let refused = |text: &str, words: &str| {
            let error = MarkerSet::parse(text).expect_err(text);
            assert!(error.to_string().contains(words), "{text}: {error}");
        };
        refused("[]", "marker set is JSON");
        refused(r#"{"name": "a", "joints": {}}"#, "marker set is JSON");
        refused(r#"{"name": "a", "like": "b"}"#, "none of cmu-41");
        for (markers, words) in [
            ("{}", "no markers"),
            (r#"{"M": 3}"#, "marker set is JSON"),
            (r#"{"M": "XYZ"}"#, "where XYZ is"),
            (r#"{"*KNE": "*KNE", "RKNE": "RKNE"}"#, "names RKNE twice"),
        ] {
            refused(&format!(r#"{{"name": "a", "markers": {markers}}}"#), words);
        }
        for (joint, height, words) in [("tail", 0, "on tail"), ("head", 90, "90 m from head")] {
            let place = format!(r#"{{"joint": "{joint}", "offset": [0, {height}, 0]}}"#);
            let set = format!(r#"{{"name": "a", "markers": {{"M": {place}}}}}"#);
            refused(&set, words);
        }
    }
}
