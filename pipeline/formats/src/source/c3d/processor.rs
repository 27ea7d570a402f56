//! Number formats.

/// Number format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    /// Little-endian IEEE numbers.
    Intel,
    /// Little-endian whole numbers and VAX floating point.
    Dec,
    /// Big-endian IEEE numbers.
    Mips,
}

impl Processor {
    pub(super) fn of(code: u8) -> Option<Self> {
        match code {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    pub(super) fn i16(self, bytes: [u8; 2]) -> i16 {
        self.u16(bytes) as i16
    }

    pub(super) fn f32(self, bytes: [u8; 4]) -> f32 {
        match self {
            Self::Intel => f32::from_le_bytes(bytes),
            Self::Mips => f32::from_be_bytes(bytes),
            Self::Dec => {
                // Two little-endian words, the high one first, and an exponent that is two larger.
                let [b0, b1, b2, b3] = bytes;
                f32::from_be_bytes([b1, b0, b3, b2]) / 4.0
            }
        }
    }
}
