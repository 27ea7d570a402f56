//! The server, and copies of the store while it runs.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use annotate::http::{PATIENCE, Server, ServerConfig, UPLOAD_PATIENCE};
use annotate::motions::MotionLibrary;
use annotate::store::{self, Store, TokenUse};
use annotate::wire::{Role, User};
use anyhow::Context;
use datasets_spec::Dataset;
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::args::Args;
use super::drafts::model;
use super::shared::{now, now_here};
use super::transfer::{IMPORTED, import_dataset};
use super::users::admin;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Name of the user that the first start creates.
const FIRST_ADMIN: &str = "admin";
const MINUTE: i64 = 60_000;
const HOUR: i64 = 60 * MINUTE;

pub(super) fn serve(args: &Args, store: Arc<Store>, global: &Global) -> anyhow::Result<Exit> {
    let model = model()?;
    let dataset = Dataset::open(&args.dataset)?;
    let is_imported = store.note(IMPORTED)?.as_deref() == Some(&dataset.manifest().root_hash);
    if !is_imported || args.condition.is_some() {
        let taken = import_dataset(args, store.as_ref(), global)?;
        for message in &taken.messages {
            report::note(message);
        }
    }
    let admin = match admin(&store)? {
        Some(admin) => admin,
        None => store.add_user(None, FIRST_ADMIN, Role::Admin, now(&store)?)?,
    };
    let mut copy_if_due = copies(args);
    copy_if_due(&store);
    let motions = Arc::new(MotionLibrary::open(&args.dataset)?);
    for warning in warnings(args) {
        report::note(&format!("warning: {warning}"));
    }
    if let Some(model) = &model {
        report::note(&format!("drafts by {}", model.name()));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        flag::register(signal, Arc::clone(&stop)).context("cannot wait for an interrupt")?;
    }
    let server = Server::start(
        Arc::clone(&store),
        motions,
        ServerConfig {
            listen: args.listen(),
            operators: args.metrics,
            secure: args.secure,
            hosts: args.host.clone(),
            trusted_proxies: args.trusted_proxy.clone(),
            data: args.folder(),
            dataset: args.dataset.clone(),
            model,
            patience: PATIENCE,
            upload_patience: UPLOAD_PATIENCE,
            clock: Arc::new(now_here),
            log: report::note,
        },
    )?;
    announce(args, &server, &store, &admin, global)?;
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(50));
        copy_if_due(&store);
    }
    drop(server);
    Ok(Exit::Done)
}

fn warnings(args: &Args) -> impl Iterator<Item = &'static str> {
    let is_reached = !args.listen().ip().is_loopback();
    let is_measured = args
        .metrics
        .is_some_and(|metrics| !metrics.ip().is_loopback());
    [
        (
            is_reached && !args.secure,
            "others can reach this address and nothing on the way is encrypted; put a proxy with TLS in front, pass \
             --secure, and listen on 127.0.0.1",
        ),
        (
            is_reached && args.secure,
            "others can reach this address without the proxy and its TLS; listen on 127.0.0.1, unless the proxy \
             runs on another machine",
        ),
        (
            args.secure && args.host.is_empty(),
            "requests that a proxy passes on by its name are refused; say the name with --host",
        ),
        (
            args.secure && args.trusted_proxy.is_empty(),
            "all browsers share the limits of one address; name the proxy with --trusted-proxy, such as 127.0.0.1",
        ),
        (
            is_measured,
            "others can read the figures at the address of --metrics without a login",
        ),
    ]
    .into_iter()
    .filter_map(|(holds, warning)| holds.then_some(warning))
}

/// Prints the address to open, with a token that logs the admin in once.
fn announce(
    args: &Args,
    server: &Server,
    store: &Arc<Store>,
    admin: &User,
    global: &Global,
) -> anyhow::Result<()> {
    let now = now(store)?;
    let token = store
        .issue(admin.id, TokenUse::Once, now + 60 * MINUTE, now)?
        .token;
    let url = format!("http://{}/", server.address());
    let metrics = server
        .operators()
        .map(|address| format!("http://{address}/metrics"));
    if global.json {
        let mut document = json!({ "url": url, "token": token });
        if let Some(metrics) = metrics {
            document["metrics"] = json!(metrics);
        }
        report::text(&document.to_string());
    } else {
        if let Some(metrics) = metrics {
            report::note(&format!("figures for Prometheus: {metrics}"));
        }
        // With --secure, the server refuses logins from pages that were loaded without TLS.
        let opened = match (args.secure, args.host.first()) {
            (false, _) => url,
            (true, Some(host)) => format!("https://{host}/"),
            (true, None) => format!("https://{}/", server.address()),
        };
        report::text(&format!("{opened}#token={token}"));
        report::note(&format!(
            "open this address within an hour; it logs {} in once. Ctrl-C ends the server",
            admin.name
        ));
    }
    std::io::stdout().flush().context("cannot write to stdout")
}

/// Returns a function that copies the store if a copy is due; call it often. It only reports a failed copy.
fn copies(args: &Args) -> impl FnMut(&Store) {
    let folder = args.folder().join("backups");
    let every = args.backup_hours.map(|hours| i64::from(hours) * HOUR);
    let keep = args.backups();
    // Time of the next check whether a copy is due.
    let mut next = 0;
    move |store| {
        let now = now_here();
        let Some(every) = every.filter(|_| next <= now) else {
            return;
        };
        next = now + MINUTE;
        let copied = store::backup_is_due(&folder, every, now).and_then(|due| {
            if due {
                store::back_up(store, &folder, keep, now)?;
            }
            Ok(())
        });
        if let Err(error) = copied {
            report::note(&format!(
                "the store was not copied: {error:#}; the next try is in an hour"
            ));
            next = now + HOUR;
        }
    }
}
