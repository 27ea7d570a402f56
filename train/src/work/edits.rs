//! Editing of test items as a job in pieces.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use datasets_spec::dataset::{ShardName, Staging, table_facts};
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Progress, Seed, Skeleton};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use work::{
    self, CommitOptions, Committed, Failed, Finished, Job, Made, Piece, Plan, Quarantine, absolute,
    check_room, commit_edits_in,
};

use super::{Surroundings, changed, in_turn, of_commit, write_plan};
use crate::checkpoint::Slot;
use crate::registry::open_system;
use crate::sample::EditTimes;
use crate::system::{
    EditConfig, EditSystem, Remarks, SystemSource, edit_items, edits_plan, remarks_of,
};
use crate::{Error, Session};

/// Name of the job.
pub const JOB: &str = "edit";

/// Number of items in a piece: the default number of windows generated at a time.
const PIECE_ITEMS: usize = 64;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    items: PathBuf,
    run: PathBuf,
    checkpoint: String,
    coordinator: Option<PathBuf>,
    poses: Option<PathBuf>,
    text_encoder: Option<PathBuf>,
    config: EditConfig,
    seed: Seed,
    /// Device options of the command line.
    device: Value,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Detail {
    take: u64,
    first: usize,
    end: usize,
    of: usize,
}

#[derive(Serialize, Deserialize)]
struct Notes {
    times: EditTimes,
    remarks: Remarks,
}

struct Editing {
    system: Mutex<Box<dyn EditSystem>>,
    rows: Vec<ItemRow>,
    skeleton: Skeleton,
    seed: Seed,
    takes: u64,
    plan_hash: String,
    surroundings: Surroundings,
}

/// Plans the edits of a folder's items by a system. `device` is stored for the workers, and `out` is the folder of the
/// plan.
///
/// # Errors
/// As [`answer_items`](crate::system::answer_items), or the plan's folder is already in use.
pub fn plan_edits(
    source: &SystemSource,
    items: &Path,
    destination: &Path,
    (config, seed): (&EditConfig, Seed),
    device: Value,
    surroundings: Surroundings,
    out: &Path,
) -> Result<Plan, Error> {
    let path = |path: &Option<PathBuf>| path.as_deref().map(absolute).transpose();
    let stored = Stored {
        items: absolute(items)?,
        run: absolute(&source.run)?,
        checkpoint: source.slot.name(),
        coordinator: path(&source.coordinator)?,
        poses: path(&source.poses)?,
        text_encoder: path(&source.text_encoder.given)?,
        config: config.clone(),
        seed,
        device,
    };
    let editing = Editing::open(&stored, surroundings)?;
    if let Some(held) = Dataset::held_in(destination)? {
        let system = in_turn(&editing.system);
        check_room(&held, &editing.rows, Some(system.identity().made_by()))?;
    }
    let pieces = editing.pieces();
    write_plan(JOB, &stored, destination, pieces, editing.plan_hash, out)
}

/// Opens the job of a plan.
///
/// # Errors
/// The system or the items cannot be read, or have changed since the plan was made.
pub fn open_job(plan: &Plan, surroundings: Surroundings) -> Result<Box<dyn Job>, Failed> {
    let stored: Stored = plan.settings()?;
    let editing = Editing::open(&stored, surroundings)?;
    if editing.plan_hash != plan.hash() {
        let (items, run) = (stored.items.display(), stored.run.display());
        return Err(changed(&format!(
            "the items in {items} or the run in {run}"
        )));
    }
    let texts: Vec<String> = editing
        .rows
        .iter()
        .map(|row| row.instruction.clone())
        .collect();
    editing
        .surroundings
        .with_session(|session| in_turn(&editing.system).prepare(&texts, session))?;
    Ok(Box::new(editing))
}

impl Editing {
    fn open(stored: &Stored, surroundings: Surroundings) -> Result<Self, Error> {
        let items = Dataset::open(&stored.items)?;
        let slot: Slot = stored
            .checkpoint
            .parse()
            .map_err(|problem| Error::config("checkpoint", problem))?;
        let source = SystemSource {
            run: stored.run.clone(),
            slot,
            coordinator: stored.coordinator.clone(),
            poses: stored.poses.clone(),
            text_encoder: surroundings.text_encoder(stored.text_encoder.clone()),
        };
        let skeleton = items.skeleton()?;
        let system = open_system(&source, &stored.config, &skeleton, &surroundings.device)?;
        let rows = items.items()?;
        let takes = stored.config.takes.max(1);
        let identity = system.identity();
        Ok(Self {
            plan_hash: edits_plan(&rows, identity, stored.seed, stored.config.takes),
            system: Mutex::new(system),
            rows,
            skeleton,
            seed: stored.seed,
            takes,
            surroundings,
        })
    }

    /// One piece for each group of consecutive items in each take, in the order of the table's rows.
    fn pieces(&self) -> Vec<Piece> {
        let runs = self.rows.len().div_ceil(PIECE_ITEMS);
        let of = runs * usize::try_from(self.takes).unwrap_or(usize::MAX);
        let takes = (0..self.takes).flat_map(|take| (0..runs).map(move |run| (take, run)));
        takes
            .enumerate()
            .map(|(number, (take, run))| {
                let first = run * PIECE_ITEMS;
                let end = self.rows.len().min(first + PIECE_ITEMS);
                let name = format!("edits/take-{take}-items-{first}-to-{end}");
                let ids = self.rows[first..end].iter().map(|row| row.id.as_str());
                let items = (end - first) as u64;
                let piece = Piece::new(&self.plan_hash, number, name, items, ids);
                piece.with(
                    0,
                    &Detail {
                        take,
                        first,
                        end,
                        of,
                    },
                )
            })
            .collect()
    }

    fn edited(&self, detail: &Detail, end: usize) -> Result<(Vec<EditRow>, EditTimes), Failed> {
        let rows = self.rows.get(detail.first..end).ok_or_else(|| {
            Failed::new(
                "E-PLAN",
                "the plan has more items than its folder; plan again",
            )
        })?;
        let seed = Seed(self.seed.0.wrapping_add(detail.take));
        let system = in_turn(&self.system);
        let edit = |session: &Session<'_>| edit_items(&**system, rows, seed, session);
        Ok(self.surroundings.with_session(edit)?)
    }
}

impl Job for Editing {
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed> {
        let detail: Detail = piece.detail()?;
        let (edits, times) = self.edited(&detail, detail.end)?;
        let remarks = match detail.take {
            0 => {
                let system = in_turn(&self.system);
                remarks_of(&**system, &self.rows[detail.first..detail.end])?
            }
            // These remarks depend only on the items, not on the take.
            _ => Remarks::default(),
        };
        let name = ShardName {
            table: EditRow::TABLE,
            split: None,
            index: usize::try_from(piece.number).unwrap_or(usize::MAX),
            of: detail.of,
        };
        let facts = table_facts(&self.skeleton, &self.plan_hash);
        let file = staging.write_shard(&name, &edits, &facts)?;
        Ok(Made::new(vec![file], &Notes { times, remarks }))
    }

    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed> {
        let detail: Detail = piece.detail()?;
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let end = detail.end.min(detail.first.saturating_add(count));
        let (edits, _) = self.edited(&detail, end)?;
        Ok(edits.len() as u64)
    }

    fn commit(
        &self,
        plan: &Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        _progress: &dyn Progress,
    ) -> Result<Committed, work::Error> {
        let transaction = plan.begin(options)?;
        let staging = plan.staging();
        let (made, quarantine) = Quarantine::of(pieces);
        let (mut edits, mut times) = (Vec::new(), EditTimes::default());
        let mut remarks = Remarks::default();
        for (piece, Made { files, notes }) in made {
            for file in &files {
                edits.extend(read_rows::<EditRow>(&staging.path(file))?);
            }
            let notes: Notes = work::notes(plan, &piece, notes)?;
            times += notes.times;
            remarks.num_short += notes.remarks.num_short;
            remarks.num_cut += notes.remarks.num_cut;
            remarks.unknown_words.extend(notes.remarks.unknown_words);
        }
        let dataset = commit_edits_in(
            transaction,
            &self.rows,
            &edits,
            &self.skeleton,
            plan.hash(),
            &quarantine,
        )?;
        remarks.write(plan.destination()).map_err(of_commit)?;
        Ok(Committed {
            notes: json!({ "times": times, "remarks": remarks }),
            ..plan.committed(dataset.manifest())
        })
    }
}
