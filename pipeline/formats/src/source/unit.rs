//! Units of length that files are in.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Plausible heights of a person in metres.
pub(crate) const PERSON_M: RangeInclusive<f64> = 0.5..=2.5;

/// Typical height of a person in metres: the unit whose result is nearest to it is suspected first.
const COMMON_M: f64 = 1.7;

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Unit {
    metres: f64,
}

/// Units: name in this program, other names in files, and length in metres.
const UNITS: [(&str, &[&str], f64); 6] = [
    ("m", &["meter", "meters", "metre", "metres"], 1.0),
    (
        "cm",
        &["centimeter", "centimeters", "centimetre", "centimetres"],
        0.01,
    ),
    (
        "mm",
        &["millimeter", "millimeters", "millimetre", "millimetres"],
        0.001,
    ),
    ("in", &["inch", "inches", "\""], 0.0254),
    (
        "dm",
        &["decimeter", "decimeters", "decimetre", "decimetres"],
        0.1,
    ),
    ("ft", &["foot", "feet"], 0.3048),
];

/// If the stated unit is implausible, only the first `NUM_COMMON` of [`UNITS`] are suspected.
const NUM_COMMON: usize = 4;

/// Error of parsing a unit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected mm, cm, dm, m, in, ft or a number of metres, got {text:?}")]
pub struct UnitError {
    text: String,
}

impl Unit {
    /// The metre.
    pub const METRE: Self = Self { metres: 1.0 };
    /// The millimetre.
    pub const MILLIMETRE: Self = Self { metres: 0.001 };

    /// A unit of this many metres; `None` if the number is not positive and finite.
    pub fn of_metres(metres: f64) -> Option<Self> {
        (metres.is_finite() && metres > 0.0).then_some(Self { metres })
    }

    /// The unit with this name; `None` if the name is unknown.
    pub fn named(text: &str) -> Option<Self> {
        let text = text.trim().to_lowercase();
        let known = UNITS
            .iter()
            .find(|(name, others, _)| *name == text || others.contains(&text.as_str()));
        known.map(|(_, _, metres)| Self { metres: *metres })
    }

    /// Length of the unit in metres.
    pub fn metres(self) -> f64 {
        self.metres
    }
}

/// Parses a name, or a number of metres.
impl FromStr for Unit {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        let number = || text.trim().parse().ok().and_then(Self::of_metres);
        Self::named(text).or_else(number).ok_or_else(|| UnitError {
            text: text.to_owned(),
        })
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Relative tolerance: files state units as numbers too, which may differ in their last digits.
        const ROUNDING: f64 = 1e-6;
        let is_own = |metres: f64| (self.metres / metres - 1.0).abs() < ROUNDING;
        match UNITS.iter().find(|(.., metres)| is_own(*metres)) {
            Some((name, ..)) => f.write_str(name),
            None => write!(f, "units of {} m", self.metres),
        }
    }
}

/// Common units in which `height` is a person's height, the likeliest first.
pub(crate) fn suspected(height: f64) -> Vec<Unit> {
    let common = UNITS[..NUM_COMMON].iter();
    let mut units: Vec<Unit> = common
        .filter(|(.., metres)| PERSON_M.contains(&(height * metres)))
        .map(|(.., metres)| Unit { metres: *metres })
        .collect();
    let misfit = |unit: &Unit| (height * unit.metres / COMMON_M).ln().abs();
    units.sort_by(|a, b| misfit(a).total_cmp(&misfit(b)));
    units
}

/// Says why `height` is not a person's height in `unit`, and what to do. `stated` says where the unit comes from.
pub(crate) fn misfit(height: f64, unit: Unit, stated: &str) -> String {
    let found = format!(
        "a person would be {} m tall in {unit}, {stated}; expected {} to {} m",
        rounded(height * unit.metres),
        PERSON_M.start(),
        PERSON_M.end()
    );
    let units = suspected(height);
    let Some(first) = units.first() else {
        return format!(
            "{found}, which no common unit makes of it; `stance ingest --unit` takes any number of metres"
        );
    };
    let named: Vec<String> = units
        .iter()
        .map(|unit| format!("{unit} ({} m)", rounded(height * unit.metres)))
        .collect();
    format!(
        "{found}: the numbers are likely {}; `stance ingest --unit {first}` reads them so",
        named.join(" or ")
    )
}

/// A length with three significant digits.
pub(crate) fn rounded(metres: f64) -> String {
    let digits = 2 - metres.abs().max(1e-9).log10().floor() as i32;
    format!("{metres:.*}", digits.clamp(0, 9) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_and_written() {
        for (text, metres, shown) in [
            ("mm", 0.001, "mm"),
            (" Inches ", 0.0254, "in"),
            ("METRES", 1.0, "m"),
            ("0.05644", 0.05644, "units of 0.05644 m"),
            ("0.01", 0.01, "cm"),
        ] {
            let unit: Unit = text.parse().expect(text);
            assert_eq!(unit.metres(), metres, "{text}");
            assert_eq!(unit.to_string(), shown);
        }
        for text in ["", "parsec", "-1", "0", "nan", "inf"] {
            let error = text.parse::<Unit>().expect_err(text);
            assert!(error.to_string().contains("mm, cm"), "{error}");
        }
    }

    #[test]
    fn the_unit_of_a_person_is_suspected() {
        let names = |height| {
            let units = suspected(height).into_iter();
            units.map(|unit| unit.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(names(1.75), ["m"]);
        assert_eq!(names(1750.0), ["mm"]);
        assert_eq!(names(175.0), ["cm"]);
        assert_eq!(names(69.0), ["in", "cm"]);
        assert!(names(0.01).is_empty());
        let said = misfit(1.75, Unit::MILLIMETRE, "the unit of the file");
        assert!(said.contains("0.00175 m tall in mm"), "{said}");
        assert!(said.contains("likely m (1.75 m)"), "{said}");
        assert!(said.contains("--unit m`"), "{said}");
        assert!(misfit(0.01, Unit::METRE, "x").contains("no common unit"));
        assert_eq!(rounded(1694.2), "1694");
    }
}
