//! `stance annotate`

mod args;
mod captures;
mod drafts;
mod serve;
mod shared;
mod sheet;
mod store;
mod styles;
mod tasks;
mod transfer;
mod users;

use annotate::wire::{ExportFormat, ExportRequest, TaskKind};
use anyhow::Context;
use datasets_spec::Dataset;

use self::args::Action;
pub(crate) use self::args::Args;
use self::drafts::ask_drafts;
use self::store::{back_up, check, open, pack, rebuild, unpack};
use self::tasks::{changed_clips, rules, run_bulk};
use self::transfer::{export, import};
use self::users::{find, token, user};
use crate::exit::Exit;
use crate::global::Global;

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.check()?;
    // Open the dataset first, so that no store is created for a folder that is not a dataset.
    Dataset::open_unverified(&args.dataset)?;
    if let Some(Action::Unpack { file }) = &args.action {
        return unpack(args, file, global);
    }
    let opened = open(args)?;
    let Some(action) = &args.action else {
        return serve::serve(args, opened, global);
    };
    let store = opened.as_ref();
    match action {
        Action::User { action } => user(store, action, global),
        Action::Token { name, days } => {
            let user = find(store, name)?;
            token(store, &user, i64::from(*days), global)
        }
        Action::Import { file } => import(args, store, file.as_deref(), global),
        Action::Export {
            format,
            to,
            split,
            events,
        } => {
            let selection = ExportRequest {
                format: ExportFormat::parse(format).context("the format is not known")?,
                splits: split.iter().map(ToString::to_string).collect(),
                events: *events,
            };
            export(args, store, &selection, to.as_deref(), global)
        }
        Action::Rules { action } => rules(store, action.as_ref(), global),
        Action::Styles { file } => styles::styles(store, file.as_deref(), global),
        Action::Captures {
            file,
            missing,
            sheet,
        } => captures::captures(store, file.as_deref(), *missing, sheet.as_deref(), global),
        Action::Bulk(bulk) => run_bulk(store, bulk, global),
        Action::Drafts { kind, limit } => {
            let kind = kind.as_deref().and_then(TaskKind::parse);
            ask_drafts(args, store, kind, *limit, global)
        }
        Action::Changed { keep, reopen } => changed_clips(store, *keep, *reopen, global),
        Action::Backup { file, keep } => back_up(store, file, *keep, global),
        Action::Pack { file } => pack(store, file, global),
        Action::Unpack { file } => unpack(args, file, global),
        Action::Rebuild => rebuild(store, global),
        Action::Check => check(store, global),
    }
}
