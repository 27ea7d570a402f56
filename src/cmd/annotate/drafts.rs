//! Drafts by a language model.

use annotate::drafting::draft_all;
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::store::Store;
use annotate::wire::TaskKind;
use anyhow::{Context, bail};
use datasets_spec::Progress as _;

use super::args::Args;
use super::shared::now;
use crate::exit::Exit;
use crate::global::Global;

/// Environment variable with the address of a language model's API, including its version, such as
/// http://localhost:8000/v1.
const MODEL_URL: &str = "STANCE_MODEL_URL";
const MODEL_NAME: &str = "STANCE_MODEL_NAME";
const MODEL_KEY: &str = "STANCE_MODEL_KEY";

/// The language model, if its variables are set.
pub(super) fn model() -> anyhow::Result<Option<Model>> {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    match (set(MODEL_URL), set(MODEL_NAME)) {
        (None, None) => Ok(None),
        (Some(url), Some(name)) => Ok(Some(Model::new(&url, &name, set(MODEL_KEY))?)),
        _ => bail!("set both {MODEL_URL} and {MODEL_NAME}, or neither"),
    }
}

pub(super) fn ask_drafts(
    args: &Args,
    store: &Store,
    kind: Option<TaskKind>,
    limit: usize,
    global: &Global,
) -> anyhow::Result<Exit> {
    let model = model()?.with_context(|| {
        format!("there is no language model; set {MODEL_URL} and {MODEL_NAME} to that of an OpenAI-compatible endpoint")
    })?;
    let motions = MotionLibrary::open(&args.dataset)?;
    let bars = global.bars();
    bars.begin("drafts", None);
    let done = draft_all(
        store,
        &motions,
        &model,
        kind,
        limit,
        now(store)?,
        &mut |tasks| {
            bars.advance_to(tasks as u64);
        },
    )?;
    bars.finish(&format!("{} tasks", done.looked_at));
    let mut lines = vec![format!(
        "{} new texts for {} tasks",
        done.texts, done.looked_at
    )];
    let clips = done.without_parts - done.pairs_without_parts;
    if clips > 0 {
        lines.push(format!(
            "  {clips} clips have no part to describe; `stance masks` suggests some"
        ));
    }
    if done.pairs_without_parts > 0 {
        lines.push(format!(
            "  {} pairs have no part to describe yet; who names one can ask for a draft on the screen of the pair",
            done.pairs_without_parts
        ));
    }
    if let Some(failure) = &done.last_failure {
        lines.push(format!(
            "  {} requests failed, the last one because {failure}; run the command again",
            done.failures
        ));
    }
    global.say(&done, &lines.join("\n"))?;
    Ok(Exit::done_if(done.failures == 0))
}
