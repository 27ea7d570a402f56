//! Labels of points, and the subjects they name.

use std::collections::{BTreeMap, BTreeSet};

use super::set::{MarkerSet, bare_label, marker_sets};
use crate::source::unique_keys;

/// The labels of points that are model outputs and not markers: those `listed` by the file, angles, forces, and the
/// axes `O`, `A`, `L` and `P` of segments such as `LFE`, if all four are there. Labels of the user's set are markers.
pub(crate) fn model_outputs<'a>(
    labels: &'a [String],
    listed: &BTreeSet<String>,
    own: Option<&MarkerSet>,
) -> BTreeSet<&'a String> {
    let all: BTreeSet<String> = labels.iter().map(|label| label.to_uppercase()).collect();
    let is_axis = |label: &str| {
        let mut segment = label.to_uppercase();
        segment.pop();
        is_named_as_axis(label, own)
            && ["O", "A", "L", "P"]
                .iter()
                .all(|axis| all.contains(&format!("{segment}{axis}")))
    };
    let is_own = |label: &str| own.is_some_and(|set| set.placement(&bare_label(label)).is_some());
    let is_output = |label: &&String| {
        !is_own(label) && (listed.contains(*label) || is_quantity(label) || is_axis(label))
    };
    labels.iter().filter(is_output).collect()
}

/// Whether a label names an angle, a force or the like.
fn is_quantity(label: &str) -> bool {
    const QUANTITIES: [&str; 6] = ["ANGLE", "POWER", "FORCE", "MOMENT", "GRF", "CENTREOFMASS"];
    let bare = bare_label(label);
    QUANTITIES.iter().any(|quantity| bare.contains(quantity))
}

/// Whether a label could be that of an axis of a segment, and is not that of a known marker, such as one of a toe.
fn is_named_as_axis(label: &str, own: Option<&MarkerSet>) -> bool {
    const SEGMENTS: [&str; 10] = [
        "HED", "CLO", "LCL", "RCL", "PEL", "TRX", "FE", "FO", "TI", "TO",
    ];
    const LIMBS: [&str; 7] = ["HN", "HU", "RA", "FE", "FO", "TI", "TO"];
    let bare = bare_label(label);
    let Some(segment) = bare.strip_suffix(['O', 'A', 'L', 'P']) else {
        return false;
    };
    let of_limb = segment
        .strip_prefix(['L', 'R'])
        .is_some_and(|limb| LIMBS.contains(&limb));
    segment.len() == 3 && (SEGMENTS.contains(&segment) || of_limb) && !is_known(&bare, own)
}

/// Whether the user's set or a built-in set has this bare label.
fn is_known(bare: &str, own: Option<&MarkerSet>) -> bool {
    let mut sets = own.into_iter().chain(marker_sets());
    sets.any(|set| set.placement(bare).is_some())
}

/// The markers of one subject: columns of a capture, with the bare label of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Subject {
    /// Name that precedes the labels; empty for labels without a name.
    pub(super) name: String,
    pub(super) columns: Vec<usize>,
    pub(super) bare: Vec<String>,
}

/// Key of the motion whose labels name no subject, if other labels of the capture do.
const UNNAMED: &str = "unnamed";
/// Minimum number of known labels of a person. A named subject with `MIN_MARKERS` labels of any kind counts as a person
/// too. Others are objects.
const MIN_KNOWN: usize = 6;
const MIN_MARKERS: usize = 12;

/// The subjects of a capture, and the points that belong to no subject.
#[derive(Clone, Debug, Default)]
pub(super) struct Subjects {
    pub(super) people: Vec<Subject>,
    /// Labels of points on objects, and of points without a known label.
    pub(super) others: Vec<String>,
}

impl Subjects {
    /// Groups the labels of a capture by subject.
    pub(super) fn of(labels: &[String], own: Option<&MarkerSet>) -> Self {
        let by_underscore = underscored(labels, own);
        let mut subjects: BTreeMap<&str, Subject> = BTreeMap::new();
        for (column, label) in labels.iter().enumerate() {
            let (name, rest) = match label.rsplit_once(':') {
                Some((name, rest)) => (name.trim(), rest),
                None => match label.split_once('_') {
                    Some((name, rest)) if by_underscore.contains(name) => (name, rest),
                    _ => ("", label.as_str()),
                },
            };
            let subject = subjects.entry(name).or_default();
            name.clone_into(&mut subject.name);
            subject.columns.push(column);
            subject.bare.push(bare_label(rest));
        }
        let is_person = |subject: &Subject| {
            let known = subject.bare.iter().filter(|bare| is_known(bare, own));
            let may_be = !subject.name.is_empty() && subject.bare.len() >= MIN_MARKERS;
            may_be || known.count() >= MIN_KNOWN
        };
        let (people, others): (Vec<_>, Vec<_>) = subjects.into_values().partition(is_person);
        match people.len() {
            // If no subject looks like a person, the whole capture counts as one.
            0 => Self {
                people: vec![Subject {
                    name: String::new(),
                    columns: (0..labels.len()).collect(),
                    bare: labels.iter().map(|label| bare_label(label)).collect(),
                }],
                others: Vec::new(),
            },
            _ => {
                let columns = others.iter().flat_map(|subject| &subject.columns);
                let columns: BTreeSet<usize> = columns.copied().collect();
                let others = columns.into_iter().map(|column| labels[column].clone());
                Self {
                    others: others.collect(),
                    people,
                }
            }
        }
    }

    /// Keys of the motions, in the order of [`Subjects::people`]; empty if there is one person.
    pub(super) fn keys(&self) -> Vec<String> {
        if self.people.len() < 2 {
            return Vec::new();
        }
        let names = self.people.iter().map(|subject| &subject.name);
        unique_keys(names, |_| UNNAMED.to_owned())
    }
}

/// Keys of the motions in a capture with these labels: its subjects if it has several, else no keys.
pub(crate) fn keys(labels: &[String], own: Option<&MarkerSet>) -> Vec<String> {
    Subjects::of(labels, own).keys()
}

/// The subject with this key; `None` for the key of markers without a subject, and for an empty key.
pub(crate) fn subject_of(key: &str) -> Option<&str> {
    (!key.is_empty() && key != UNNAMED).then_some(key)
}

/// Prefixes before an underscore that name subjects. Only labels that are unknown with their prefix are counted; at
/// least half of them and [`MIN_KNOWN`] must be known without it.
fn underscored<'a>(labels: &'a [String], own: Option<&MarkerSet>) -> BTreeSet<&'a str> {
    let mut counts: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    let plain = labels.iter().filter(|label| !label.contains(':'));
    for (label, (name, rest)) in plain.filter_map(|label| Some((label, label.split_once('_')?))) {
        if !name.is_empty() && !is_known(&bare_label(label), own) {
            let (all, known) = counts.entry(name).or_default();
            *all += 1;
            *known += usize::from(is_known(&bare_label(rest), own));
        }
    }
    let of_people = counts.into_iter();
    let of_people = of_people.filter(|(_, (all, known))| *known >= MIN_KNOWN && 2 * known >= *all);
    of_people.map(|(name, _)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(labels: &[String]) -> Vec<String> {
        super::keys(labels, None)
    }

    fn worn(prefix: &str, count: usize) -> Vec<String> {
        let labels = marker_sets()[0].labels().take(count);
        labels.map(|label| format!("{prefix}{label}")).collect()
    }

    #[test]
    fn subjects_are_told_by_their_names() {
        let one = worn("Anna:", 41);
        assert!(keys(&one).is_empty());
        let two = [worn("Anna:", 41), worn("Ben:", 41)].concat();
        assert_eq!(keys(&two), ["Anna", "Ben"]);
        let underscored = [worn("Anna_", 41), worn("Ben_", 41), worn("Dan:", 20)].concat();
        assert_eq!(keys(&underscored), ["Anna", "Ben", "Dan"]);
        let mixed = [worn("", 41), worn("Ben:", 41)].concat();
        assert_eq!(keys(&mixed), ["unnamed", "Ben"]);
        // A subject with unknown labels is not dropped.
        let strange: Vec<String> = (0..41).map(|number| format!("Ben:M{number}")).collect();
        assert_eq!(keys(&[one.clone(), strange].concat()), ["Anna", "Ben"]);
    }

    #[test]
    fn objects_are_nobody() {
        let one = worn("Anna:", 41);
        let object: Vec<String> = (0..5).map(|number| format!("Box:B{number}")).collect();
        let loose: Vec<String> = (0..50).map(|number| format!("*{number}")).collect();
        let labels = [one, object, loose].concat();
        let subjects = Subjects::of(&labels, None);
        assert!(subjects.keys().is_empty());
        assert_eq!(subjects.people[0].name, "Anna");
        assert_eq!(subjects.people[0].columns.len(), 41);
        assert_eq!(subjects.others.len(), 55);
        assert!(keys(&["a_b".to_owned(), "c_d".to_owned()]).is_empty());
    }

    #[test]
    fn outputs_of_models_are_told_from_markers() {
        let words = |text: &str| -> Vec<String> { text.split(' ').map(str::to_owned).collect() };
        let outputs = words(
            "LHipAngles RGroundReactionForce PELO PELA PELL PELP Anna:rfeo Anna:rfea Anna:rfel Anna:rfep COM",
        );
        // A segment without all its axes is a marker, such as one on the foot, and so is what the user names.
        let markers =
            words("LTOE RASI CLAV C7 LTHI point3 RHEE RFOO LFOO LTIO LTIA LTIL Anna:PELO");
        let labels = [outputs.clone(), markers].concat();
        let listed = BTreeSet::from(["COM".to_owned()]);
        let expected: BTreeSet<&String> = outputs.iter().collect();
        assert_eq!(model_outputs(&labels, &listed, None), expected);
        let joint = r#"{"joint": "left_knee", "offset": [0, 0, 0]}"#;
        let own = format!(r#"{{"name": "own", "markers": {{"COM": {joint}, "PELA": {joint}}}}}"#);
        let own = MarkerSet::parse(&own).expect("a set");
        let found = model_outputs(&labels, &listed, Some(&own));
        assert_eq!(found.len(), outputs.len() - 2, "{found:?}");
    }
}
