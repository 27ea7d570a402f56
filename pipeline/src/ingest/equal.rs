//! Similar motions share a split. Similarity is known only after reading, so rows move between shards that are already
//! written.

use std::collections::BTreeMap;

use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{HumanMl3dRow, MarkerRow, MotionRow};
use datasets_spec::table::read_rows;
use datasets_spec::{Split, Transaction};

use super::fates::Files;
use crate::Error;
use crate::clip_table::ClipRow;

/// Moves rows to the splits that `moves` gives their motions. `shards` are those of motions that were staged, and
/// `files` the tables that they belong to; `of` counts the shards of every split. Staged files stay as they are, so
/// that this step can be repeated.
pub(super) fn move_rows(
    (transaction, staging): (&Transaction, &Staging),
    shards: &[(ShardName, FileEntry)],
    files: &mut Files,
    (moves, of): (&BTreeMap<String, Split>, &BTreeMap<Split, usize>),
    facts: &[(&str, String)],
) -> Result<(), Error> {
    let run = Run {
        transaction,
        staging,
        shards,
        moves,
        of,
        facts,
    };
    run.table::<MotionRow>(files)?;
    run.table::<MarkerRow>(files)?;
    run.table::<HumanMl3dRow>(files)
}

struct Run<'a> {
    transaction: &'a Transaction,
    staging: &'a Staging,
    shards: &'a [(ShardName, FileEntry)],
    moves: &'a BTreeMap<String, Split>,
    of: &'a BTreeMap<Split, usize>,
    facts: &'a [(&'a str, String)],
}

impl Run<'_> {
    fn table<R: ClipRow>(&self, files: &mut Files) -> Result<(), Error> {
        let Some(files) = files.get_mut(R::TABLE) else {
            return Ok(());
        };
        let mut moved: BTreeMap<Split, Vec<R>> = BTreeMap::new();
        for (name, shard) in self.shards {
            let is_of_shard = |file: &FileEntry| file.name() == shard.name();
            let Some(place) = files.iter().position(is_of_shard) else {
                continue;
            };
            let rows: Vec<R> = read_rows(&self.staging.path(&files[place]))?;
            let before = rows.len();
            let mut stay = Vec::new();
            for mut row in rows {
                match self.moves.get(row.id().as_str()) {
                    Some(split) => {
                        row.place(row.id().clone(), *split);
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
                files[place] = self.transaction.write_shard(&name, &stay, self.facts)?;
            }
        }
        for (split, rows) in moved {
            let index = self.of.get(&split).copied().unwrap_or(0);
            let name = ShardName {
                table: R::TABLE,
                split: Some(split),
                index,
                of: index + 1,
            };
            files.push(self.transaction.write_shard(&name, &rows, self.facts)?);
        }
        Ok(())
    }
}
