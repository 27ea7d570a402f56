//! The jobs of this crate that are done in pieces.
//!
//! ```
//! use corpus::{CorpusOptions, write_corpus};
//! use datasets_spec::NoProgress;
//! use pipeline::ingest::{IngestOptions, plan_ingest};
//! use pipeline::jobs::jobs;
//! use work::{CommitOptions, Worker, commit};
//!
//! # let folder = tempfile::tempdir()?;
//! let [sources, dataset, plan] = ["sources", "dataset", "plan"].map(|name| folder.path().join(name));
//! let options = CorpusOptions { clips: 4, ..CorpusOptions::default() };
//! write_corpus(&sources, &options, &NoProgress)?;
//! plan_ingest(&[sources], &dataset, &IngestOptions::default(), &plan, &NoProgress)?;
//!
//! let worker = Worker::open(&plan, jobs())?;
//! for piece in worker.plan().pieces() {
//!     assert!(worker.make(&piece.id).is_done());
//! }
//! let committed = commit(&plan, &jobs(), &CommitOptions::default(), &NoProgress)?;
//! assert_eq!(committed.tables["motions"], 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use work::Jobs;

use crate::{export, ingest};

/// The jobs of this crate, and that of [`compose::recording`].
pub fn jobs() -> Jobs {
    Jobs::none()
        .with(ingest::JOB, Box::new(ingest::open_job))
        .with(
            compose::recording::JOB,
            Box::new(compose::recording::open_job),
        )
        .with(export::JOB, Box::new(export::open_job))
}
