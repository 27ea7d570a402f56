//! Equal motions of different files share a split. That they are equal is known once they are read, so rows
//! move between the shards that were written.

use std::collections::BTreeMap;

use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{HumanMl3dRow, MarkerRow, MotionRow};
use datasets_spec::table::{ShardReader, read_rows};
use datasets_spec::{MotionId, Split, Transaction};

use super::growth::Files;
use crate::Error;
use crate::clip_table::ClipRow;

/// Hash of every motion in some shards, by id.
pub(super) fn contents(
    staging: &Staging,
    shards: &[(ShardName, FileEntry)],
) -> Result<BTreeMap<String, String>, Error> {
    let mut contents = BTreeMap::new();
    for (_, file) in shards {
        let shard = ShardReader::open(&staging.path(file))?;
        let ids = shard.column::<MotionRow, MotionId>("id")?;
        let hashes = shard.column::<MotionRow, String>("content_hash")?;
        contents.extend(ids.into_iter().map(String::from).zip(hashes));
    }
    Ok(contents)
}

/// Moves rows to the splits that `moves` gives their motions. `shards` are those of motions that were staged, and
/// `files` the tables that they belong to. Staged files stay as they are, so that this can be done again.
pub(super) fn move_rows(
    (transaction, staging): (&Transaction, &Staging),
    shards: &[(ShardName, FileEntry)],
    files: &mut Files,
    moves: &BTreeMap<String, Split>,
    facts: &[(&str, String)],
) -> Result<(), Error> {
    let run = Run {
        transaction,
        staging,
        shards,
        moves,
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
    facts: &'a [(&'a str, String)],
}

impl Run<'_> {
    fn table<R: ClipRow>(&self, files: &mut Files) -> Result<(), Error> {
        let Some(files) = files.get_mut(R::TABLE) else {
            return Ok(());
        };
        let mut moved: BTreeMap<Split, Vec<R>> = BTreeMap::new();
        for (name, shard) in self.shards {
            let is_of_shard = |file: &FileEntry| {
                let stem = |path: &str| path.rsplit('/').next().unwrap_or(path).to_owned();
                stem(&file.path) == stem(&shard.path)
            };
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
            let own = self
                .shards
                .iter()
                .filter(|(name, _)| name.split == Some(split));
            let index = own.map(|(name, _)| name.of).max().unwrap_or(0);
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
