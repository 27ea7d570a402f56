//! Messages before and after an ingestion.

use std::collections::BTreeMap;

use clip::LabelProblem;
use datasets_spec::record::MaskRow;
use datasets_spec::table::Row as _;
use pipeline::annotation::pairs::RefusedLine;
use pipeline::ingest::{AlikeClips, Forecast, Growth, IngestNotes, IngestReport};

use crate::report::{accounted, append_list};

/// Message about clips that stay although their files are missing or no longer contain them.
const MISSING: &str = "missing, kept; --prune removes them";
const UNUSABLE: &str = "kept as they were, their files give them no more; --prune removes them";
const UNREAD: &str =
    "kept as they were, their files could not be read this time; run the same command again";

pub(super) fn foreseen(told: &Forecast) -> String {
    let mut text = "nothing was written\n".to_owned();
    for source in &told.sources {
        let is_new = if source.is_new { ", a new source" } else { "" };
        text += &format!("source {}{is_new}\n", source.name);
        let moved: Vec<String> = source
            .moved
            .iter()
            .map(|(id, path)| format!("{id} to {path}"))
            .collect();
        text += &listed("new", &source.new);
        text += &listed("changed", &source.changed);
        text += &listed("read again", &source.read_again);
        text += &listed("moved", &moved);
        text += &counted("equal", source.equal.len() as u64);
        text += &listed(MISSING, &source.missing);
        text += &listed(UNUSABLE, &source.kept_unusable);
        text += &listed("pruned", &source.pruned);
        text += &counted("quarantined", source.quarantined);
        text += &counted("skipped", source.skipped);
    }
    if let Some(settings) = &told.settings {
        text += &format!("settings differ: {settings}\n");
    }
    text += &removed(&told.removed);
    for lost in &told.lost {
        text += &format!(
            "would be lost: {} of {} ({})\n",
            lost.id, lost.table, lost.reason
        );
    }
    for line in &told.refused_splits {
        text += &format!("line of the splits without a clip: {line}\n");
    }
    for remark in &told.remarks {
        text += &format!("note: {remark}\n");
    }
    for refusal in &told.refusals {
        text += &format!("the run would be refused: {refusal}\n");
    }
    text
}

/// Summary of the ingestion, on one screen.
pub(crate) fn summary(done: &IngestReport) -> String {
    let accounting = &done.accounting;
    let complete = match done.already_complete {
        true => " (already complete)",
        false => "",
    };
    let mut text = format!(
        "{} files, {}{complete}\n",
        done.files,
        accounted(accounting)
    );
    for (reason, count) in &done.skipped {
        text += &format!("  skipped {count:>6}  {reason}\n");
    }
    for (code, count) in &accounting.codes {
        text += &quarantined(done, code, *count);
    }
    for (table, rows) in done.dataset.manifest().row_counts() {
        text += &format!("{table:<12} {rows:>8} rows\n");
    }
    text += &noted(&done.notes);
    text += &format!("root hash {}\n", done.dataset.manifest().root_hash);
    text
}

/// What an ingestion has to say beside its counts.
pub(crate) fn noted(done: &IngestNotes) -> String {
    let mut text = String::new();
    if done.dropped_pairs > 0 {
        text += &format!(
            "{} pairs were dropped, because one of their motions is not in the dataset\n",
            done.dropped_pairs
        );
    }
    text += &refused("lines of the pairs gave none", &done.refused_pairs);
    text += &refused("lines of the splits name no clip", &done.refused_splits);
    text += &problems(&done.label_problems);
    for (tag, clips) in &done.licenses {
        let tag = if tag.is_empty() { "not stated" } else { tag };
        text += &format!("licence {tag:<20} {clips:>8} clips\n");
    }
    text += &alike_clips(&done.alike);
    if let Some(growth) = &done.growth {
        text += &grown(growth);
    }
    for remark in &done.remarks {
        text += &format!("note: {remark}\n");
    }
    text
}

/// Number of files that were rejected with a code, and the first three of them.
fn quarantined(done: &IngestReport, code: &str, count: u64) -> String {
    const SHOWN: usize = 3;
    let mut text = format!("  {code:<20} {count:>6}\n");
    let rows = done.quarantine.iter().filter(|row| row.code == code);
    for row in rows.clone().take(SHOWN) {
        let place = row
            .byte_offset
            .map_or(String::new(), |offset| format!(" at byte {offset}"));
        text += &format!("    {}: {}{place}\n", row.path, row.reason);
    }
    let more = rows.count().saturating_sub(SHOWN);
    if more > 0 {
        let root = done.dataset.root().display();
        text += &format!("    and {more} more; stance inspect {root} --list quarantine\n");
    }
    text
}

/// Unusable lines of a list; an empty text if there are none.
fn refused(what: &str, lines: &[RefusedLine]) -> String {
    let all: String = lines.iter().map(|line| format!("  {line}\n")).collect();
    match lines.len() {
        0 => all,
        count => format!("{count} {what}\n{all}"),
    }
}

/// Unusable labels; an empty text if there are none.
fn problems(problems: &[LabelProblem]) -> String {
    let said = "labels could not be used; their motions were ingested without them";
    let lines: Vec<String> = problems.iter().map(ToString::to_string).collect();
    let mut text = String::new();
    append_list(&mut text, &format!("{} {said}", lines.len()), &lines);
    text
}

fn alike_clips(alike: &[AlikeClips]) -> String {
    const SHOWN: usize = 5;
    let (together, apart): (Vec<&AlikeClips>, Vec<&AlikeClips>) =
        alike.iter().partition(|alike| alike.splits.len() == 1);
    let mut text = String::new();
    for (clips, what) in [
        (together, "are nearly equal and share a split"),
        (
            apart,
            "are alike and in several splits, because a list or an earlier version puts them there; \
             `stance verify` reports them",
        ),
    ] {
        for alike in clips.iter().take(SHOWN) {
            let ids: Vec<&str> = alike.clips.iter().take(SHOWN).map(String::as_str).collect();
            let more = match alike.clips.len() - ids.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            text += &format!("{}{more} {what}\n", ids.join(", "));
        }
        if clips.len() > SHOWN {
            text += &format!(
                "and {} more groups that {what}; --json lists all\n",
                clips.len() - SHOWN
            );
        }
    }
    text
}

fn grown(growth: &Growth) -> String {
    let lists = [&growth.changed, &growth.read_again, &growth.moved];
    let [changed, read_again, moved] = lists.map(Vec::len);
    let (new, kept) = (growth.new, growth.kept);
    let mut text = format!(
        "{new} clips are new, {changed} changed, {read_again} were read again, {moved} moved, {kept} stay as they are\n"
    );
    for (what, clips) in [
        ("changed", &growth.changed),
        ("moved", &growth.moved),
        (MISSING, &growth.missing),
        (UNUSABLE, &growth.kept_unusable),
        (UNREAD, &growth.kept_unread),
        ("pruned", &growth.pruned),
    ] {
        text += &listed(what, clips);
    }
    for (table, count) in &growth.labels {
        text += &format!("{count} {table} stay\n");
    }
    if growth.gave_way > 0 {
        text += &format!(
            "{} masks of sources do not come back, because people described their clips without them\n",
            growth.gave_way
        );
    }
    for (table, count) in &growth.differ {
        text += &format!(
            "{count} {table} of people are other in their source now; the dataset keeps its own\n"
        );
    }
    text += &removed(&growth.removed);
    for lost in &growth.lost {
        text += &format!("lost: {} of {} ({})\n", lost.id, lost.table, lost.reason);
    }
    if !growth.dropped_tables.is_empty() {
        text += &format!(
            "not carried over, because clips changed or went: {}; their commands make them again\n",
            growth.dropped_tables.join(", ")
        );
    }
    text
}

/// Automatic labels of clips that changed or were removed; an empty text for none.
fn removed(labels: &BTreeMap<String, u64>) -> String {
    let lines = labels.iter().map(|(table, count)| {
        let verb = match table.as_str() {
            MaskRow::TABLE => "masks --add",
            other => other,
        };
        format!(
            "{count} automatic {table} go with clips that changed or were removed; `stance {verb}` makes those of changed clips again\n"
        )
    });
    lines.collect()
}

/// A number of clips; an empty text for none.
fn counted(what: &str, count: u64) -> String {
    match count {
        0 => String::new(),
        count => format!("  {count:>6} {what}\n"),
    }
}

/// A number of clips, with the first ids; an empty text for none.
fn listed(what: &str, clips: &[String]) -> String {
    const SHOWN: usize = 5;
    let mut text = counted(what, clips.len() as u64);
    for clip in clips.iter().take(SHOWN) {
        text += &format!("         {clip}\n");
    }
    if clips.len() > SHOWN {
        text += &format!(
            "         and {} more; --json lists all\n",
            clips.len() - SHOWN
        );
    }
    text
}
