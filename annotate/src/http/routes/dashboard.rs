//! Figures of the project, and the log.

use std::sync::Arc;

use axum::response::Response;
use serde::Deserialize;

use crate::Error;
use crate::agreement::mean;
use crate::clock::{self, DAY};
use crate::http::app::{Context, json, page_size};
use crate::quality::Figures;
use crate::store::AuditFilter;
use crate::wire::{EditTypeCount, Funnel, QuotaRow, TaskKind};

/// Weeks the dashboard shows.
const WEEKS: i64 = 12;

/// Figures of all answers, cached for a minute.
pub(super) fn figures(cx: &Context) -> Result<Arc<Figures>, Error> {
    cx.app.figures.get(cx.store(), cx.now)
}

pub(super) fn funnel(cx: &Context) -> Result<Response, Error> {
    let kinds = TaskKind::ALL.iter();
    let mut funnel = Funnel {
        counts: kinds.map(|&kind| (kind, Default::default())).collect(),
        weeks: Vec::new(),
    };
    for (kind, state, count) in cx.store().funnel()? {
        funnel.counts.entry(kind).or_default().insert(state, count);
    }
    let zone = cx.store().settings()?.time_zone;
    let bounds = clock::weeks(&zone, cx.now, WEEKS);
    let figures = figures(cx)?;
    let weeks = cx.store().weeks(&bounds)?;
    for (mut week, span) in weeks.into_iter().zip(bounds.windows(2)) {
        let inside = |values: &[(i64, f64)]| -> Vec<f64> {
            let within = values
                .iter()
                .filter(|(at, _)| (span[0]..span[1]).contains(at));
            within.map(|(_, value)| *value).collect()
        };
        let agreed = inside(&figures.agreed_by_time);
        week.median_secs = datasets_spec::quantile::median(&mut inside(&figures.secs_by_time));
        week.agreement = mean(&agreed);
        week.shared_items = agreed.len();
        funnel.weeks.push(week);
    }
    json(&funnel)
}

pub(super) fn people(cx: &Context) -> Result<Response, Error> {
    let figures = figures(cx)?;
    let mut people = cx.store().people()?;
    for person in &mut people {
        if let Some(known) = figures.people.get(&person.user.id) {
            person.median_secs = known.median_secs;
            person.draft_unchanged = known.draft_unchanged;
            person.draft_distance = known.draft_distance;
            person.agreement = known.agreement;
        }
    }
    json(&people)
}

pub(super) fn quota(cx: &Context) -> Result<Response, Error> {
    let settings = cx.store().settings()?;
    let kept = cx.store().kept()?.into_iter();
    let rows = kept.map(|(category, edit_type, kept)| QuotaRow {
        category: category.unwrap_or_default(),
        edit_type,
        kept,
        wanted: settings.quota.into(),
        category_wanted: settings.category_quota.into(),
    });
    json(&Vec::from_iter(rows))
}

pub(super) fn edit_types(cx: &Context) -> Result<Response, Error> {
    let quotas = cx.store().settings()?.edit_type_quota;
    // The page requests this with every pair. Most projects have no such quota and skip the query.
    let kept = match quotas.is_empty() {
        true => Vec::new(),
        false => cx.store().kept()?,
    };
    let counts: Vec<EditTypeCount> = quotas
        .into_iter()
        .filter(|(_, wanted)| *wanted > 0)
        .map(|(edit_type, wanted)| EditTypeCount {
            edit_type,
            kept: kept
                .iter()
                .filter(|(_, known, _)| *known == edit_type)
                .map(|(.., count)| count)
                .sum(),
            wanted: wanted.into(),
        })
        .collect();
    json(&counts)
}

/// Default number of days of `stats/days`, including today.
const DAYS_SHOWN: i64 = 28;

/// The query of `stats/days`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Days {
    from: Option<i64>,
    to: Option<i64>,
}

pub(super) fn days(cx: &Context) -> Result<Response, Error> {
    let Days { from, to } = cx.query()?;
    let from = from.unwrap_or(cx.now - (DAYS_SHOWN - 1) * DAY);
    // Include the whole first day.
    let zone = cx.store().settings()?.time_zone;
    let from = clock::midnight(&zone, from.max(0));
    json(&cx.store().work(from, to.unwrap_or(i64::MAX))?)
}

pub(super) fn audit(cx: &Context) -> Result<Response, Error> {
    let mut filter: AuditFilter = cx.query()?;
    filter.limit = page_size(filter.limit, 200);
    json(&cx.store().audit(filter)?)
}
