//! Options for reading files.

use std::sync::Arc;

use datasets_spec::{Fps, Skeleton};

use super::body_model::Subjects;
use super::unit::Unit;
use super::up::Up;
use crate::markers::MarkerSet;
use crate::retarget::UserMap;

/// Options for turning files into clips.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Skeleton the motions are posed on.
    pub skeleton: Skeleton,
    /// The user's joint map, which takes precedence over known ones.
    pub user_map: Option<UserMap>,
    /// The user's marker set, which takes precedence over known ones.
    pub markers: Option<MarkerSet>,
    /// Unit of the files; it replaces the unit that they state.
    pub unit: Option<Unit>,
    /// Up axis of the files; it replaces the axis that a joint map states or that the motion shows.
    pub up: Option<Up>,
    /// The wanted frame rate. Readers that can skip frames interpolate to it at exact times; the others keep the file's
    /// own rate.
    pub rate: Option<Fps>,
    /// Accept a BVH or TRC file whose number of rows differs from the header's.
    pub lenient: bool,
    /// Body models by gender, to compute features of AMASS on each subject's own body.
    pub subjects: Option<Arc<Subjects>>,
}
