//! Composition settings of a run's windows, as stored in its record.

use compose::ComposeConfig;
use datasets_spec::Seed;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Settings and seed of the composer. The editor also uses the frame rate and the anchor, because the network was
/// trained only with these.
///
/// Records of version 1.3 and earlier hold the same data as JSON text in a string, which is accepted too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub struct ComposeRecord {
    /// The settings.
    pub config: ComposeConfig,
    /// The seed of the composer's draws.
    pub seed: Seed,
}

#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum Written {
    Fields { config: ComposeConfig, seed: Seed },
    Text(String),
}

impl TryFrom<Written> for ComposeRecord {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let (config, seed) = match written {
            Written::Fields { config, seed } => (config, seed),
            Written::Text(text) if text.is_empty() => {
                return Err(
                    "the run does not say how its windows were composed; import the model again"
                        .to_owned(),
                );
            }
            Written::Text(text) => serde_json::from_str(&text)
                .map_err(|error| format!("the composer's settings cannot be read: {error}"))?,
        };
        Ok(Self { config, seed })
    }
}

impl ComposeRecord {
    /// Checks the settings, and that their windows have the length that the network expects.
    pub(crate) fn check(&self, window: usize) -> Result<(), Error> {
        let problem = match self.config.check() {
            Err(error) => error.to_string(),
            Ok(()) if self.config.window != window => format!(
                "its windows have {} frames, and the network is made for {window}",
                self.config.window
            ),
            Ok(()) => return Ok(()),
        };
        Err(Error::config("compose", problem))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_read_as_they_are_written_and_as_they_were() {
        let record = ComposeRecord {
            config: ComposeConfig {
                fixed_pairs: true,
                ..ComposeConfig::default()
            },
            seed: Seed(7),
        };
        let json = serde_json::to_string(&record).expect("serialises");
        let old = serde_json::to_string(&(&record.config, record.seed)).expect("serialises");
        let old = serde_json::to_string(&old).expect("serialises");
        for text in [&json, &old] {
            let read: ComposeRecord = serde_json::from_str(text).expect("known");
            assert_eq!(read, record);
        }
        assert!(serde_json::from_str::<ComposeRecord>("\"\"").is_err());
    }

    #[test]
    fn settings_out_of_range_and_other_windows_are_refused() {
        let record = |config| ComposeRecord {
            config,
            seed: Seed(0),
        };
        let usable = ComposeConfig::default();
        assert!(record(usable.clone()).check(usable.window).is_ok());
        assert!(record(usable.clone()).check(usable.window + 1).is_err());
        let unusable = ComposeConfig {
            mcm_ratio: 2.0,
            ..usable.clone()
        };
        assert!(record(unusable).check(usable.window).is_err());
    }
}
