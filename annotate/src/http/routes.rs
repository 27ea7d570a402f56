//! The routes and what they do.

use std::sync::Arc;

use axum::body::Body;
use axum::http::header;
use axum::response::Response;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{
    Access, App, Context, Handler, Reply, Route, SESSION_DAYS, assets, cookie, locked, set,
};
use crate::Error;
use crate::answer::{self, mask_of};
use crate::jobs;
use crate::model::MAX_REQUESTS_PER_MINUTE;
use crate::motions::{row_bytes, skeleton_info};
use crate::quality::Figures;
use crate::state::LogKind;
use crate::store::{
    AcceptedAnswer, AuditFilter, Claimed, IssuedToken, MotionRecord, ReviewClaimed, ShelfFilter,
    TaskDetail, TaskRecord, TokenUse, Who,
};
use crate::wire::{
    BlendRequest, Bundle, BundleItem, Candidate, Code, Decision, EditType, EventBatch,
    EventResults, ExportRequest, Funnel, Guide, ImportFormat, Limits, Login, MAX_BODY_BYTES,
    MAX_EVENTS, MAX_IMPORT_BYTES, MAX_TEXT_CHARS, Me, MotionInfo, NewReview, NewToken, NewUser,
    Next, NextRequest, Person, Prefs, Project, QuotaRow, ReviewNext, ReviewRequest, ReviewView,
    Role, Settings, Shelf, ShelfItem, SuggestRequest, Task, TaskKind, TaskView, TokenShown,
    UserChange, Week,
};

/// Most logins a minute from one address.
const LOGINS_PER_MINUTE: u32 = 10;
/// Seconds between renewals of a lease.
const HEARTBEAT_SECS: i64 = 60;
/// Tasks whose motions are fetched ahead.
const AHEAD: usize = 3;
/// Days a token of a new user is good for.
const TOKEN_DAYS: u32 = 90;
/// Weeks the dashboard shows.
const WEEKS: i64 = 12;
/// How old figures of agreement may be.
const FIGURES_AGE: i64 = 60_000;
const DAY: i64 = 24 * 60 * 60 * 1000;

const PUBLIC: Access = Access::Public;
const ANNOTATOR: Access = Access::Role(Role::Annotator);
const REVIEWER: Access = Access::Role(Role::Reviewer);
const ADMIN: Access = Access::Role(Role::Admin);

const fn row(
    method: &'static str,
    path: &'static str,
    access: Access,
    work: fn(&Context) -> Result<Reply, Error>,
) -> Route {
    Route {
        method,
        path,
        access,
        max_body: MAX_BODY_BYTES,
        handler: Handler::Work(work),
    }
}

/// All routes. What is not here does not exist.
pub static ROUTES: &[Route] = &[
    row("POST", "/api/v1/session", PUBLIC, log_in),
    row("DELETE", "/api/v1/session", ANNOTATOR, log_out),
    row("GET", "/api/v1/me", ANNOTATOR, me),
    row("GET", "/api/v1/prefs", ANNOTATOR, prefs),
    row("PUT", "/api/v1/prefs", ANNOTATOR, put_prefs),
    row("GET", "/api/v1/guide", ANNOTATOR, guide),
    row("GET", "/api/v1/skeleton", ANNOTATOR, skeleton),
    row("GET", "/api/v1/home", ANNOTATOR, home),
    row("GET", "/api/v1/shelf", ANNOTATOR, shelf),
    row("POST", "/api/v1/queue/next", ANNOTATOR, next),
    row("GET", "/api/v1/leases", REVIEWER, leases),
    row("POST", "/api/v1/leases/{id}/renew", ANNOTATOR, renew),
    row("DELETE", "/api/v1/leases/{id}", ANNOTATOR, release),
    row("GET", "/api/v1/tasks/{id}", ANNOTATOR, task),
    row("POST", "/api/v1/tasks/{id}/claim", ANNOTATOR, claim),
    row("POST", "/api/v1/tasks/{id}/events", ANNOTATOR, events),
    row("POST", "/api/v1/tasks/{id}/suggest", ANNOTATOR, suggest),
    row("POST", "/api/v1/tasks/{id}/gold", ADMIN, make_gold),
    row("GET", "/api/v1/tasks/{id}/history", REVIEWER, history),
    row("GET", "/api/v1/motions/partners", ANNOTATOR, partners),
    row("GET", "/api/v1/motions/{hash}/joints", ANNOTATOR, joints),
    row("GET", "/api/v1/motions/{hash}/heat", ANNOTATOR, heat),
    row("GET", "/api/v1/pairs/{id}/diff", ANNOTATOR, difference),
    row("POST", "/api/v1/blend", ANNOTATOR, blend),
    row("POST", "/api/v1/review/next", REVIEWER, review_next),
    row("POST", "/api/v1/reviews", REVIEWER, review),
    row("GET", "/api/v1/stats/funnel", REVIEWER, funnel),
    row("GET", "/api/v1/stats/people", REVIEWER, people),
    row("GET", "/api/v1/stats/agreement", REVIEWER, agreement),
    row("GET", "/api/v1/stats/quota", REVIEWER, quota),
    Route {
        method: "GET",
        path: "/api/v1/stream",
        access: ANNOTATOR,
        max_body: 0,
        handler: Handler::Stream,
    },
    row("GET", "/api/v1/settings", ADMIN, settings),
    row("PUT", "/api/v1/settings", ADMIN, put_settings),
    row("GET", "/api/v1/users", ADMIN, users),
    row("POST", "/api/v1/users", ADMIN, add_user),
    row("PATCH", "/api/v1/users/{id}", ADMIN, change_user),
    row("GET", "/api/v1/users/{id}/tokens", ADMIN, tokens),
    row("POST", "/api/v1/users/{id}/tokens", ADMIN, add_token),
    row("DELETE", "/api/v1/tokens/{id}", ADMIN, revoke),
    Route {
        method: "POST",
        path: "/api/v1/imports",
        access: ADMIN,
        max_body: MAX_IMPORT_BYTES,
        handler: Handler::Work(import),
    },
    row("POST", "/api/v1/exports", ADMIN, export),
    row("GET", "/api/v1/jobs", ADMIN, all_jobs),
    row("GET", "/api/v1/jobs/{id}", ADMIN, one_job),
    row("GET", "/api/v1/jobs/{id}/files/{name}", ADMIN, job_file),
    row("GET", "/api/v1/audit", ADMIN, audit),
    row("GET", "/healthz", PUBLIC, healthy),
    row("GET", "/readyz", PUBLIC, ready),
    row("GET", "/metrics", Access::Local, metrics),
    row("GET", "/", PUBLIC, asset),
    row("GET", "/app", PUBLIC, asset),
    row("GET", "/app/{*rest}", PUBLIC, asset),
    row("GET", "/assets/{*name}", PUBLIC, asset),
];

fn json<T: Serialize>(value: &T) -> Result<Reply, Error> {
    serde_json::to_vec(value)
        .map(Reply::Json)
        .map_err(|error| Error::Row {
            table: "of an answer",
            problem: error.to_string(),
        })
}

impl Context {
    fn who(&self) -> Result<&Who, Error> {
        self.who
            .as_ref()
            .ok_or_else(|| Error::refused(Code::Unauthenticated, "log in first"))
    }

    fn id(&self) -> Result<i64, Error> {
        let text = self.params.get("id").map_or("", String::as_str);
        text.parse()
            .map_err(|_| Error::not_found("thing of this number"))
    }

    fn param(&self, name: &str) -> &str {
        self.params.get(name).map_or("", String::as_str)
    }

    fn body<T: DeserializeOwned>(&self) -> Result<T, Error> {
        serde_json::from_slice(&self.body).map_err(|error| {
            Error::refused(
                Code::BadRequest,
                format!("the body is not what this route takes: {error}"),
            )
        })
    }

    /// The parameters of the address, none but those known.
    fn only(&self, known: &[&str]) -> Result<(), Error> {
        match self
            .query
            .keys()
            .find(|name| !known.contains(&name.as_str()))
        {
            None => Ok(()),
            Some(name) => Err(Error::refused(
                Code::BadRequest,
                format!(
                    "{name:?} is no parameter here; known are {}",
                    known.join(", ")
                ),
            )),
        }
    }

    fn number(&self, name: &str) -> Result<Option<i64>, Error> {
        match self.query.get(name) {
            None => Ok(None),
            Some(text) => text.parse().map(Some).map_err(|_| {
                Error::refused(
                    Code::BadRequest,
                    format!("{name} is {text:?}, not a whole number"),
                )
            }),
        }
    }

    fn one_of<T: Copy>(
        &self,
        name: &str,
        parse: fn(&str) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        match self.query.get(name).map(String::as_str) {
            None | Some("") => Ok(None),
            Some(text) => parse(text).map(Some).ok_or_else(|| {
                Error::refused(Code::BadRequest, format!("{name} {text:?} is not known"))
            }),
        }
    }

    fn limit(&self, most: i64) -> Result<usize, Error> {
        let limit = self.number("limit")?.unwrap_or(most).clamp(1, most);
        Ok(usize::try_from(limit).unwrap_or(1))
    }
}

// ---- people

fn log_in(cx: &Context) -> Result<Reply, Error> {
    cx.app
        .limiter
        .count("logins", &cx.peer.to_string(), LOGINS_PER_MINUTE, cx.now)?;
    let login: Login = cx.body()?;
    let who =
        cx.app
            .store
            .authenticate(&login.token, &[TokenUse::Token, TokenUse::Once], cx.now)?;
    let session = cx.app.store.issue(
        who.id,
        TokenUse::Session,
        cx.now + SESSION_DAYS * DAY,
        cx.now,
    )?;
    let mut reply = full_json(&me_of(&cx.app, &who)?)?;
    let age = SESSION_DAYS * DAY / 1000;
    set_cookie(cx, &mut reply, &session.token, age);
    Ok(Reply::Full(reply))
}

fn set_cookie(cx: &Context, response: &mut Response, value: &str, age: i64) {
    let name = cx.app.cookie_name();
    let secure = if cx.app.config.secure { "; Secure" } else { "" };
    let cookie =
        format!("{name}={value}; HttpOnly; SameSite=Strict; Path=/; Max-Age={age}{secure}");
    set(response, header::SET_COOKIE, &cookie);
}

fn full_json<T: Serialize>(value: &T) -> Result<Response, Error> {
    Ok(super::reply_response(json(value)?))
}

fn log_out(cx: &Context) -> Result<Reply, Error> {
    if let Some(token) = cookie(&cx.headers, cx.app.cookie_name()) {
        cx.app.store.log_out(&token)?;
    }
    let mut response = super::reply_response(Reply::Empty);
    set_cookie(cx, &mut response, "", 0);
    Ok(Reply::Full(response))
}

fn me(cx: &Context) -> Result<Reply, Error> {
    json(&me_of(&cx.app, cx.who()?)?)
}

fn me_of(app: &App, who: &Who) -> Result<Me, Error> {
    let settings = app.store.settings()?;
    let read_only = locked(&app.read_only).clone();
    if read_only.is_some() && app.store.check().is_ok() {
        *locked(&app.read_only) = None;
    }
    Ok(Me {
        user: crate::wire::User {
            id: who.id,
            name: who.name.clone(),
            role: who.role,
            active: true,
        },
        limits: Limits {
            text_chars: MAX_TEXT_CHARS,
            events: MAX_EVENTS,
            body_bytes: MAX_BODY_BYTES,
            suggestions_per_minute: MAX_REQUESTS_PER_MINUTE,
            lease_secs: i64::from(settings.lease_minutes) * 60,
            heartbeat_secs: HEARTBEAT_SECS,
        },
        project: Project {
            name: settings.name,
            min_masks: settings.min_masks,
            max_masks: settings.max_masks,
            styles: settings.styles,
            templates: settings.templates,
        },
        prefs: app.store.prefs(who.id)?,
        model: app
            .config
            .model
            .as_ref()
            .map(|model| model.name().to_owned()),
        read_only: locked(&app.read_only).clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    })
}

fn prefs(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.prefs(cx.who()?.id)?)
}

fn put_prefs(cx: &Context) -> Result<Reply, Error> {
    let prefs: Prefs = cx.body()?;
    cx.app.store.put_prefs(cx.who()?.id, prefs.clone())?;
    json(&prefs)
}

fn guide(cx: &Context) -> Result<Reply, Error> {
    json(&Guide {
        text: cx.app.store.settings()?.guide,
    })
}

fn skeleton(_: &Context) -> Result<Reply, Error> {
    json(&skeleton_info())
}

fn home(cx: &Context) -> Result<Reply, Error> {
    let who = cx.who()?;
    let mut home = cx.app.store.home(who.id, cx.now)?;
    home.agreement = figures(&cx.app, cx.now)?
        .people
        .get(&who.id)
        .and_then(|person| person.agreement);
    json(&home)
}

// ---- tasks

fn motion_info(motion: MotionRecord) -> MotionInfo {
    MotionInfo {
        hash: motion.hash,
        id: motion.id,
        frames: usize::try_from(motion.frames).unwrap_or(0),
        fps: motion.fps,
        split: motion.split,
        captions: motion.captions,
        style: motion.style,
    }
}

fn task_of(app: &App, record: TaskRecord, bundle: Option<Bundle>) -> Result<Task, Error> {
    let hashes = std::iter::once(record.source)
        .chain(record.target)
        .collect();
    let motions = app.store.motions(hashes)?;
    Ok(Task {
        id: record.id,
        kind: record.kind,
        state: record.state,
        motions: motions.into_iter().map(motion_info).collect(),
        category: record.category,
        hint: record.hint,
        style: record.style,
        // A gold task looks like any other.
        wanted: if record.gold.is_some() {
            1
        } else {
            record.wanted
        },
        submitted: if record.gold.is_some() {
            0
        } else {
            record.submitted
        },
        bundle,
    })
}

fn view(app: &App, detail: TaskDetail) -> Result<TaskView, Error> {
    let bundle = detail.task.bundle.map(|id| Bundle {
        id,
        tasks: detail
            .bundle
            .into_iter()
            .map(|item| BundleItem {
                task: item.task,
                mine: item.mine,
                verdict: item.verdict,
                leased: item.leased,
            })
            .collect(),
    });
    let blind = detail.blind;
    let mut suggestions = detail.suggestions;
    if detail.task.kind == TaskKind::MaskText && !blind {
        // What moves is a suggestion too, made when it is asked for.
        let parts = app.motions.active_parts(&detail.task.source)?;
        if !parts.is_empty() {
            suggestions.push(crate::wire::Suggestion {
                id: 0,
                source: crate::wire::SuggestionSource::Heat,
                parts: parts.iter().map(|part| part.name().to_owned()).collect(),
                text: String::new(),
                model: "activity".to_owned(),
            });
        }
    }
    Ok(TaskView {
        task: task_of(app, detail.task, bundle)?,
        lease: detail.lease,
        mine: detail.mine,
        comment: detail.comment,
        suggestions,
        blind,
    })
}

fn next(cx: &Context) -> Result<Reply, Error> {
    let request: NextRequest = cx.body()?;
    let who = cx.who()?;
    let (task, empty, prefetch) = match cx.app.store.claim(who.id, request.kind, AHEAD, cx.now)? {
        Claimed::Task { detail, upcoming } => (Some(view(&cx.app, *detail)?), None, upcoming),
        Claimed::Nothing(empty) => (None, Some(empty), Vec::new()),
    };
    json(&Next {
        task,
        empty,
        prefetch,
    })
}

fn leases(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.leases(cx.now)?)
}

fn renew(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.renew(cx.who()?.id, cx.id()?, cx.now)?)
}

fn release(cx: &Context) -> Result<Reply, Error> {
    cx.app.store.release(cx.who()?, cx.id()?, cx.now)?;
    Ok(Reply::Empty)
}

fn task(cx: &Context) -> Result<Reply, Error> {
    let detail = cx.app.store.task(cx.who()?, cx.id()?)?;
    json(&view(&cx.app, detail)?)
}

fn claim(cx: &Context) -> Result<Reply, Error> {
    let (who, id) = (cx.who()?, cx.id()?);
    json(&view(
        &cx.app,
        cx.app.store.claim_task(who.id, id, cx.now)?,
    )?)
}

fn events(cx: &Context) -> Result<Reply, Error> {
    let batch: EventBatch = cx.body()?;
    if batch.events.is_empty() || batch.events.len() > MAX_EVENTS {
        return Err(Error::invalid(
            "events",
            format!(
                "{} events are sent; 1 to {MAX_EVENTS} fit",
                batch.events.len()
            ),
        ));
    }
    let results = cx
        .app
        .store
        .append(cx.who()?.id, cx.id()?, batch.events, cx.now)?;
    json(&EventResults { results })
}

fn suggest(cx: &Context) -> Result<Reply, Error> {
    let request: SuggestRequest = cx.body()?;
    let who = cx.who()?;
    let Some(model) = &cx.app.config.model else {
        return Err(Error::refused(
            Code::NoModel,
            "no language model is configured; write the text yourself",
        ));
    };
    let detail = cx.app.store.task(who, cx.id()?)?;
    if detail.lease.is_none() {
        return Err(Error::refused(
            Code::LeaseLost,
            "you hold no lease on this task",
        ));
    }
    if detail.blind {
        return Err(Error::wrong_state(
            detail.task.state,
            "given a draft: it is shown without any",
        ));
    }
    let parts = answer::known_parts(&request.parts);
    if parts.is_empty() || parts.len() != request.parts.len() {
        return Err(Error::invalid(
            "parts",
            "name the parts the text is to speak of",
        ));
    }
    cx.app.limiter.count(
        "suggestions",
        &who.id.to_string(),
        MAX_REQUESTS_PER_MINUTE,
        cx.now,
    )?;
    let hashes = std::iter::once(detail.task.source.clone()).chain(detail.task.target.clone());
    let motions = cx.app.store.motions(hashes.collect())?;
    let captions: Vec<&str> = motions
        .iter()
        .flat_map(|motion| motion.captions.iter().map(String::as_str))
        .collect();
    let suggestion = model.suggest(cx.app.store.as_ref(), &detail.task, &captions, &parts)?;
    json(
        &cx.app
            .store
            .put_suggestion(detail.task.id, suggestion, cx.now)?,
    )
}

fn make_gold(cx: &Context) -> Result<Reply, Error> {
    let gold = cx.app.store.make_gold(cx.who()?.id, cx.id()?, cx.now)?;
    let record = cx.app.store.task_record(gold)?;
    json(&task_of(&cx.app, record, None)?)
}

fn history(cx: &Context) -> Result<Reply, Error> {
    let filter = AuditFilter {
        task: Some(cx.id()?),
        limit: 1000,
        ..AuditFilter::default()
    };
    let mut audit = cx.app.store.audit(filter)?;
    audit.entries.reverse();
    json(&audit.entries)
}

fn shelf(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["kind", "part", "q", "before", "limit"])?;
    let limit = cx.limit(50)?;
    let filter = ShelfFilter {
        kind: cx.one_of("kind", TaskKind::parse)?,
        part: cx
            .one_of("part", |text| text.parse::<datasets_spec::BodyPart>().ok())?
            .map(|part| part.name().to_owned()),
        text: cx
            .query
            .get("q")
            .filter(|text| !text.trim().is_empty())
            .cloned(),
        before: cx.number("before")?,
        limit,
    };
    let found: Vec<AcceptedAnswer> = cx.app.store.shelf(cx.who()?.id, filter)?;
    let next = (found.len() == limit)
        .then(|| found.last().map(|answer| answer.seq))
        .flatten();
    let items = found
        .into_iter()
        .map(|found| {
            Ok(ShelfItem {
                task: task_of(&cx.app, found.task, None)?,
                answer: found.answer,
                at: found.at,
            })
        })
        .collect::<Result<_, Error>>()?;
    json(&Shelf { items, next })
}

// ---- motions

fn binary(bytes: Vec<u8>, lasting: bool) -> Reply {
    let mut response = Response::new(Body::from(bytes));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "application/octet-stream",
    );
    let cache = if lasting {
        "private, max-age=31536000, immutable"
    } else {
        "no-store"
    };
    set(&mut response, header::CACHE_CONTROL, cache);
    Reply::Full(response)
}

fn joints(cx: &Context) -> Result<Reply, Error> {
    Ok(binary(cx.app.motions.joints(cx.param("hash"))?, true))
}

fn heat(cx: &Context) -> Result<Reply, Error> {
    Ok(binary(
        row_bytes(&cx.app.motions.heat(cx.param("hash"))?),
        true,
    ))
}

fn partners(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["of", "n"])?;
    let n = usize::try_from(cx.number("n")?.unwrap_or(8).clamp(1, 50)).unwrap_or(8);
    let hash = cx.query.get("of").map_or("", String::as_str);
    let found: Vec<MotionInfo> = cx
        .app
        .store
        .partners(hash, n)?
        .into_iter()
        .map(motion_info)
        .collect();
    json(&found)
}

fn difference(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["align"])?;
    let stretch = match cx.query.get("align").map(String::as_str) {
        None | Some("none") => false,
        Some("stretch") => true,
        Some(other) => {
            return Err(Error::refused(
                Code::BadRequest,
                format!("align {other:?} is not known; none and stretch are"),
            ));
        }
    };
    let detail = cx.app.store.task(cx.who()?, cx.id()?)?;
    let target = detail
        .task
        .target
        .ok_or_else(|| Error::invalid("id", "this task has one motion, not two"))?;
    let rows = cx
        .app
        .motions
        .difference(&detail.task.source, &target, stretch)?;
    Ok(binary(row_bytes(&rows), false))
}

fn blend(cx: &Context) -> Result<Reply, Error> {
    let request: BlendRequest = cx.body()?;
    if !(0.0..=1.0).contains(&request.alpha) {
        return Err(Error::invalid(
            "alpha",
            "the weight of the soft ring is 0 to 1",
        ));
    }
    if answer::known_parts(&request.parts).len() != request.parts.len() || request.parts.is_empty()
    {
        return Err(Error::invalid(
            "parts",
            "name the parts to be taken from the other motion",
        ));
    }
    let mask = mask_of(&request.parts, request.soft);
    let bytes = cx
        .app
        .motions
        .blend(&request.src, &request.tgt, mask, request.alpha)?;
    Ok(binary(bytes, false))
}

// ---- review

fn review_next(cx: &Context) -> Result<Reply, Error> {
    let request: ReviewRequest = cx.body()?;
    let who = cx.who()?;
    let claimed = cx
        .app
        .store
        .review_next(who.id, request.queue, request.kind, cx.now)?;
    let detail = match claimed {
        ReviewClaimed::Nothing(empty) => {
            return json(&ReviewNext {
                review: None,
                empty: Some(empty),
            });
        }
        ReviewClaimed::Task(detail) => *detail,
    };
    let answers: Vec<_> = detail
        .candidates
        .iter()
        .map(|(revision, _)| revision.answer.clone())
        .collect();
    let mut candidates = Vec::new();
    for (revision, author_name) in detail.candidates {
        let mask = revision.answer.joints();
        candidates.push(Candidate {
            draft_distance: crate::quality::draft_distance(
                cx.app.store.as_ref(),
                &revision.answer,
            )?,
            joints: mask.iter().map(datasets_spec::Joint::index).collect(),
            author_name,
            revision,
        });
    }
    json(&ReviewNext {
        review: Some(ReviewView {
            task: task_of(&cx.app, detail.task, None)?,
            lease: detail.lease,
            candidates,
            distance: answer::spread(&answers),
            comments: detail.comments,
        }),
        empty: None,
    })
}

fn review(cx: &Context) -> Result<Reply, Error> {
    let new: NewReview = cx.body()?;
    if new.decision != Decision::Merge && new.answer.is_some() {
        return Err(Error::invalid("answer", "only a merge brings an answer"));
    }
    json(&cx.app.store.review(cx.who()?.id, new, cx.now)?)
}

// ---- figures

fn figures(app: &App, now: i64) -> Result<Arc<Figures>, Error> {
    let known = locked(&app.figures).clone();
    if let Some((at, figures)) = known
        && (0..FIGURES_AGE).contains(&(now - at))
    {
        return Ok(figures);
    }
    let figures = Arc::new(Figures::of(app.store.as_ref())?);
    *locked(&app.figures) = Some((now, Arc::clone(&figures)));
    Ok(figures)
}

fn funnel(cx: &Context) -> Result<Reply, Error> {
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
    // The first day of the epoch was a Thursday.
    let week = 7 * DAY;
    let this = (cx.now - 4 * DAY).div_euclid(week) * week + 4 * DAY;
    let bounds: Vec<i64> = (0..=WEEKS)
        .map(|back| this + week - (WEEKS - back) * week)
        .collect();
    let counts = cx.app.store.weeks(bounds.clone())?;
    let medians = &figures(&cx.app, cx.now)?.secs_by_time;
    for (index, counts) in counts.into_iter().enumerate() {
        let inside = |at: &&(i64, f64)| (bounds[index]..bounds[index + 1]).contains(&at.0);
        let mut secs: Vec<f64> = medians
            .iter()
            .filter(inside)
            .map(|(_, secs)| *secs)
            .collect();
        funnel.weeks.push(Week {
            start: bounds[index],
            submitted: counts.submitted,
            accepted: counts.accepted,
            returned: counts.returned,
            median_secs: crate::quality::median(&mut secs),
        });
    }
    json(&funnel)
}

fn people(cx: &Context) -> Result<Reply, Error> {
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

fn agreement(cx: &Context) -> Result<Reply, Error> {
    json(&figures(&cx.app, cx.now)?.agreement)
}

fn quota(cx: &Context) -> Result<Reply, Error> {
    let wanted = i64::from(cx.app.store.settings()?.quota);
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
            })
        })
        .collect();
    json(&rows)
}

// ---- administration

fn settings(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.settings()?)
}

fn put_settings(cx: &Context) -> Result<Reply, Error> {
    let settings: Settings = cx.body()?;
    cx.app.store.put_settings(cx.who()?.id, settings, cx.now)?;
    json(&cx.app.store.settings()?)
}

fn users(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.users()?)
}

fn shown(token: IssuedToken) -> TokenShown {
    TokenShown {
        user: token.user,
        id: token.id,
        token: token.token,
        expires: token.expires,
    }
}

fn add_user(cx: &Context) -> Result<Reply, Error> {
    let new: NewUser = cx.body()?;
    let user = cx
        .app
        .store
        .add_user(Some(cx.who()?.id), &new.name, new.role, cx.now)?;
    let expires = cx.now + i64::from(TOKEN_DAYS) * DAY;
    json(&shown(cx.app.store.issue(
        user.id,
        TokenUse::Token,
        expires,
        cx.now,
    )?))
}

fn change_user(cx: &Context) -> Result<Reply, Error> {
    let change: UserChange = cx.body()?;
    let user = cx.app.store.change_user(
        Some(cx.who()?.id),
        cx.id()?,
        change.role,
        change.active,
        cx.now,
    )?;
    json(&user)
}

fn tokens(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.tokens(cx.id()?)?)
}

fn add_token(cx: &Context) -> Result<Reply, Error> {
    let new: NewToken = cx.body()?;
    if !(1..=365).contains(&new.days) {
        return Err(Error::invalid("days", "a token is good for 1 to 365 days"));
    }
    let expires = cx.now + i64::from(new.days) * DAY;
    json(&shown(cx.app.store.issue(
        cx.id()?,
        TokenUse::Token,
        expires,
        cx.now,
    )?))
}

fn revoke(cx: &Context) -> Result<Reply, Error> {
    cx.app.store.revoke(cx.id()?)?;
    Ok(Reply::Empty)
}

fn import(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["format"])?;
    let format = cx
        .one_of("format", ImportFormat::parse)?
        .ok_or_else(|| Error::refused(Code::BadRequest, "format is missing: dataset or stance"))?;
    let work = jobs::Import {
        format,
        dataset: cx.app.config.dataset.clone(),
        data: cx.app.config.data.clone(),
        body: cx.body.to_vec(),
    };
    let job = jobs::start_import(&cx.app.store, &cx.app.config.clock, cx.who()?.id, work)?;
    json(&job)
}

fn export(cx: &Context) -> Result<Reply, Error> {
    let request: ExportRequest = cx.body()?;
    for split in &request.splits {
        split
            .parse::<datasets_spec::Split>()
            .map_err(|error| Error::invalid("splits", error.to_string()))?;
    }
    let job = jobs::start_export(
        &cx.app.store,
        &cx.app.config.clock,
        &cx.app.config.data,
        &cx.app.config.dataset,
        cx.who()?.id,
        request,
    )?;
    json(&job)
}

fn all_jobs(cx: &Context) -> Result<Reply, Error> {
    json(&cx.app.store.jobs()?)
}

fn job_of(cx: &Context) -> Result<crate::wire::Job, Error> {
    let id = cx.id()?;
    let mut jobs = cx.app.store.jobs()?.into_iter();
    jobs.find(|job| job.id == id)
        .ok_or_else(|| Error::not_found("job"))
}

fn one_job(cx: &Context) -> Result<Reply, Error> {
    json(&job_of(cx)?)
}

fn job_file(cx: &Context) -> Result<Reply, Error> {
    let job = job_of(cx)?;
    // Only a name the job itself lists is ever part of a path.
    let name = job
        .files
        .iter()
        .find(|known| *known == cx.param("name"))
        .ok_or_else(|| Error::not_found("file of this job"))?;
    let path = jobs::folder(&cx.app.config.data, job.id).join(name);
    let bytes = std::fs::read(&path).map_err(Error::io("read", path))?;
    let mut response = Response::new(Body::from(bytes));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "application/octet-stream",
    );
    set(&mut response, header::CACHE_CONTROL, "no-store");
    set(
        &mut response,
        header::CONTENT_DISPOSITION,
        &format!("attachment; filename=\"{name}\""),
    );
    Ok(Reply::Full(response))
}

fn audit(cx: &Context) -> Result<Reply, Error> {
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

// ---- the process

fn plain(text: String) -> Reply {
    let mut response = Response::new(Body::from(text));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "text/plain; charset=utf-8",
    );
    set(&mut response, header::CACHE_CONTROL, "no-store");
    Reply::Full(response)
}

fn healthy(_: &Context) -> Result<Reply, Error> {
    Ok(plain("ok\n".to_owned()))
}

fn ready(cx: &Context) -> Result<Reply, Error> {
    cx.app.store.check()?;
    *locked(&cx.app.read_only) = None;
    Ok(plain("ready\n".to_owned()))
}

fn metrics(cx: &Context) -> Result<Reply, Error> {
    let leases = cx.app.store.leases(cx.now)?.len() as i64;
    let gauges = [
        (
            "annotate_log_entries",
            "Entries of the log.",
            cx.app.store.last_seq()?,
        ),
        ("annotate_leases", "Leases held, up to a thousand.", leases),
        (
            "annotate_motions",
            "Motions of the dataset.",
            cx.app.motions.len() as i64,
        ),
        (
            "annotate_read_only",
            "Whether nothing can be saved.",
            i64::from(locked(&cx.app.read_only).is_some()),
        ),
    ];
    Ok(plain(cx.app.metrics.text(&gauges)))
}

fn asset(cx: &Context) -> Result<Reply, Error> {
    let asset = assets::find(&cx.path).ok_or_else(|| Error::not_found("file"))?;
    let known = super::text(&cx.headers, &header::IF_NONE_MATCH) == Some(asset.etag.as_str());
    let mut response = Response::new(if known {
        Body::empty()
    } else {
        Body::from(asset.bytes)
    });
    if known {
        *response.status_mut() = axum::http::StatusCode::NOT_MODIFIED;
    }
    set(&mut response, header::CONTENT_TYPE, asset.mime);
    set(&mut response, header::CACHE_CONTROL, "no-cache");
    set(&mut response, header::ETAG, &asset.etag);
    Ok(Reply::Full(response))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prefix of the interface.
    const API: &str = "/api/v1";

    #[test]
    fn every_route_of_the_interface_is_documented_with_its_role() {
        let document = include_str!("../../API.md");
        for route in ROUTES {
            let Some(path) = route.path.strip_prefix(API) else {
                continue;
            };
            let path = path
                .trim_start_matches('/')
                .replace("pairs/{id}", "pairs/{task}");
            let role = match route.access {
                Access::Public => "–".to_owned(),
                Access::Role(role) => role.to_string(),
                Access::Local => unreachable!("no route of the interface is local"),
            };
            let found = document.lines().any(|line| {
                let line = line.replace(r"\|", "/");
                let mut cells = line.split('|').skip(1);
                let named = cells.next().is_some_and(|cell| {
                    cell.split('`').any(|name| {
                        let bare = name.split('?').next().unwrap_or(name);
                        bare == format!("{} {path}", route.method)
                    })
                });
                named && cells.next().is_some_and(|cell| cell.trim() == role)
            });
            assert!(found, "API.md lacks {} {path} for {role}", route.method);
        }
    }
}
