//! Body models of AMASS releases.

/// A body model of AMASS, and the release that uses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Variant {
    /// The 22 joints that all models share.
    BodyOnly,
    /// SMPL, 24 joints.
    Smpl,
    /// SMPL-H for the subject's gender, 52 joints: the variant that HumanML3D uses.
    SmplH,
    /// SMPL-X for the subject's gender, 55 joints.
    SmplXGendered,
    /// SMPL-X, neutral body.
    SmplXNeutral,
}

impl Variant {
    /// The name on the AMASS download page, if it has one.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BodyOnly => "body only",
            Self::Smpl => "SMPL",
            Self::SmplH => "SMPL-H G",
            Self::SmplXGendered => "SMPL-X G",
            Self::SmplXNeutral => "SMPL-X N",
        }
    }

    /// Whether the parameters are those of SMPL-X.
    pub fn is_smplx(self) -> bool {
        matches!(self, Self::SmplXGendered | Self::SmplXNeutral)
    }

    /// The variant of `poses` of this width; none if there is no such model.
    pub(super) fn of_width(width: usize, gender: Option<&str>) -> Option<Self> {
        match width {
            66 => Some(Self::BodyOnly),
            72 => Some(Self::Smpl),
            156 => Some(Self::SmplH),
            165 => Some(Self::smplx(gender)),
            _ => None,
        }
    }

    pub(super) fn smplx(gender: Option<&str>) -> Self {
        match gender {
            Some("male" | "female") => Self::SmplXGendered,
            _ => Self::SmplXNeutral,
        }
    }
}
