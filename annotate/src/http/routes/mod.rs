//! The table of routes.

mod admin;
mod browse;
mod dashboard;
mod guide;
mod health;
mod home;
mod jobs;
mod motions;
mod review;
mod session;
mod tasks;

use axum::routing::MethodFilter;

use super::app::{Route, empty, json};
use super::stream;
use crate::body::skeleton_info;
use crate::wire::{
    ApplyRules, MAX_BODY_BYTES, MAX_IMPORT_BYTES, MAX_PICTURE_BYTES, MAX_SETTINGS_BYTES, Role,
};

const PUBLIC: Option<Role> = None;
const ANNOTATOR: Option<Role> = Some(Role::Annotator);
const REVIEWER: Option<Role> = Some(Role::Reviewer);
const ADMIN: Option<Role> = Some(Role::Admin);

/// Builds a table of routes. Each line has a method, a path, the required role, a handler, and a limit of the body if
/// it is not [`MAX_BODY_BYTES`].
macro_rules! routes {
    ($($method:ident $path:literal $role:ident $handler:expr $(, up to $max:ident)?;)*) => {
        &[$(Route {
            method: stringify!($method),
            filter: MethodFilter::$method,
            path: $path,
            role: $role,
            // The given limit, if any, precedes the default.
            max_body: [$($max,)? MAX_BODY_BYTES][0],
            handler: $handler,
        },)*]
    };
}

/// All routes.
pub static ROUTES: &[Route] = routes! {
    POST "/api/v1/session" PUBLIC session::log_in;
    DELETE "/api/v1/session" ANNOTATOR session::log_out;
    GET "/api/v1/me" ANNOTATOR |cx| json(&session::me_of(&cx.app, cx.who()?)?);
    GET "/api/v1/prefs" ANNOTATOR |cx| json(&cx.store().prefs(cx.user()?)?);
    PUT "/api/v1/prefs" ANNOTATOR home::put_prefs;
    GET "/api/v1/guide" ANNOTATOR guide::guide;
    PUT "/api/v1/guide/{kind}" ADMIN guide::put_guide, up to MAX_SETTINGS_BYTES;
    GET "/api/v1/guide/pictures" ANNOTATOR |cx| json(&cx.store().pictures()?);
    GET "/api/v1/guide/pictures/{name}" ANNOTATOR guide::picture;
    PUT "/api/v1/guide/pictures/{name}" ADMIN guide::put_picture, up to MAX_PICTURE_BYTES;
    DELETE "/api/v1/guide/pictures/{name}" ADMIN guide::delete_picture;
    GET "/api/v1/skeleton" ANNOTATOR |_| json(&skeleton_info());
    GET "/api/v1/home" ANNOTATOR home::home;
    GET "/api/v1/shelf" ANNOTATOR home::shelf;
    POST "/api/v1/queue/next" ANNOTATOR tasks::next;
    GET "/api/v1/leases" REVIEWER |cx| json(&cx.store().leases(cx.now)?);
    POST "/api/v1/leases/{id}/renew" ANNOTATOR |cx| json(&cx.store().renew(cx.user()?, cx.id()?, cx.now)?);
    DELETE "/api/v1/leases/{id}" ANNOTATOR |cx| cx.store().release(cx.who()?, cx.id()?, cx.now).and_then(empty);
    GET "/api/v1/answers" ANNOTATOR browse::mine;
    GET "/api/v1/tasks" REVIEWER browse::tasks;
    GET "/api/v1/tasks/{id}" ANNOTATOR tasks::task;
    GET "/api/v1/tasks/{id}/record" REVIEWER browse::task;
    POST "/api/v1/tasks/{id}/claim" ANNOTATOR tasks::claim;
    POST "/api/v1/tasks/{id}/events" ANNOTATOR tasks::events;
    POST "/api/v1/tasks/{id}/suggest" ANNOTATOR tasks::suggest;
    POST "/api/v1/tasks/{id}/gold" ADMIN tasks::make_gold;
    POST "/api/v1/tasks/{id}/practice" ADMIN tasks::make_practice;
    GET "/api/v1/practice" ANNOTATOR |cx| json(&cx.store().practice(cx.user()?)?);
    GET "/api/v1/tasks/{id}/history" REVIEWER tasks::history;
    GET "/api/v1/motions/partners" ANNOTATOR motions::partners;
    GET "/api/v1/motions/{hash}/joints" ANNOTATOR motions::joints;
    GET "/api/v1/motions/{hash}/heat" ANNOTATOR motions::heat;
    GET "/api/v1/pairs/{id}/diff" ANNOTATOR motions::difference;
    POST "/api/v1/blend" ANNOTATOR motions::blend;
    POST "/api/v1/review/next" REVIEWER review::review_next;
    POST "/api/v1/reviews" REVIEWER review::review;
    GET "/api/v1/reviews" REVIEWER browse::decisions;
    POST "/api/v1/bulk/preview" REVIEWER |cx| json(&cx.store().preview_bulk(cx.who()?, cx.body()?, cx.now)?);
    POST "/api/v1/bulk" REVIEWER |cx| json(&cx.store().bulk(cx.who()?, cx.body()?, cx.now)?);
    GET "/api/v1/rules" REVIEWER |cx| json(&cx.store().rules()?);
    POST "/api/v1/rules/apply" ADMIN |cx| {
        let request: ApplyRules = cx.body()?;
        json(&cx.store().apply_rules(request.after.unwrap_or(0), cx.now)?)
    };
    POST "/api/v1/rules/{name}/undo" ADMIN |cx| json(&cx.store().undo_rule(cx.user()?, cx.param("name"), cx.now)?);
    GET "/api/v1/stats/funnel" REVIEWER dashboard::funnel;
    GET "/api/v1/stats/people" REVIEWER dashboard::people;
    GET "/api/v1/stats/agreement" REVIEWER |cx| json(&dashboard::figures(cx)?.agreement);
    GET "/api/v1/stats/quota" REVIEWER dashboard::quota;
    GET "/api/v1/stats/edit-types" ANNOTATOR dashboard::edit_types;
    GET "/api/v1/stats/days" REVIEWER dashboard::days;
    GET "/api/v1/stats/outlook" REVIEWER |cx| json(&cx.store().outlook(cx.now)?);
    GET "/api/v1/captures" REVIEWER |cx| json(&cx.store().captures()?);
    PUT "/api/v1/captures" ADMIN admin::put_captures, up to MAX_SETTINGS_BYTES;
    GET "/api/v1/settings" ADMIN |cx| json(&cx.store().settings()?);
    PUT "/api/v1/settings" ADMIN admin::put_settings, up to MAX_SETTINGS_BYTES;
    GET "/api/v1/users" ADMIN |cx| json(&cx.store().users()?);
    POST "/api/v1/users" ADMIN admin::add_user;
    POST "/api/v1/users/bulk" ADMIN admin::add_users;
    PATCH "/api/v1/users/{id}" ADMIN admin::change_user;
    GET "/api/v1/users/{id}/tokens" ADMIN |cx| json(&cx.store().tokens(cx.id()?)?);
    POST "/api/v1/users/{id}/tokens" ADMIN admin::add_token;
    DELETE "/api/v1/tokens/{id}" ADMIN |cx| cx.store().revoke(cx.id()?).and_then(empty);
    POST "/api/v1/imports" ADMIN jobs::import, up to MAX_IMPORT_BYTES;
    POST "/api/v1/exports" ADMIN jobs::export;
    GET "/api/v1/jobs" ADMIN |cx| json(&jobs::all(cx)?);
    GET "/api/v1/jobs/{id}" ADMIN |cx| json(&jobs::one(cx)?);
    GET "/api/v1/jobs/{id}/files/{name}" ADMIN jobs::file;
    GET "/api/v1/audit" ADMIN dashboard::audit;
    GET "/api/v1/stream" REVIEWER stream::open;
    GET "/healthz" PUBLIC health::healthy;
    GET "/readyz" PUBLIC health::ready;
    GET "/metrics" ADMIN health::metrics;
    GET "/" PUBLIC health::asset;
    GET "/app" PUBLIC health::asset;
    GET "/app/" PUBLIC health::asset;
    GET "/app/{*rest}" PUBLIC health::asset;
    GET "/assets/{*name}" PUBLIC health::asset;
};

/// Routes of the operators' address, which need no login.
pub(super) static OPERATOR_ROUTES: &[Route] = routes! {
    GET "/healthz" PUBLIC health::healthy;
    GET "/readyz" PUBLIC health::ready;
    GET "/metrics" PUBLIC health::metrics;
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Prefix of the API.
    const API: &str = "/api/v1";

    #[test]
    fn every_route_of_the_interface_is_documented_with_its_role() {
        let document = include_str!("../../../API.md");
        for route in ROUTES {
            let Some(path) = route.path.strip_prefix(API) else {
                continue;
            };
            let path = path
                .trim_start_matches('/')
                .replace("pairs/{id}", "pairs/{task}");
            let role = route.role.map_or("–", Role::as_str);
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
