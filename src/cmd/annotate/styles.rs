//! The styles of a project, as a file of names, texts, guidelines and colours.

use std::path::Path;

use annotate::store::Store;
use annotate::wire::{SettingsChange, Style};
use serde::{Deserialize, Serialize};

use super::shared::now;
use super::users::operator;
use crate::exit::Exit;
use crate::global::Global;
use crate::settings;

/// A file of styles: one table `[[style]]` for each.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StyleFile {
    style: Vec<Style>,
}

/// Adds or replaces the styles of a file in the project; without a file, prints the project's styles.
pub(super) fn styles(store: &Store, file: Option<&Path>, global: &Global) -> anyhow::Result<Exit> {
    let mut project = store.settings()?;
    let Some(file) = file else {
        let list = StyleFile {
            style: project.styles,
        };
        return global.say(&list.style, toml::to_string(&list)?.trim_end());
    };
    let was = project.clone();
    let told: StyleFile = settings::read(file)?;
    let (mut new, mut changed) = (0, 0);
    for style in told.style {
        match project
            .styles
            .iter_mut()
            .find(|known| known.name == style.name)
        {
            Some(known) => {
                changed += usize::from(*known != style);
                *known = style;
            }
            None => {
                new += 1;
                project.styles.push(style);
            }
        }
    }
    let all = project.styles.len();
    if new + changed > 0 {
        let change = SettingsChange { was, now: project };
        store.change_settings(operator(store)?.id, change, now(store)?)?;
    }
    global.say(
        &serde_json::json!({ "styles": all, "new": new, "changed": changed }),
        &format!("{all} styles: {new} new, {changed} changed"),
    )
}
