//! Errors of the evaluation.

use std::path::PathBuf;

use datasets_spec::Code;

/// Error of a caller's encoder.
pub type EncoderError = Box<dyn std::error::Error + Send + Sync>;

/// An evaluation error; it names the system and the item concerned.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A table of edits cannot be opened, read or written.
    #[error(transparent)]
    Spec(#[from] datasets_spec::Error),
    /// No table was given.
    #[error("no table of edits was given")]
    NoTables,
    /// Two tables of edits use different skeletons.
    #[error(
        "{} is posed on skeleton {first_skeleton}, {} on {other_skeleton}; tables of edits are \
         compared on one body",
        first.display(),
        other.display()
    )]
    OtherSkeleton {
        /// The first table.
        first: PathBuf,
        /// Skeleton of the first table.
        first_skeleton: String,
        /// The other table.
        other: PathBuf,
        /// Skeleton of the other table.
        other_skeleton: String,
    },
    /// Two tables of edits are of different items.
    #[error(
        "{} and {} answer different items: {} of {} are in {} alone, {} of {} in {} alone; edit the \
         same items: stance edit RUN --items ITEMS",
        first.display(),
        other.display(),
        first_alone[0],
        first_alone[1],
        first.display(),
        other_alone[0],
        other_alone[1],
        other.display()
    )]
    OtherItems {
        /// The first table.
        first: PathBuf,
        /// Number of items only in the first table, and of all its items.
        first_alone: [usize; 2],
        /// The other table.
        other: PathBuf,
        /// Number of items only in the other table, and of all its items.
        other_alone: [usize; 2],
    },
    /// A table of edits cannot be used.
    #[error("in {}", path.display())]
    TableOf {
        /// The table.
        path: PathBuf,
        /// The cause.
        source: Box<Error>,
    },
    /// A comparison needs tables of one system each, and this table holds several.
    #[error(
        "{} holds {count} systems ({systems}), and a comparison needs one",
        path.display()
    )]
    SeveralSystems {
        /// The table.
        path: PathBuf,
        /// Number of systems in the table.
        count: usize,
        /// Names of the systems.
        systems: String,
    },
    /// Two systems have the same name and would share a row of a table.
    #[error(
        "system {system:?} stands for two {what}: {first} and {other}; edit again with --name to tell \
         them apart"
    )]
    TwoSystems {
        /// The name.
        system: String,
        /// The property that differs.
        what: &'static str,
        /// Value of the first system.
        first: String,
        /// Value of the other system.
        other: String,
    },
    /// The points of a figure cannot be made.
    #[error("figure {figure:?}: {problem}")]
    Figure {
        /// Name of the figure.
        figure: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The editing times beside a table of edits cannot be read.
    #[error(
        "cannot read {}; it is written when `stance edit` edits a split",
        path.display()
    )]
    Times {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// There are no items to score.
    #[error("the table holds no items; draw them with `stance items`")]
    NoItems,
    /// An item cannot be used.
    #[error("item {id:?} cannot be used")]
    Item {
        /// The item.
        id: String,
        /// The cause, boxed because it is larger than any other variant.
        source: Box<datasets_spec::Error>,
    },
    /// An item has no target to compare with.
    #[error("item {id:?} has no target to compare with; score items drawn by `stance items`")]
    NoTarget {
        /// The item.
        id: String,
    },
    /// A system edited only some of the items.
    #[error(
        "system {system:?} lacks {count} of {total} items: {ids}; edit them or leave the system out"
    )]
    MissingItems {
        /// The system.
        system: String,
        /// Number of missing items.
        count: usize,
        /// Number of items of the test set.
        total: usize,
        /// Ids of the first missing items.
        ids: String,
    },
    /// A system edited items that have no target.
    #[error(
        "system {system:?} has {count} items without a target: {ids}; score them with the table they belong to"
    )]
    UnknownItems {
        /// The system.
        system: String,
        /// Number of such items.
        count: usize,
        /// Ids of the first ones.
        ids: String,
    },
    /// A system has more motions of some items than of others.
    #[error(
        "system {system:?} has {found} motions of item {id:?} but {expected} of the others; give every item the same number of takes"
    )]
    UnevenTakes {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// Motions of this item.
        found: usize,
        /// Motions of the first item.
        expected: usize,
    },
    /// A system has the same take of an item twice.
    #[error(
        "system {system:?} has two motions of item {id:?} sampled with seed {seed}; give each take once, or edit again with another --seed"
    )]
    SameTake {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// The seed.
        seed: u64,
    },
    /// A system has the name of a row that this crate computes itself.
    #[error("a system cannot be named {system:?}, which is a row of every table; rename it")]
    ReservedSystem {
        /// The name.
        system: String,
    },
    /// A requested system has no rows.
    #[error("there is no system {system:?} among the edits; there are: {known}")]
    UnknownSystem {
        /// The requested system.
        system: String,
        /// The existing names.
        known: String,
    },
    /// The columns of a row do not form a motion.
    #[error("system {system:?}, item {id:?}: not a motion")]
    Motion {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// The cause, boxed because it is larger than any other variant.
        source: Box<datasets_spec::Error>,
    },
    /// A motion is too short for measuring the foot speed.
    #[error(
        "system {system:?}, item {id:?}: {frames} frames are too few for the foot score, which needs {needed}"
    )]
    TooShort {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// Frames present.
        frames: usize,
        /// Frames needed.
        needed: usize,
    },
    /// Motions of one item have different frame rates.
    #[error(
        "system {system:?}, item {id:?}: {found} fps, but its target runs at {expected} fps; resample before scoring"
    )]
    FrameRate {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// Rate of the motion.
        found: f64,
        /// Rate of the target.
        expected: f64,
    },
    /// The encoder failed.
    #[error("cannot encode the motions of system {system:?}")]
    Encoder {
        /// The system.
        system: String,
        /// The cause.
        source: EncoderError,
    },
    /// The encoder returned another number of latents than it was given motions.
    #[error("the encoder returned {found} latents for {expected} motions of system {system:?}")]
    LatentCount {
        /// The system.
        system: String,
        /// Latents returned.
        found: usize,
        /// Motions given.
        expected: usize,
    },
    /// A latent has another width than the others, is not finite, or has length zero.
    #[error("system {system:?}, item {id:?}: the latent {problem}")]
    Latent {
        /// The system.
        system: String,
        /// The item.
        id: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A metric was given fewer feature rows than it is defined for.
    #[error("{metric} needs at least {needed} rows, got {found}")]
    TooFewRows {
        /// The metric.
        metric: &'static str,
        /// Rows needed.
        needed: usize,
        /// Rows given.
        found: usize,
    },
    /// Two inputs of a metric differ in size.
    #[error("{metric}: {what} is {found}, expected {expected}")]
    Size {
        /// The metric.
        metric: &'static str,
        /// Name of the size.
        what: &'static str,
        /// Size found.
        found: usize,
        /// Size expected.
        expected: usize,
    },
    /// A metric was given a number that is NaN or infinite.
    #[error("{metric}: row {row} is not finite")]
    NotFinite {
        /// The metric.
        metric: &'static str,
        /// Row index.
        row: usize,
    },
    /// A latent has length zero, so its cosine is undefined.
    #[error("{metric}: row {row} is zero and has no direction")]
    NoDirection {
        /// The metric.
        metric: &'static str,
        /// Row index.
        row: usize,
    },
    /// A protocol's setting is too small to measure anything.
    #[error("protocol: {field} must be at least {needed}, got {found}")]
    Protocol {
        /// The setting.
        field: &'static str,
        /// Smallest sensible value.
        needed: usize,
        /// Value given.
        found: usize,
    },
    /// More items are requested than exist.
    #[error(
        "{asked} items are to be scored, and there are {found}; ask for fewer or leave the limit out"
    )]
    Limit {
        /// The requested number of items.
        asked: usize,
        /// Number of existing items.
        found: usize,
    },
    /// The report of an encoder cannot be read.
    #[error(
        "cannot read {path}, the report of an encoder; remove it and run the same `stance train tmr` again"
    )]
    Report {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A score table cannot be written as JSON.
    #[error("cannot write the scores as JSON")]
    Json {
        /// The cause.
        source: serde_json::Error,
    },
}

impl Error {
    /// The code of the error, if it has one, and the item concerned.
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Spec(error) => error.code(),
            _ => None,
        }
    }
}
