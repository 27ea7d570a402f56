//! Executes a plan: reads the shards and commits the dataset.

use std::collections::{BTreeMap, BTreeSet};

use clip::LabelProblem;
use datasets_spec::dataset::{Commit, ShardName, Staging};
use datasets_spec::license::{self, LICENSES_FACT};
use datasets_spec::manifest::{
    Accounting, FileEntry, Manifest, REJECTED_MASKS_FACT, REJECTED_PAIRS_FACT, RejectedPairs,
    SPLIT_BY_FACT, add_rejected,
};
use datasets_spec::record::{
    HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow,
};
use datasets_spec::rejected::{RejectedMask, RejectedMasks};
use datasets_spec::table::{Row, ShardReader, read_column, read_rows};
use datasets_spec::{Dataset, MotionId, Progress, Split, Transaction};

use super::alike::Alike;
use super::deal::{Dealt, Item};
use super::fates::{Fates, Files, Reread};
use super::growth::LostLabel;
use super::kept::{Outside, Timing};
use super::options::{
    IngestOptions, LABEL_PROBLEMS_FACT, PAIRS_FACT, REFUSED_PAIRS_FACT, REMARKS_FACT, SEED_FACT,
    SETTINGS_FACT, rate_name,
};
use super::plan::Plan;
use super::prepared::Prepared;
use super::report::{IngestReport, Tally, report_on};
use super::shard::ShardNotes;
use super::sources::SOURCES_FACT;
use crate::Error;
use crate::annotation::pairs::RefusedLine;
use crate::clip_table::{ClipRow, ClipWords, is_composed};
use crate::facts::json;
use crate::versions::{is_mask_of_people, is_mask_of_source};
use work::{self, Failed, Made, Piece};

struct Run<'a> {
    transaction: Transaction,
    prepared: &'a Prepared,
    plan: &'a Plan,
    fates: Fates<'a>,
    plan_hash: String,
    facts: [(&'static str, String); 6],
}

/// Origin of the shards of a run.
pub(super) enum Pieces {
    /// Make the shards: read the motions, or take them from an interrupted run of the same plan.
    Make,
    /// Take the shards made by workers: each with its notes, or the reason why it is missing.
    Taken(Vec<Result<(FileEntry, ShardNotes), Failed>>),
}

pub(super) fn piece(plan_hash: &str, number: usize, name: &ShardName, items: &[Item]) -> Piece {
    let reads = items
        .iter()
        .flat_map(|item| [item.planned.entry.file.as_str(), &item.planned.inputs]);
    let stem = format!("{}/{name}", name.table);
    Piece::new(plan_hash, number, stem, items.len() as u64, reads)
}

pub(super) fn shard_facts(options: &IngestOptions, plan_hash: &str) -> [(&'static str, String); 6] {
    [
        ("skeleton", options.read.skeleton.name().to_owned()),
        ("fps", rate_name(options)),
        ("plan_hash", plan_hash.to_owned()),
        ("units", "metres, radians, seconds".to_owned()),
        ("up_axis", "y".to_owned()),
        ("forward_axis", "z".to_owned()),
    ]
}

fn by_content(file: &FileEntry) -> (&str, &str) {
    (&file.path, &file.blake3)
}

/// The pairs that stay, by id, and those that came with clips. A pair whose id exists already stays as it is, because
/// people may have changed it; a different pair under a taken id gets another id. Also returns the number of pairs that
/// stay and that their source gives otherwise now.
fn with_made(staying: Vec<PairRow>, made: Vec<PairRow>) -> (BTreeMap<String, PairRow>, u64) {
    let mut differ = 0;
    let mut rows: BTreeMap<String, PairRow> = BTreeMap::new();
    rows.extend(staying.into_iter().map(|row| (row.id.clone(), row)));
    let stays: BTreeSet<String> = rows.keys().cloned().collect();
    for row in made {
        let is_known = |there: &PairRow| {
            let sides = |row: &PairRow| (row.source_id.clone(), row.target_id.clone());
            *there == row || (stays.contains(&row.id) && sides(there) == sides(&row))
        };
        if let Some(there) = rows.get(&row.id).filter(|there| is_known(there)) {
            differ += u64::from(*there != row);
            continue;
        }
        let numbered = (2..).map(|number| format!("{}/{number}", row.id));
        let mut ids = std::iter::once(row.id.clone()).chain(numbered);
        let id = ids.find(|id| !rows.contains_key(id));
        let id = id.expect("numbers do not end");
        rows.insert(id.clone(), PairRow { id, ..row });
    }
    (rows, differ)
}

/// The pairs of the dataset, and the dropped and refused ones.
struct Pairs {
    rows: Vec<PairRow>,
    /// Number of pairs that their source gives otherwise now.
    differ: u64,
    dropped: u64,
    refused: Vec<RefusedLine>,
}

impl Prepared {
    pub(super) fn conclude(
        self,
        transaction: Transaction,
        plan: &Plan,
        pieces: Pieces,
        progress: &dyn Progress,
    ) -> Result<IngestReport, Error> {
        let recorded = &self.base.recorded;
        let fates = Fates::of(plan, recorded, self.options.prune);
        let outside = plan.outside(recorded);
        let is_same = self.differing.is_none();
        let pairs = self
            .options
            .pairs
            .as_ref()
            .map(|list| list.hash().to_owned());
        let is_complete = !self.is_new
            && is_same
            && fates.nothing_changed()
            && plan.items.iter().all(|item| item.is_kept)
            && plan.has_rejected(recorded, &outside)
            && plan.has_known_sources(recorded)
            && self.base.pairs == pairs;
        let mut report = if is_complete {
            let out = transaction.root().to_owned();
            self.places_with(plan)
                .write(transaction.store().as_ref(), &out)?;
            transaction.finish()?;
            let mut growth = fates.report(plan, &BTreeSet::new());
            growth.count(&self.labels(&fates));
            let dataset = Dataset::open(&out)?;
            let quarantine = dataset.read(None)?;
            let skipped: Vec<SkippedRow> = dataset.read(None)?;
            let mut report = report_on(dataset, plan, quarantine, &skipped)?;
            report.already_complete = true;
            report.notes.growth = Some(growth);
            report
        } else {
            let version = transaction.base().map_or(0, |base| base.version);
            let plan_hash = plan.hash(&self.settings, &self.options, version);
            let run = Run {
                facts: shard_facts(&self.options, &plan_hash),
                transaction,
                prepared: &self,
                plan,
                fates,
                plan_hash,
            };
            run.finish(outside, is_same, pieces, progress)?
        };
        let warning = license::warning(&report.notes.licenses);
        let remarks = &mut report.notes.remarks;
        remarks.extend(plan.notes.choice.iter().cloned());
        remarks.extend(self.kept.iter().cloned().chain(warning));
        Ok(report)
    }
}

impl Run<'_> {
    /// Reads new and changed motions, or takes the shards that were made of them, and commits them with the clips that
    /// stay. `outside` are rejected items of sources that are not of this run. Tables composed of the clips stay if no
    /// clip changes and `is_same` says that the settings did not change either.
    fn finish(
        mut self,
        outside: Outside,
        is_same: bool,
        pieces: Pieces,
        progress: &dyn Progress,
    ) -> Result<IngestReport, Error> {
        let Self { prepared, plan, .. } = self;
        let root = self.transaction.root().to_owned();
        // Refused before the motions are read: clips that cannot stay, ids of two clips, and labels that may not be lost.
        prepared.refuse_mixture(&root, &self.fates)?;
        prepared.refuse_common_ids(&root, plan, &self.fates)?;
        prepared.refuse_loss(
            &root,
            &prepared.labels(&prepared.foreseen(plan, &self.fates, progress)),
        )?;
        let shards = plan.deal(&self.fates.rewritten());
        let mut tally = self.read(&shards, pieces, progress)?;
        let num_beside = self.fates.beside().count() as u64;
        let accounting = tally.accounting(plan.num_items(), outside, num_beside);
        progress.finish(&format!(
            "{} sources: {} ingested, {} quarantined, {} skipped",
            accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
        ));
        let mut labels = prepared.labels(&self.fates);
        labels.follow(&tally.splits(plan));
        if labels.have_ranges() {
            let of = |tables: &Files| {
                let files = tables.get(MotionRow::TABLE).into_iter().flatten();
                Timing::of_files(&root, files)
            };
            let base = self.transaction.base();
            let before = base.map(|base| of(&base.tables)).transpose()?;
            labels.place(&before.unwrap_or_default(), &of(&tally.tables)?);
        }
        prepared.refuse_loss(&root, &labels)?;
        let gone = self.gone_words(&tally)?;
        prepared.refuse_gone(&root, &gone)?;
        let mut growth = self.fates.report(plan, &tally.ingested);
        growth.count(&labels);
        growth.lost.extend(gone);
        let alike = tally.alike.report(&tally.splits(plan));
        let (masks, gave_way, masks_differ) = self.masks(labels.masks, &tally)?;
        let pairs = self.pairs(labels.pairs, &tally)?;
        growth.gave_way = gave_way;
        let differ = [
            (MaskRow::TABLE, masks_differ),
            (PairRow::TABLE, pairs.differ),
        ];
        let differ = differ.into_iter().filter(|(_, count)| *count > 0);
        growth.differ = differ
            .map(|(table, count)| (table.to_owned(), count))
            .collect();
        let tables = self.tables(&mut tally, &masks, &pairs.rows)?;
        let mut carried = self.composed();
        if !is_same || !self.fates.nothing_changed() {
            growth.dropped_tables = std::mem::take(&mut carried).into_iter().collect();
        }
        let mut report = self.commit(tables, carried, accounting, tally, pairs)?;
        report.notes.alike = alike;
        report.notes.growth = (!prepared.is_new).then_some(growth);
        Ok(report)
    }

    /// Reads the shards, or takes those that were made.
    fn read(
        &mut self,
        shards: &[Dealt],
        pieces: Pieces,
        progress: &dyn Progress,
    ) -> Result<Tally, Error> {
        let mut tally = Tally {
            skipped: self.plan.skipped.clone(),
            quarantine: self.plan.rejected.clone(),
            ..Tally::default()
        };
        let total: usize = shards.iter().map(|shard| shard.items.len()).sum();
        progress.begin("ingest", Some(total as u64));
        let mut num_shards = self.fates.rewritten();
        let names = shards.iter().map(|shard| &shard.name);
        num_shards.extend(names.filter_map(|name| Some((name.split?, name.of))));
        let staging = self.transaction.staging(&self.plan_hash);
        let (mut made, mut staged) = (Vec::new(), Vec::new());
        let mut taken = match pieces {
            Pieces::Make => None,
            Pieces::Taken(taken) => Some(taken.into_iter()),
        };
        for (number, shard) in shards.iter().enumerate() {
            let items = self.plan.items_of(shard);
            let (name, items) = (&shard.name, &items[..]);
            let before = match &mut taken {
                None => {
                    let piece = piece(&self.plan_hash, number, name, items);
                    let before = staged_shard(&staging, &piece)?;
                    tally.resumed_shards += usize::from(before.is_some());
                    before
                }
                Some(taken) => match taken.next() {
                    Some(Ok(made)) => Some(made),
                    Some(Err(failed)) => Some(self.failed_shard(name, items, &failed)?),
                    None => None,
                },
            };
            let (entry, notes) = match before {
                Some(done) => {
                    progress.advance(items.len() as u64);
                    done
                }
                None => self.make_shard(&staging, number, (name, items), progress)?,
            };
            made.push((name.clone(), entry.clone()));
            staged.extend(notes.files(&entry).cloned());
            tally.take(entry, notes);
        }
        let unread = self.plan.unread_ids(&tally.quarantine);
        self.fates.settle(|clip| {
            let id = clip.id.as_str();
            if tally.ingested.contains(id) {
                Reread::with(clip, tally.contents.get(id).map_or("", String::as_str))
            } else if unread.contains(id) {
                Reread::Unread
            } else {
                Reread::Refused
            }
        });
        let transaction = &self.transaction;
        self.prepared
            .refuse_mixture(transaction.root(), &self.fates)?;
        let mut tables = self
            .fates
            .shards(transaction, &mut num_shards, &self.facts)?;
        for (table, files) in std::mem::take(&mut tally.tables) {
            tables.entry(table).or_default().extend(files);
        }
        tally.tables = tables;
        self.unite_alike(&mut tally, (&staging, &made), &num_shards)?;
        let staged: BTreeSet<(&str, &str)> = staged.iter().map(by_content).collect();
        let files = tally.tables.values_mut().flatten();
        let files = files.filter(|file| staged.contains(&by_content(file)));
        transaction.adopt(&staging, files)?;
        let staying = self.fates.staying();
        tally.staying = staying
            .map(|clip| (clip.id.to_string(), clip.split))
            .collect();
        Ok(tally)
    }

    /// The captions, performers, actions and styles of clips that their files no longer give: whole columns, since texts
    /// that changed are replaced.
    fn gone_words(&self, tally: &Tally) -> Result<Vec<LostLabel>, Error> {
        let mut gone = Vec::new();
        let Some(base) = self.transaction.base() else {
            return Ok(gone);
        };
        if self.fates.nothing_changed() {
            return Ok(gone);
        }
        let said_in = |tables: &Files| -> Result<BTreeMap<MotionId, _>, Error> {
            let mut said = BTreeMap::new();
            for file in tables.get(MotionRow::TABLE).into_iter().flatten() {
                let path = self.transaction.root().join(&file.path);
                let rows: Vec<ClipWords> = ShardReader::open(&path)?.rows()?;
                said.extend(rows.into_iter().map(|row| (row.id.clone(), row.said())));
            }
            Ok(said)
        };
        let now = said_in(&tally.tables)?;
        for (id, before) in said_in(&base.tables)? {
            let Some(now) = now.get(&id) else { continue };
            for column in before.difference(now) {
                let reason = "its files no longer give them".to_owned();
                gone.push(LostLabel::new(column, id.as_str(), &id, reason));
            }
        }
        Ok(gone)
    }

    fn failed_shard(
        &self,
        name: &ShardName,
        items: &[Item],
        failed: &Failed,
    ) -> Result<(FileEntry, ShardNotes), Error> {
        let notes = ShardNotes::failed(self.plan, items, &failed.code, &failed.reason);
        let none: [MotionRow; 0] = [];
        let entry = self.transaction.write_shard(name, &none, &self.facts)?;
        Ok((entry, notes))
    }

    /// Reads the motions of a shard, and keeps it for a later run of the same plan.
    fn make_shard(
        &self,
        staging: &Staging,
        number: usize,
        (name, items): (&ShardName, &[Item]),
        progress: &dyn Progress,
    ) -> Result<(FileEntry, ShardNotes), Error> {
        let (entry, notes) = self.plan.make_shard(
            staging,
            name,
            items,
            &self.prepared.options,
            &self.facts,
            progress,
        )?;
        let files = notes.files(&entry).cloned().collect();
        let piece = piece(&self.plan_hash, number, name, items);
        work::keep(staging, &piece, Made::new(files, &notes))?;
        Ok((entry, notes))
    }

    /// Finds the motions that are alike, and brings those of this run into the split of the others.
    fn unite_alike(
        &self,
        tally: &mut Tally,
        (staging, made): (&Staging, &[(ShardName, FileEntry)]),
        num_shards: &BTreeMap<Split, usize>,
    ) -> Result<(), Error> {
        let Prepared { base, options, .. } = self.prepared;
        let recorded = &base.recorded;
        let staying = (self.transaction.root(), recorded, &self.fates);
        tally.alike = Alike::find((staging, made), staying, &options.read.skeleton)?;
        let moves = self.plan.moves(recorded, options.seed, &tally.alike);
        if !moves.is_empty() {
            let (shards, moved) = ((staging, made), (&moves, num_shards));
            self.move_rows::<MotionRow>(&mut tally.tables, shards, moved)?;
            self.move_rows::<MarkerRow>(&mut tally.tables, shards, moved)?;
            self.move_rows::<HumanMl3dRow>(&mut tally.tables, shards, moved)?;
            tally.follow(moves);
        }
        Ok(())
    }

    /// Moves rows of a table to the splits that `moves` gives their motions. `made` are the shards of motions that were
    /// staged; `of` counts the shards of every split. Similarity is known only after reading, so rows move between
    /// shards that are already written. Staged files stay as they are, so that this step can be repeated.
    fn move_rows<R: ClipRow>(
        &self,
        files: &mut Files,
        (staging, made): (&Staging, &[(ShardName, FileEntry)]),
        (moves, of): (&BTreeMap<String, Split>, &BTreeMap<Split, usize>),
    ) -> Result<(), Error> {
        let Some(files) = files.get_mut(R::TABLE) else {
            return Ok(());
        };
        let mut moved: BTreeMap<Split, Vec<R>> = BTreeMap::new();
        for (name, shard) in made {
            let is_of_shard = |file: &FileEntry| file.name() == shard.name();
            let Some(place) = files.iter().position(is_of_shard) else {
                continue;
            };
            let rows: Vec<R> = read_rows(&staging.path(&files[place]))?;
            let before = rows.len();
            let mut stay = Vec::new();
            for mut row in rows {
                let clip = row.of_clip();
                match moves.get(clip.id.as_str()) {
                    Some(split) => {
                        *clip.split = *split;
                        moved.entry(*split).or_default().push(row);
                    }
                    None => stay.push(row),
                }
            }
            if stay.is_empty() {
                files.remove(place);
            } else if stay.len() < before {
                let name = ShardName {
                    table: R::TABLE,
                    ..name.clone()
                };
                files[place] = self.transaction.write_shard(&name, &stay, &self.facts)?;
            }
        }
        for (split, rows) in moved {
            let index = of.get(&split).copied().unwrap_or(0);
            let name = ShardName {
                table: R::TABLE,
                split: Some(split),
                index,
                of: index + 1,
            };
            files.push(self.transaction.write_shard(&name, &rows, &self.facts)?);
        }
        Ok(())
    }

    /// The masks that stay and those that came with clips of this run, without those that people rejected. Of a clip that
    /// people described, the masks of its source come back only for the parts for which the dataset still has one; the
    /// number of the others is returned too, and the number of masks of people that the source gives otherwise now.
    fn masks(
        &self,
        staying: Vec<MaskRow>,
        tally: &Tally,
    ) -> Result<(Vec<MaskRow>, u64, u64), Error> {
        let mut gave_way = 0;
        let (mut masks, differ) = tally.masks(staying);
        if self.transaction.base().is_some() {
            let before = Dataset::open_unverified(self.transaction.root())?;
            let rows: Vec<MaskRow> = before.read(None)?;
            let (of_sources, others): (Vec<&MaskRow>, Vec<&MaskRow>) =
                rows.iter().partition(|mask| is_mask_of_source(mask));
            let place = |mask: &MaskRow| (mask.motion_id.clone(), mask.parts.clone());
            let standing: BTreeSet<_> = of_sources.into_iter().map(place).collect();
            let of_people = others.into_iter().filter(|mask| is_mask_of_people(mask));
            let described: BTreeSet<&MotionId> = of_people.map(|mask| &mask.motion_id).collect();
            let num_before = masks.len();
            masks.retain(|mask| {
                let is_same_motion = self.fates.is_read_again(&mask.motion_id).is_ok();
                let is_described = is_same_motion && described.contains(&mask.motion_id);
                !is_described || !is_mask_of_source(mask) || standing.contains(&place(mask))
            });
            gave_way = (num_before - masks.len()) as u64;
            let rejections = before.rejections(&self.rejected_labels()?.0)?;
            masks.retain(|mask| {
                let is_same_motion = self.fates.is_read_again(&mask.motion_id).is_ok();
                is_mask_of_people(mask) || !is_same_motion || !rejections.has(mask)
            });
        }
        Ok((masks, gave_way, differ))
    }

    /// The pairs that stay, those that came with clips of this run, and those of the list.
    fn pairs(&self, staying: Vec<PairRow>, tally: &Tally) -> Result<Pairs, Error> {
        let rejected = self.rejected_labels()?.1.into_values();
        let rejected: BTreeSet<[MotionId; 2]> = rejected.flatten().collect();
        let (mut made, dropped) = tally.pairs(self.plan);
        // They left the dataset when people rejected them.
        made.retain(|row| !rejected.contains(&[row.source_id.clone(), row.target_id.clone()]));
        let (mut rows, differ) = with_made(staying, made);
        let known: Vec<PairRow> = rows.values().cloned().collect();
        let list = self.prepared.options.pairs.as_ref();
        let listed = tally.listed_pairs(self.plan, list, &known, &rejected);
        rows.extend(listed.rows.into_iter().map(|row| (row.id.clone(), row)));
        Ok(Pairs {
            rows: rows.into_values().collect(),
            differ,
            dropped,
            refused: listed.refused,
        })
    }

    /// Writes the tables beside the shards, and returns the files of all tables.
    fn tables(
        &self,
        tally: &mut Tally,
        masks: &[MaskRow],
        pairs: &[PairRow],
    ) -> Result<Files, Error> {
        let Self {
            transaction, facts, ..
        } = self;
        let mut tables = std::mem::take(&mut tally.tables);
        let quarantine = transaction.write_shards(None, &tally.quarantine, facts)?;
        tables.insert(QuarantineRow::TABLE.to_owned(), quarantine);
        let skipped = transaction.write_shards(None, &tally.skipped, facts)?;
        tables.insert(SkippedRow::TABLE.to_owned(), skipped);
        let pairs = write_present(transaction, |row: &PairRow| row.split, pairs, facts)?;
        let masks = write_present(transaction, |row: &MaskRow| row.split, masks, facts)?;
        tables.extend(pairs.into_iter().chain(masks));
        Ok(tables)
    }

    /// Label problems of this run, and recorded ones of files that have not changed.
    fn label_problems(&self, tally: &Tally) -> Vec<LabelProblem> {
        let base = &self.prepared.base;
        let mut problems = tally.label_problems(self.plan);
        let recorded = base.label_problems.clone();
        problems.extend(self.plan.recorded_problems(&base.recorded, recorded));
        problems.sort();
        problems.dedup();
        problems
    }

    /// What people rejected, in this dataset and in those that are sources of it. A mask is named with the motion that it
    /// was rejected for.
    fn rejected_labels(&self) -> Result<(RejectedMasks, RejectedPairs), Error> {
        let base = self.transaction.base();
        let mut masks = base.map_or(Ok(RejectedMasks::new()), Manifest::rejected_masks)?;
        let mut pairs = base.map_or(Ok(RejectedPairs::new()), Manifest::rejected_pairs)?;
        for (number, (_, release)) in self.plan.releases.iter().enumerate() {
            let (of_masks, of_pairs) = &release.contents().rejected_labels;
            if of_masks.is_empty() && of_pairs.is_empty() {
                continue;
            }
            let items = self.plan.items.iter();
            let ids: BTreeMap<&str, &str> = items
                .filter(|item| item.release == Some(number))
                .map(|item| (item.entry.id.as_str(), item.id.as_str()))
                .collect();
            let id = |old: &MotionId| MotionId::parse(ids.get(old.as_str())?).ok();
            let mask_now = |mask: &RejectedMask| {
                Some(RejectedMask {
                    clip: id(&mask.clip)?,
                    ..mask.clone()
                })
            };
            let pair_now = |[source, target]: &[MotionId; 2]| Some([id(source)?, id(target)?]);
            for (by, list) in of_masks {
                let list = list.iter().filter_map(mask_now).collect();
                add_rejected(&mut masks, [(by.clone(), list)]);
            }
            for (by, list) in of_pairs {
                let list = list.iter().filter_map(pair_now).collect();
                add_rejected(&mut pairs, [(by.clone(), list)]);
            }
        }
        masks.retain(|_, list| !list.is_empty());
        pairs.retain(|_, list| !list.is_empty());
        Ok((masks, pairs))
    }

    /// Rejections of masks for the motions that their files give now: the same file read at another rate gives another
    /// motion, and a rejection of the mask holds for it too, unless it is one of a range of frames.
    fn of_motions_now(&self, masks: RejectedMasks, tables: &Files) -> Result<RejectedMasks, Error> {
        if masks.is_empty() {
            return Ok(masks);
        }
        let mut now: BTreeMap<MotionId, String> = BTreeMap::new();
        for file in tables.get(MotionRow::TABLE).into_iter().flatten() {
            let path = self.transaction.root().join(&file.path);
            let ids = read_column::<MotionRow, MotionId>(&path, "id")?;
            now.extend(
                ids.into_iter()
                    .zip(read_column::<MotionRow, String>(&path, "content_hash")?),
            );
        }
        let recorded = &self.prepared.base.recorded.clips;
        let before: BTreeMap<&MotionId, &str> = recorded
            .iter()
            .map(|clip| (&clip.id, clip.content.as_str()))
            .collect();
        let follow = |mut one: RejectedMask| {
            let is_read_again = self.fates.is_read_again(&one.clip) == Ok(true);
            let is_of_motion = before.get(&one.clip) == Some(&one.content.as_str());
            if let (true, Some(content)) = (is_read_again && is_of_motion, now.get(&one.clip)) {
                one.content.clone_from(content);
            }
            one
        };
        let lists = masks.into_iter();
        Ok(lists
            .map(|(by, list)| (by, list.into_iter().map(follow).collect()))
            .collect())
    }

    /// Tables that were composed of the motions of the previous version.
    fn composed(&self) -> BTreeSet<String> {
        let base = self.transaction.base().into_iter();
        let tables = base.flat_map(|base| base.tables.keys());
        tables.filter(|table| is_composed(table)).cloned().collect()
    }

    fn commit(
        self,
        tables: Files,
        carried: BTreeSet<String>,
        accounting: Accounting,
        tally: Tally,
        pairs: Pairs,
    ) -> Result<IngestReport, Error> {
        let Self { prepared, plan, .. } = self;
        let options = &prepared.options;
        let motions = tables.get(MotionRow::TABLE).into_iter().flatten();
        let licenses = license::count(self.transaction.root(), motions)?;
        let label_problems = self.label_problems(&tally);
        let sources = plan.all_labels(&prepared.base.recorded);
        let mut facts = BTreeMap::from([
            (LICENSES_FACT.to_owned(), json(&licenses)),
            (LABEL_PROBLEMS_FACT.to_owned(), json(&label_problems)),
            (SEED_FACT.to_owned(), options.seed.0.to_string()),
            (SPLIT_BY_FACT.to_owned(), plan.notes.split_by.to_string()),
            ("fps".to_owned(), rate_name(options)),
            ("files".to_owned(), plan.files.len().to_string()),
            ("dropped_pairs".to_owned(), pairs.dropped.to_string()),
            (SETTINGS_FACT.to_owned(), prepared.settings.text()),
            (SOURCES_FACT.to_owned(), json(&sources)),
        ]);
        let (masks, rejected_pairs) = self.rejected_labels()?;
        let masks = self.of_motions_now(masks, &tables)?;
        if !masks.is_empty() {
            facts.insert(REJECTED_MASKS_FACT.to_owned(), json(&masks));
        }
        if !rejected_pairs.is_empty() {
            facts.insert(REJECTED_PAIRS_FACT.to_owned(), json(&rejected_pairs));
        }
        if let Some(list) = &options.pairs {
            facts.insert(PAIRS_FACT.to_owned(), list.hash().to_owned());
        }
        if !plan.notes.remarks.is_empty() {
            facts.insert(REMARKS_FACT.to_owned(), plan.notes.remarks.join("; "));
        }
        if !pairs.refused.is_empty() {
            facts.insert(REFUSED_PAIRS_FACT.to_owned(), json(&pairs.refused));
        }
        // Written before the commit: places of sources that no manifest names have no effect.
        let (store, root) = (self.transaction.store(), self.transaction.root());
        prepared.places_with(plan).write(store.as_ref(), root)?;
        let dataset = self.transaction.commit(Commit {
            tables,
            plan_hash: self.plan_hash,
            skeleton: options.read.skeleton.clone(),
            accounting: Some(accounting),
            facts,
            fresh: true,
            carried,
            ..Commit::default()
        })?;
        Ok(IngestReport {
            resumed_shards: tally.resumed_shards,
            ..report_on(dataset, plan, tally.quarantine, &tally.skipped)?
        })
    }
}

/// A shard that an interrupted run of the same plan made.
fn staged_shard(
    staging: &Staging,
    piece: &Piece,
) -> Result<Option<(FileEntry, ShardNotes)>, Error> {
    let stored = work::staged(staging, &piece.id)?;
    Ok(stored.and_then(|stored| {
        let notes = serde_json::from_value::<ShardNotes>(stored.notes).ok()?;
        Some((stored.record.files.into_iter().next()?, notes))
    }))
}

/// Writes a table with a shard for each split that has rows; nothing without rows.
fn write_present<R: Row>(
    transaction: &Transaction,
    split_of: fn(&R) -> Split,
    rows: &[R],
    facts: &[(&str, String)],
) -> Result<Option<(String, Vec<FileEntry>)>, Error> {
    let mut files = Vec::new();
    for split in Split::ALL {
        let rows = rows.iter().filter(|row| split_of(row) == split);
        let rows: Vec<R> = rows.cloned().collect();
        if !rows.is_empty() {
            files.extend(transaction.write_shards(Some(split), &rows, facts)?);
        }
    }
    Ok((!files.is_empty()).then(|| (R::TABLE.to_owned(), files)))
}
