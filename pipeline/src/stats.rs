//! Statistics of a dataset.

use std::collections::BTreeMap;
use std::fmt;

use clip::check::flag_names;
use datasets_spec::Dataset;
use datasets_spec::quantile::quantile;
use datasets_spec::record::CAPTION_BY_RULE;
use serde::{Deserialize, Serialize};
use tables::Condition;

use crate::Error;
use crate::counts::{Counts, Group, Share};
use crate::ingest::REMARKS_FACT;

/// Upper bounds of the duration classes in seconds; the last class has none.
const DURATIONS: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 60.0];

/// Percentiles of a number, and the largest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Spread {
    p5: f64,
    p50: f64,
    p95: f64,
    max: f64,
}

impl Spread {
    /// The distribution of some numbers; `None` without numbers.
    fn of(mut numbers: Vec<f64>) -> Option<Self> {
        let mut at = |share: f64| quantile(&mut numbers, share);
        Some(Self {
            p5: at(0.05)?,
            p50: at(0.5)?,
            p95: at(0.95)?,
            max: at(1.0)?,
        })
    }
}

/// Statistics of a dataset, as text and as JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Statistics {
    total: Share,
    splits: BTreeMap<String, Share>,
    /// By kind of source.
    sources: BTreeMap<String, Share>,
    /// By origin of the rotations.
    rotations: BTreeMap<String, Share>,
    /// By stored frame rate.
    rates: BTreeMap<String, Share>,
    /// By licence tag.
    licenses: BTreeMap<String, Share>,
    actions: BTreeMap<String, Share>,
    styles: BTreeMap<String, Share>,
    /// Clips that mirror another.
    mirrored: u64,
    captions: u64,
    /// Captions that were made from file names.
    made_captions: u64,
    /// Words of all captions.
    words: u64,
    /// Clips without captions.
    silent: u64,
    /// Clips by duration, in classes.
    durations: Vec<(String, u64)>,
    /// Clips by finding of the quality checks.
    flags: BTreeMap<String, u64>,
    /// Highest joint speed of a clip in m/s.
    max_speed: Option<Spread>,
    /// Speed of planted feet in m/s.
    foot_skate: Option<Spread>,
    /// Distance between source and stored joints in metres, by kind of source.
    fit_error_m: BTreeMap<String, Spread>,
    /// By body parts.
    masks: BTreeMap<String, u64>,
    masked_clips: u64,
    /// Mean number of masks of clips that have any; 2.1 in the paper (Sec. 4.1).
    masks_per_clip: Option<f64>,
    /// By kind of edit.
    pairs: BTreeMap<String, u64>,
    pair_styles: BTreeMap<String, u64>,
    pair_splits: BTreeMap<String, u64>,
    /// Remarks of the ingestion on the splits.
    remarks: Option<String>,
}

/// Counts the clips of a dataset (with a condition, those that fulfil it) with their masks and pairs. Reads no frames.
///
/// # Errors
/// A table cannot be read, or no clip fulfils the condition.
pub fn statistics(dataset: &Dataset, condition: Option<&Condition>) -> Result<Statistics, Error> {
    let mut counts = Counts::new(dataset, condition)?;
    let facts: Vec<Facts> = counts.rows(
        "source, seconds, max_speed, foot_skate, fit_error_m, texts, caption_origins, part_texts, \
         mirrored_of IS NOT NULL AS mirrored, quality.flags AS flags",
        "motions",
    )?;
    if facts.is_empty() && condition.is_some() {
        let path = dataset.root().to_owned();
        return Err(tables::Error::NoneChosen { path }.into());
    }
    let mut durations = [0u64; DURATIONS.len() + 1];
    let mut errors: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut flags = BTreeMap::new();
    for row in &facts {
        durations[DURATIONS.partition_point(|end| *end <= row.seconds)] += 1;
        if let Some(error) = row.fit_error_m {
            errors.entry(row.source.clone()).or_default().push(error);
        }
        for name in flag_names(row.flags) {
            *flags.entry(name.to_owned()).or_default() += 1;
        }
    }
    let sum = |of: fn(&Facts) -> usize| facts.iter().map(of).sum::<usize>() as u64;
    let splits = counts.groups("split")?;
    let masks = counts.labelled("array_to_string(parts, '+')", "masks")?;
    let masked_clips = counts.labelled("motion_id", "masks")?.len() as u64;
    let num_masks: u64 = masks.values().sum();
    Ok(Statistics {
        total: Group::sums(&splits, |_| Some(()))
            .remove(&())
            .unwrap_or_default(),
        rates: Group::sums(&splits, |group| Some(format!("{} fps", group.fps))),
        splits: Group::sums(&splits, |group| group.label.clone()),
        sources: counts.shares("source")?,
        rotations: counts.shares("rotation_source")?,
        licenses: counts.shares("COALESCE(license, 'not stated')")?,
        actions: counts.shares("action")?,
        styles: counts.shares("style")?,
        mirrored: sum(|row| row.mirrored.into()),
        captions: sum(|row| row.texts.len()),
        made_captions: sum(|row| {
            let origins = row.caption_origins.iter().flatten();
            origins.filter(|origin| *origin == CAPTION_BY_RULE).count()
        }),
        words: sum(|row| {
            let texts = row.texts.iter();
            texts.map(|text| text.split_whitespace().count()).sum()
        }),
        silent: sum(|row| (row.texts.is_empty() && row.part_texts.is_empty()).into()),
        durations: durations
            .into_iter()
            .enumerate()
            .map(|(class, clips)| (class_name(class), clips))
            .collect(),
        flags,
        max_speed: Spread::of(facts.iter().map(|row| row.max_speed).collect()),
        foot_skate: Spread::of(facts.iter().map(|row| row.foot_skate).collect()),
        fit_error_m: errors
            .into_iter()
            .filter_map(|(source, errors)| Some((source, Spread::of(errors)?)))
            .collect(),
        masked_clips,
        masks_per_clip: (masked_clips > 0).then(|| num_masks as f64 / masked_clips as f64),
        masks,
        pairs: counts.labelled("kind", "pairs")?,
        pair_styles: counts.labelled("style", "pairs")?,
        pair_splits: counts.labelled("split", "pairs")?,
        remarks: dataset.manifest().facts.get(REMARKS_FACT).cloned(),
    })
}

#[derive(Deserialize)]
struct Facts {
    source: String,
    seconds: f64,
    max_speed: f64,
    foot_skate: f64,
    fit_error_m: Option<f64>,
    texts: Vec<String>,
    caption_origins: Option<Vec<String>>,
    part_texts: Vec<String>,
    mirrored: bool,
    flags: u32,
}

fn class_name(class: usize) -> String {
    match (
        class.checked_sub(1).map(|before| DURATIONS[before]),
        DURATIONS.get(class),
    ) {
        (None, Some(end)) => format!("under {end} s"),
        (Some(start), Some(end)) => format!("{start} to {end} s"),
        (Some(start), None) => format!("{start} s and more"),
        (None, None) => "all".to_owned(),
    }
}

/// A bar of at most 24 characters, drawn in eighths of a character, whose length is the share of `value` in `largest`.
fn bar(value: u64, largest: u64) -> String {
    const WIDTH: u64 = 24;
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (8 * WIDTH * value).checked_div(largest).unwrap_or(0);
    let whole = "█".repeat((eighths / 8) as usize);
    format!("{whole}{}", EIGHTHS[(eighths % 8) as usize])
}

/// Writes a table of shares with a bar for each; nothing if there are none.
fn write_shares(
    f: &mut fmt::Formatter<'_>,
    title: &str,
    shares: &BTreeMap<String, Share>,
) -> fmt::Result {
    if shares.is_empty() {
        return Ok(());
    }
    let largest = shares.values().map(|share| share.clips).max().unwrap_or(0);
    writeln!(
        f,
        "\n{title:<24} {:>8} {:>9} {:>8}",
        "clips", "frames", "hours"
    )?;
    for (label, share) in shares {
        writeln!(
            f,
            "{label:<24} {:>8} {:>9} {:>8.2}  {}",
            share.clips,
            share.frames,
            share.hours,
            bar(share.clips, largest)
        )?;
    }
    Ok(())
}

/// Writes a table of counts of a unit, with a bar for each; nothing if there are none.
fn write_counts<'a>(
    f: &mut fmt::Formatter<'_>,
    title: &str,
    unit: &str,
    counts: impl Iterator<Item = (&'a String, &'a u64)> + Clone,
) -> fmt::Result {
    let Some(largest) = counts.clone().map(|(_, count)| *count).max() else {
        return Ok(());
    };
    writeln!(f, "\n{title:<24} {unit:>8}")?;
    for (label, count) in counts {
        writeln!(f, "{label:<24} {count:>8}  {}", bar(*count, largest))?;
    }
    Ok(())
}

impl fmt::Display for Statistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Share {
            clips,
            frames,
            hours,
        } = self.total;
        writeln!(f, "{clips} clips, {frames} frames, {hours:.2} hours")?;
        if let Some(remarks) = &self.remarks {
            writeln!(f, "note: {remarks}")?;
        }
        writeln!(
            f,
            "{} captions of {} words, {} of them made from file names; {} clips without any; {} mirrored",
            self.captions, self.words, self.made_captions, self.silent, self.mirrored
        )?;
        for (title, shares) in [
            ("split", &self.splits),
            ("source", &self.sources),
            ("rotations", &self.rotations),
            ("rate", &self.rates),
            ("licence", &self.licenses),
            ("action", &self.actions),
            ("style", &self.styles),
        ] {
            write_shares(f, title, shares)?;
        }
        let durations = self.durations.iter().map(|class| (&class.0, &class.1));
        write_counts(f, "duration", "clips", durations)?;
        write_counts(f, "finding", "clips", self.flags.iter())?;
        write_counts(f, "mask", "masks", self.masks.iter())?;
        if let Some(masks) = self.masks_per_clip {
            let clips = self.masked_clips;
            writeln!(f, "{clips} clips have masks, {masks:.1} on average")?;
        }
        write_counts(f, "kind of edit", "pairs", self.pairs.iter())?;
        write_counts(f, "style of edit", "pairs", self.pair_styles.iter())?;
        write_counts(f, "pairs of split", "pairs", self.pair_splits.iter())?;
        self.write_spreads(f)
    }
}

impl Statistics {
    fn write_spreads(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\n{:<24} {:>8} {:>8} {:>8} {:>8}",
            "", "p5", "p50", "p95", "max"
        )?;
        let of_clips = [
            ("max speed", self.max_speed),
            ("foot skate", self.foot_skate),
        ];
        let of_clips = of_clips
            .into_iter()
            .filter_map(|(name, spread)| Some((format!("{name}, m/s"), spread?)));
        let errors = self.fit_error_m.iter();
        let errors = errors.map(|(source, spread)| (format!("fit error of {source}, m"), *spread));
        for (label, Spread { p5, p50, p95, max }) in of_clips.chain(errors) {
            writeln!(f, "{label:<24} {p5:>8.3} {p50:>8.3} {p95:>8.3} {max:>8.3}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_are_numbers_that_were_measured() {
        assert_eq!(Spread::of(Vec::new()), None);
        let spread = Spread::of((0..=100).map(f64::from).collect()).expect("some");
        let found = [spread.p5, spread.p50, spread.p95, spread.max];
        assert_eq!(found, [5.0, 50.0, 95.0, 100.0]);
        let one = Spread::of(vec![2.5]).expect("one");
        assert_eq!((one.p5, one.max), (2.5, 2.5));
    }

    #[test]
    fn classes_of_durations_have_names_without_gaps() {
        let names: Vec<String> = (0..=DURATIONS.len()).map(class_name).collect();
        assert_eq!(names[0], "under 1 s");
        assert_eq!(names[1], "1 to 2 s");
        assert_eq!(names[DURATIONS.len()], "60 s and more");
    }

    #[test]
    fn bars_grow_with_their_share() {
        assert_eq!(bar(0, 10), "");
        assert_eq!(bar(10, 10).chars().count(), 24);
        assert_eq!(bar(1, 192), "▏");
        assert_eq!(bar(5, 0), "");
    }
}
