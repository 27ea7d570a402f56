//! Up axes of files.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;
use std::str::FromStr;

use glam::{DQuat, DVec3};
use serde::de::value::{Error, StrDeserializer};
use serde::{Deserialize, Serialize};

/// The up axis of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Up {
    /// The first axis.
    #[serde(rename = "x")]
    X,
    /// Against the first axis.
    #[serde(rename = "-x")]
    MinusX,
    /// The second axis, as in stored motions.
    #[serde(rename = "y")]
    Y,
    /// Against the second axis.
    #[serde(rename = "-y")]
    MinusY,
    /// The third axis.
    #[serde(rename = "z")]
    Z,
    /// Against the third axis.
    #[serde(rename = "-z")]
    MinusZ,
}

/// Error of parsing an axis.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected x, y, z, -x, -y or -z, got {0:?}")]
pub struct UpError(String);

impl Up {
    /// The axis nearest to a direction.
    pub(crate) fn nearest(direction: DVec3) -> Self {
        let size = direction.abs();
        let largest = size.max_element();
        let (plus, minus, along) = if size.z == largest {
            (Self::Z, Self::MinusZ, direction.z)
        } else if size.y == largest {
            (Self::Y, Self::MinusY, direction.y)
        } else {
            (Self::X, Self::MinusX, direction.x)
        };
        if along < 0.0 { minus } else { plus }
    }

    /// The rotation to y up.
    pub fn turn(self) -> DQuat {
        match self {
            Self::X => DQuat::from_rotation_z(FRAC_PI_2),
            Self::MinusX => DQuat::from_rotation_z(-FRAC_PI_2),
            Self::Y => DQuat::IDENTITY,
            Self::MinusY => DQuat::from_rotation_x(PI),
            Self::Z => DQuat::from_rotation_x(-FRAC_PI_2),
            Self::MinusZ => DQuat::from_rotation_x(FRAC_PI_2),
        }
    }
}

impl FromStr for Up {
    type Err = UpError;

    fn from_str(text: &str) -> Result<Self, UpError> {
        let named = StrDeserializer::<Error>::new(text);
        Self::deserialize(named).map_err(|_| UpError(text.to_owned()))
    }
}

impl fmt::Display for Up {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // A formatter is a serialiser of variants without fields: it writes the name that serde has.
        self.serialize(f)
    }
}
