//! Login, logout, and the current user.

use axum::http::header::SET_COOKIE;
use axum::response::{IntoResponse, Response};

use crate::Error;
use crate::clock::DAY;
use crate::http::app::{App, Context, cookie, empty, json};
use crate::http::proxy;
use crate::lock::lock;
use crate::store::Who;
use crate::wire::{Limits, Login, Me, Project, User};

/// Maximum number of wrong tokens per minute from one address. Correct tokens are never refused: many people may share
/// an address, and 32 random bytes cannot be guessed.
const WRONG_PER_MINUTE: u32 = 10;
/// Seconds between renewals of a lease.
const HEARTBEAT_SECS: i64 = 60;
/// Maximum lifetime of a session in days; it also ends with its token, unless that was for one login.
const SESSION_DAYS: i64 = 7;

pub(super) fn log_in(cx: &Context) -> Result<Response, Error> {
    let login: Login = cx.body()?;
    let until = cx.now + SESSION_DAYS * DAY;
    let (who, session) = match cx.store().log_in(&login.token, until, cx.now) {
        Err(error @ Error::Refused(_)) => {
            let client = proxy::counted(cx.client).to_string();
            let limiter = &cx.app.limiter;
            limiter.count("wrong logins", &client, WRONG_PER_MINUTE, cx.now)?;
            return Err(error);
        }
        logged_in => logged_in?,
    };
    let me = json(&me_of(&cx.app, &who)?)?;
    let age = (session.expires - cx.now) / 1000;
    Ok(with_cookie(cx, me, &session.token, age))
}

/// Adds the cookie of a session that lasts for `age` seconds.
fn with_cookie(cx: &Context, response: Response, value: &str, age: i64) -> Response {
    let name = cx.app.cookie_name();
    let secure = if cx.app.config.secure { "; Secure" } else { "" };
    let cookie =
        format!("{name}={value}; HttpOnly; SameSite=Strict; Path=/; Max-Age={age}{secure}");
    ([(SET_COOKIE, cookie)], response).into_response()
}

pub(super) fn log_out(cx: &Context) -> Result<Response, Error> {
    if let Some(token) = cookie(&cx.headers, &cx.app.cookie_name()) {
        cx.store().log_out(&token)?;
    }
    Ok(with_cookie(cx, empty(())?, "", 0))
}

pub(super) fn me_of(app: &App, who: &Who) -> Result<Me, Error> {
    let settings = app.store.settings()?;
    let model = app.config.model.as_ref();
    Ok(Me {
        user: User {
            id: who.id,
            name: who.name.clone(),
            role: who.role,
            active: true,
        },
        limits: Limits {
            lease_secs: i64::from(settings.lease_minutes) * 60,
            heartbeat_secs: HEARTBEAT_SECS,
        },
        project: Project {
            name: settings.name,
            min_masks: settings.min_masks,
            max_masks: settings.max_masks,
            styles: settings.styles,
            templates: settings.templates,
            style_templates: settings.style_templates,
            mask_templates: settings.mask_templates,
            time_zone: settings.time_zone,
        },
        prefs: app.store.prefs(who.id)?,
        model: model.map(|model| model.name().to_owned()),
        read_only: lock(&app.read_only).clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        store: app.store_id.clone(),
    })
}
