//! Figures of the project, and the log.

use std::sync::Arc;

use crate::Error;
use crate::clock;
use crate::http::app::{App, Context, Reply, json};
use crate::quality::Figures;
use crate::state::LogKind;
use crate::store::AuditFilter;
use crate::wire::{EditType, EditTypeCount, Funnel, Person, QuotaRow, TaskKind, Week};

/// Weeks the dashboard shows.
const WEEKS: i64 = 12;
const DAY: i64 = 24 * 60 * 60 * 1000;

/// Figures of all answers; those of the last minute are not computed again.
pub(super) fn figures(app: &App, now: i64) -> Result<Arc<Figures>, Error> {
    app.figures.get(app.store.as_ref(), now)
}

pub(super) fn funnel(cx: &Context) -> Result<Reply, Error> {
    let mut funnel = Funnel {
        counts: TaskKind::ALL
            .iter()
            .map(|&kind| (kind, Default::default()))
            .collect(),
        weeks: Vec::new(),
    };
    for (kind, state, count) in cx.app.store.funnel()? {
        funnel.counts.entry(kind).or_default().insert(state, count);
    }
    let zone = cx.app.store.settings()?.time_zone;
    let bounds = clock::weeks(&zone, cx.now, WEEKS);
    let counts = cx.app.store.weeks(bounds.clone())?;
    let figures = figures(&cx.app, cx.now)?;
    for (index, counts) in counts.into_iter().enumerate() {
        let inside = |values: &[(i64, f64)]| -> Vec<f64> {
            let within = values
                .iter()
                .filter(|(at, _)| (bounds[index]..bounds[index + 1]).contains(at));
            within.map(|(_, value)| *value).collect()
        };
        let mut secs = inside(&figures.secs_by_time);
        let agreed = inside(&figures.agreed_by_time);
        funnel.weeks.push(Week {
            start: bounds[index],
            submitted: counts.submitted,
            accepted: counts.accepted,
            returned: counts.returned,
            median_secs: datasets_spec::quantile::median(&mut secs),
            agreement: (!agreed.is_empty())
                .then(|| agreed.iter().sum::<f64>() / agreed.len() as f64),
            shared_items: agreed.len(),
        });
    }
    json(&funnel)
}

pub(super) fn people(cx: &Context) -> Result<Reply, Error> {
    let figures = figures(&cx.app, cx.now)?;
    let people: Vec<Person> = cx
        .app
        .store
        .people()?
        .into_iter()
        .map(|counts| {
            let known = figures
                .people
                .get(&counts.user.id)
                .cloned()
                .unwrap_or_default();
            let gold = counts.gold.len();
            Person {
                done: counts.done,
                median_secs: known.median_secs,
                accepted: counts.accepted,
                returned: counts.returned,
                draft_unchanged: known.draft_unchanged,
                draft_distance: known.draft_distance,
                gold_items: gold as i64,
                gold_score: (gold > 0).then(|| counts.gold.iter().sum::<f64>() / gold as f64),
                agreement: known.agreement,
                last_seen: counts.last_seen,
                user: counts.user,
            }
        })
        .collect();
    json(&people)
}

pub(super) fn agreement(cx: &Context) -> Result<Reply, Error> {
    json(&figures(&cx.app, cx.now)?.agreement)
}

pub(super) fn quota(cx: &Context) -> Result<Reply, Error> {
    let settings = cx.app.store.settings()?;
    let wanted = i64::from(settings.quota);
    let category_wanted = i64::from(settings.category_quota);
    let rows: Vec<QuotaRow> = cx
        .app
        .store
        .kept()?
        .into_iter()
        .filter_map(|(category, edit_type, kept)| {
            Some(QuotaRow {
                category: category.unwrap_or_default(),
                edit_type: EditType::parse(&edit_type)?,
                kept,
                wanted,
                category_wanted,
            })
        })
        .collect();
    json(&rows)
}

pub(super) fn edit_types(cx: &Context) -> Result<Reply, Error> {
    let quotas = cx.app.store.settings()?.edit_type_quota;
    // Annotators ask with every pair; most projects have no such quota.
    let kept = match quotas.is_empty() {
        true => Vec::new(),
        false => cx.app.store.kept()?,
    };
    let counts: Vec<EditTypeCount> = quotas
        .into_iter()
        .filter(|(_, wanted)| *wanted > 0)
        .map(|(edit_type, wanted)| EditTypeCount {
            edit_type,
            kept: kept
                .iter()
                .filter(|(_, name, _)| name == edit_type.as_str())
                .map(|(.., count)| count)
                .sum(),
            wanted: wanted.into(),
        })
        .collect();
    json(&counts)
}

pub(super) fn captures(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.captures()?)
}

/// Days that `stats/days` shows if the query names none, today among them.
const DAYS_SHOWN: i64 = 28;

pub(super) fn days(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["from", "to"])?;
    let to = cx.number("to")?.unwrap_or(i64::MAX);
    let from = cx
        .number("from")?
        .unwrap_or(cx.now - (DAYS_SHOWN - 1) * DAY);
    // The first day is shown whole.
    let zone = cx.app.store.settings()?.time_zone;
    let from = clock::midnight(&zone, from.max(0));
    json(&cx.app.store.work(from, to)?)
}

pub(super) fn outlook(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.outlook(cx.now)?)
}

pub(super) fn audit(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["actor", "kind", "task", "before", "limit"])?;
    let filter = AuditFilter {
        actor: cx.number("actor")?,
        kind: cx.one_of("kind", LogKind::parse)?,
        task: cx.number("task")?,
        before: cx.number("before")?,
        limit: cx.limit(200)?,
    };
    json(&cx.app.store.audit(filter)?)
}
