//! Options that several verbs share.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use compose::FrameCache;
use datasets_spec::Seed;
use serde::Serialize;
use serde_json::Value;
use train::config::Preset;
use work::Context;

use crate::exit::Exit;
use crate::progress::Bars;
use crate::report;

/// Options every verb takes.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Global options")]
pub(crate) struct Global {
    /// Worker threads; results do not depend on it [default: all cores]
    #[arg(long, global = true, value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) threads: Option<u16>,
    /// Seed of every draw, instead of the seeds in settings files [default: 0]
    #[arg(long, global = true)]
    pub(crate) seed: Option<u64>,
    /// Print results as one JSON document
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Print nothing but results and errors
    #[arg(long, global = true)]
    quiet: bool,
    /// Draw no progress bars
    #[arg(long, global = true)]
    no_progress: bool,
}

impl Global {
    /// Applies the options that concern the whole process.
    pub(crate) fn start(&self) -> anyhow::Result<()> {
        if let Some(threads) = self.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads.into())
                .build_global()?;
        }
        // Check the variables of the frame cache now, so that long work does not fail later because of a wrong one.
        FrameCache::from_environment(|name| std::env::var_os(name)).map_err(anyhow::Error::msg)?;
        Ok(())
    }

    pub(crate) fn seed(&self) -> Seed {
        self.seed_or(None)
    }

    /// The option `--seed` as it was given, for the commands that reports print; empty if it was not given.
    pub(crate) fn seed_option(&self) -> String {
        self.seed
            .map_or(String::new(), |seed| format!(" --seed {seed}"))
    }

    /// `--seed` if it is given, otherwise the seed in the settings.
    pub(crate) fn seed_or(&self, own: Option<u64>) -> Seed {
        Seed(self.seed.or(own).unwrap_or(0))
    }

    pub(crate) fn stage<T, E>(
        &self,
        act: impl FnOnce(&Context<'_>) -> Result<T, E>,
    ) -> Result<T, E> {
        act(&Context {
            progress: &self.bars(),
            holder: &self.holder(),
        })
    }

    /// Prints a result: one document for programs with `--json`, else text for people.
    pub(crate) fn say<T: Serialize>(&self, document: &T, text: &str) -> anyhow::Result<Exit> {
        match self.json {
            true => report::json(document)?,
            false => report::text(text),
        }
        Ok(Exit::Done)
    }

    /// Prints a result whose document has the fields of two values.
    pub(crate) fn say_joined<T: Serialize>(
        &self,
        own: Value,
        all_of: &T,
        text: &str,
    ) -> anyhow::Result<Exit> {
        self.say(&report::Joined { own, all_of }, text)
    }

    pub(crate) fn bars(&self) -> Bars {
        Bars::new(self.no_progress, self.quiet)
    }

    /// Describes this run, for other runs that find a folder locked.
    pub(crate) fn holder(&self) -> String {
        let started = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |since| since.as_secs());
        format!(
            "process {} since second {started} of the epoch",
            std::process::id()
        )
    }
}

/// The names that an option accepts, each with its value and its help.
pub(crate) type Names<T> = &'static [(&'static str, T, &'static str)];

/// A parser that accepts these names and returns their values.
pub(crate) fn one_of<T>(names: Names<T>) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    let listed = names.iter().map(|(name, _, help)| match help.is_empty() {
        true => PossibleValue::new(*name),
        false => PossibleValue::new(*name).help(*help),
    });
    PossibleValuesParser::new(listed).map(move |given| {
        let row = names.iter().find(|(name, ..)| *name == given);
        row.expect("no other name is parsed").1
    })
}

pub(crate) const PRESETS: Names<Preset> = &[
    ("tiny", Preset::Tiny, "Small: minutes on two cores"),
    ("paper", Preset::Paper, "What the paper says"),
    ("official", Preset::Official, "The released configuration"),
];
