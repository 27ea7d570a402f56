//! How files are read.

use std::sync::Arc;

use datasets_spec::{Fps, Skeleton};

use super::body_model::Subjects;
use crate::retarget::UserMap;

/// How files are turned into clips.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Skeleton the motions are posed on.
    pub skeleton: Skeleton,
    /// Joint names of the user, which win over those that are known.
    pub user_map: Option<UserMap>,
    /// The rate at which clips are wanted, interpolated at exact times. Readers that can skip the
    /// frames between do so; the others give the file's own rate.
    pub rate: Option<Fps>,
    /// Body models by gender, to compute features of AMASS on each subject's own body.
    pub subjects: Option<Arc<Subjects>>,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            skeleton: Skeleton::smplx_neutral(),
            user_map: None,
            rate: None,
            subjects: None,
        }
    }
}
