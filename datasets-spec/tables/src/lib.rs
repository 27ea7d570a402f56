//! SQL over the tables of datasets.
//!
//! [`Tables`] answers a query over the tables of one dataset or of several, [`Condition`] chooses clips of one. polars
//! plans and computes; the columns come from [`ShardReader`](datasets_spec::table::ShardReader), which reads only the
//! columns that a query names, from disks and from buckets. A query cannot reach anything else: there are no table
//! functions, and the only statement is `SELECT`.
//!
//! The table of motions has further columns, which are derived from its own and from the tables beside it:
//!
//! | column | type | meaning |
//! |---|---|---|
//! | `seconds` | f64 | `n_frames / fps` |
//! | `max_speed`, `foot_skate` | f32 | these fields of `quality` |
//! | `flags` | struct of bool | findings of the quality checks, such as `flags.poor_fit` |
//! | `texts`, `part_texts` | `list<utf8>` | the texts of `captions` and `part_captions` |
//! | `n_captions` | u32 | number of captions, without those of parts |
//! | `has_mask`, `has_pair` | bool | whether the clip has a mask, or is the source or target of a pair |
//!
//! In addition to the SQL of polars, `LIKE` takes `ESCAPE`, and `len` is the length of a list or the number of
//! characters of a text. A test of a list (`captions LIKE '%walk%'`, `notes = 'x'`, `parts IN ('HEAD')`) is true if it
//! is true for one of its texts; without texts it is null.

mod answer;
mod arrays;
mod condition;
mod derived;
mod error;
mod rewrite;
mod scan;
mod tables;

pub use self::answer::Answer;
pub use self::condition::{Condition, chosen};
pub use self::error::Error;
pub use self::tables::Tables;
