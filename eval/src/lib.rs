//! Metrics, protocols, tables and reports.
//!
//! This crate measures edited motions: it reads the `edits` table, asks the caller's [`evaluators::MotionEncoder`] for
//! latents, and returns rows of the `scores` table, which it lays out as text, Markdown, LaTeX, CSV or JSON and draws
//! into one self-contained HTML report. It has no access to models, so all systems are scored by the same code.
//! [`answers`] reads tables of edits and commits scores; [`judge`] decides whether an encoder may rank systems;
//! [`best_edit`] chooses the first edit of a report; [`figure`] holds the points and drawings of ablations. [`rows`]
//! reads motions on demand, so memory does not grow with their number.
//!
//! Start at [`answers::Scores::of`] and [`protocol::Protocol`].
//!
//! ```
//! use datasets_spec::record::ItemRow;
//! use datasets_spec::{Fps, Motion, MotionId, NoProgress, Pose, Skeleton, Split};
//! use eval::answers::{Answered, Scores};
//! use eval::evaluators::{Evaluators, MotionEncoder};
//! use eval::metric::{Part, of_part};
//! use eval::protocol::Protocol;
//! use eval::table::Table;
//! use eval::{EncoderError, format};
//!
//! /// An encoder that sees the height of the first frame and how far the motion gets.
//! struct Path;
//!
//! impl MotionEncoder for Path {
//!     fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
//!         let latent = |motion: &&Motion| {
//!             let [first, last] = [0, motion.len() - 1].map(|frame| motion.pose(frame).transl);
//!             vec![1.0 + first.y, last.x - first.x]
//!         };
//!         Ok(motions.iter().map(latent).collect())
//!     }
//!     fn hash(&self) -> String {
//!         "00ff".to_owned()
//!     }
//!     fn recipe(&self) -> String {
//!         "path".to_owned()
//!     }
//!     fn weakness(&self) -> Option<String> {
//!         None
//!     }
//! }
//!
//! // Each item has a source that stands, and a target that slides along x at a speed of its own.
//! let slide = |speed: f64| {
//!     let pose = |frame| {
//!         let mut pose = Pose::REST;
//!         pose.transl.x = speed * f64::from(frame);
//!         pose
//!     };
//!     let poses: Vec<Pose> = (0..20).map(pose).collect();
//!     Motion::from_poses(Fps::STORE, &poses)
//! };
//! let mut items = Vec::new();
//! for speed in 0..4 {
//!     let mut item = ItemRow::blank(&MotionId::parse(&format!("slide{speed}"))?, Split::Test);
//!     item.instruction = "slide".to_owned();
//!     let target = slide(0.01 * f64::from(speed))?;
//!     item.set_motions(&slide(0.0)?, Some(&target), None);
//!     item.id = item.content_id();
//!     items.push(item);
//! }
//! // Edits are the rows of `stance edit`; without any, only the reference rows are scored. `Answered::read` leaves the
//! // motions of items and edits in the files, and reads some at a time.
//! let answered = Answered::of_rows(items, Vec::new(), Skeleton::smplx_neutral());
//! let evaluators = Evaluators {
//!     encoder: &Path,
//!     classifier: None,
//!     skeleton: &answered.skeleton,
//! };
//! let scores = Scores::of(&answered, evaluators, &Protocol::default(), &NoProgress)?;
//! let tables = Table::from_scores(&scores.rows, &scores.judges, &of_part(Part::Paper));
//! println!("{}", format::text::render(&tables));
//! assert!(tables[0].rows.iter().any(|row| row.system == "Identity"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod answered;
pub mod answers;
pub mod best_edit;
pub mod compare;
pub mod draw;
mod error;
pub mod evaluators;
pub mod figure;
pub mod format;
pub mod judge;
pub mod linalg;
pub mod metric;
pub mod names;
pub mod protocol;
pub mod published;
pub mod report;
pub mod rows;
pub mod score;
pub mod table;
pub mod times;

#[cfg(test)]
mod golden;

pub use error::{EncoderError, Error};
