//! Long jobs as plans of pieces, for one process or for many on any number of machines.
//!
//! A [`Plan`] is a folder that lists the [`Piece`]s of a job. A [`Worker`] makes pieces: each writes its own files
//! and answers with a [`Record`], never with an error. [`commit`] checks that all pieces are there and makes them a
//! part of the dataset. Pieces may be made in any order, by any number of workers, and more than once: the result is
//! the same.
//!
//! Workers take no lock. The files of a piece lie in a folder of the plan beside the dataset
//! ([`Staging`](datasets_spec::dataset::Staging)) until the commit, which one process does under the dataset's lock.

mod commit;
mod context;
mod edits;
mod error;
mod folder;
mod job;
mod piece;
mod plan;
mod record;
mod worker;

pub use self::commit::{Quarantine, Status, commit, status};
pub use self::context::Context;
pub use self::edits::{check_room, commit_edits, commit_edits_in, make_room, refuse_items};
pub use self::error::Error;
pub use self::folder::{NewFolder, is_occupied};
pub use self::job::{Job, Jobs, Open, notes};
pub use self::piece::Piece;
pub use self::plan::{Draft, Plan, State, absolute};
pub use self::plan::{hash_file, read_json, write_json, write_table};
pub use self::record::{CommitOptions, Committed, Failed, Finished, Made, Outcome, Record};
pub use self::record::{keep, staged};
pub use self::worker::{Sample, Worker};
