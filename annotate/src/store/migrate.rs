//! Versions of the tables, and the upgrade of a store of an older version.
//!
//! # To change the tables
//!
//! 1. Change `schema.sql` (tables that are not derived) or `projections.sql` (tables derived from the log) to the form
//!    in a new store. A new projection also has a line in [`derived::PROJECTIONS`].
//! 2. Append a step to [`STEPS`]: SQL for both databases that brings the tables of `schema.sql` from the previous
//!    version to the new one. It is empty if only projections or their rows changed: every upgrade drops the
//!    projections, creates them again and derives them from the log.
//! 3. The log itself is never rewritten. A new field of an entry's body needs `#[serde(default)]`. A new setting needs
//!    no step: a stored value without it gets the value of `Settings::default`.
//!
//! Test `a_store_of_each_older_version_is_upgraded_after_a_copy` opens stores of older versions
//! (`tests/stores`) and compares their tables with those of a new store.

use super::db::{Result, Tx, not_opened, params};
use super::store::{Store, Upgrade};
use super::{derived, people, project};
use crate::Error;

const SCHEMA: &str = include_str!("schema.sql");

/// Changes of `schema.sql`, from version 1 on.
const STEPS: &[&str] = &[
    // 2: a store has an id, which every upgrade gives to a store without one.
    "",
    // 3: the projection `work`, which every upgrade derives.
    "",
    // 4: gold tasks have places in bundles, and servers share the files of exports.
    "CREATE TABLE job_file (
  job BIGINT NOT NULL,
  name TEXT NOT NULL,
  part BIGINT NOT NULL,
  bytes BYTEA NOT NULL,
  PRIMARY KEY (job, name, part)
)",
    // 5: searchable texts, how an answer was accepted, practice; pictures of the guide, paraphrases.
    "CREATE TABLE picture (
  name TEXT PRIMARY KEY,
  mime TEXT NOT NULL,
  bytes TEXT NOT NULL,
  at BIGINT NOT NULL
);

CREATE TABLE paraphrase (
  id BIGINT PRIMARY KEY,
  instruction TEXT NOT NULL,
  text TEXT NOT NULL,
  model TEXT NOT NULL,
  prompt_hash TEXT NOT NULL,
  state TEXT NOT NULL,
  judge BIGINT,
  at BIGINT NOT NULL,
  UNIQUE (instruction, text)
);
CREATE INDEX paraphrase_state ON paraphrase (state, id);",
    // 6: imported answers have an author; a clip may have had other content before; categories have a quota.
    "CREATE TABLE motion_now (
       hash TEXT PRIMARY KEY,
       id TEXT NOT NULL,
       split TEXT NOT NULL,
       frames BIGINT NOT NULL,
       fps DOUBLE PRECISION NOT NULL,
       captions TEXT NOT NULL,
       style TEXT,
       action TEXT,
       current BIGINT NOT NULL
     );
     INSERT INTO motion_now SELECT hash, id, split, frames, fps, captions, style, action, 1 FROM motion;
     DROP TABLE motion;
     ALTER TABLE motion_now RENAME TO motion;
     CREATE UNIQUE INDEX motion_id ON motion (id) WHERE current = 1;",
    // 7: paraphrases are removed. Decisions about them stay in the log.
    "DROP TABLE paraphrase",
    // 8: edit types of pairs, for their quotas.
    "",
    // 9: whose answers a decision concerned; answers that were taken back do not count as work.
    "",
    // 10: labels of the dataset are marked, and give way to other answers.
    "",
];

/// Version of the tables of this program.
pub(super) const VERSION: i64 = 1 + STEPS.len() as i64;

/// Name of the setting that holds the id.
pub(super) const ID: &str = "id";
/// Bytes of the id.
const ID_BYTES: usize = 8;

impl Store {
    /// The id of the store, drawn when it was created; its copies share it.
    pub fn id(&self) -> Result<String> {
        self.read(|tx| project::get(tx, ID)?.ok_or(Error::Closed))
    }
}

/// Name of the operation that creates or upgrades tables, for errors.
pub(super) const MAKE: &str = "make its tables";

/// Creates the tables of a store and `triggers` if its version is 0. Otherwise upgrades tables of an older version,
/// after `copy` made a copy and returned its place.
pub(super) fn prepare(
    tx: &mut dyn Tx,
    place: &str,
    found: i64,
    triggers: &str,
    copy: impl FnOnce(&mut dyn Tx) -> Result<String>,
) -> Result<Option<Upgrade>> {
    let mut upgrade = None;
    match found {
        VERSION => return Ok(None),
        0 => {
            for sql in [SCHEMA, derived::SCHEMA, triggers] {
                tx.define(sql)?;
            }
        }
        1..VERSION => {
            upgrade = Some(Upgrade {
                from: found,
                to: VERSION,
                copy: copy(tx)?,
            });
            let done = usize::try_from(found - 1).unwrap_or(0);
            for step in &STEPS[done..] {
                tx.define(step)?;
            }
            for (table, ..) in derived::PROJECTIONS {
                tx.define(&format!("DROP TABLE IF EXISTS {table}"))?;
            }
            tx.define(derived::SCHEMA)?;
            derived::derive(tx)?;
        }
        newer => {
            let reason = format!(
                "its tables have version {newer}, this program knows versions up to {VERSION}; use the stance that \
                 wrote it, or a newer one"
            );
            return Err(not_opened(place, reason));
        }
    }
    // Gives the store an id, if it has none.
    let sql = "INSERT INTO setting (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO NOTHING";
    tx.run(sql, params![ID, people::random::<ID_BYTES>()?])?;
    Ok(upgrade)
}
