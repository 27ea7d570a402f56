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
mod rules;
mod session;
mod tasks;

use super::app::{Access, Handler, Route};
use crate::wire::{MAX_BODY_BYTES, MAX_IMPORT_BYTES, MAX_PICTURE_BYTES, MAX_SETTINGS_BYTES, Role};

const PUBLIC: Access = Access::Public;
const ANNOTATOR: Access = Access::Role(Role::Annotator);
const REVIEWER: Access = Access::Role(Role::Reviewer);
const ADMIN: Access = Access::Role(Role::Admin);

/// A table of routes from lines of method, path, required role and handler. Routes with a body limit or a kind of handler of
/// their own follow as whole [`Route`]s, each after `@also`.
macro_rules! routes {
    ($($method:ident $path:literal $access:ident $work:path;)* $(@also $other:expr;)*) => {
        &[
            $(Route {
                method: stringify!($method),
                path: $path,
                access: $access,
                max_body: MAX_BODY_BYTES,
                handler: Handler::Work($work),
            },)*
            $($other,)*
        ]
    };
}

/// All routes.
pub static ROUTES: &[Route] = routes! {
    POST "/api/v1/session" PUBLIC session::log_in;
    DELETE "/api/v1/session" ANNOTATOR session::log_out;
    GET "/api/v1/me" ANNOTATOR session::me;
    GET "/api/v1/prefs" ANNOTATOR home::prefs;
    PUT "/api/v1/prefs" ANNOTATOR home::put_prefs;
    GET "/api/v1/guide" ANNOTATOR guide::guide;
    PUT "/api/v1/guide/{kind}" ADMIN guide::put_guide;
    GET "/api/v1/guide/pictures" ANNOTATOR guide::pictures;
    GET "/api/v1/guide/pictures/{name}" ANNOTATOR guide::picture;
    DELETE "/api/v1/guide/pictures/{name}" ADMIN guide::delete_picture;
    GET "/api/v1/skeleton" ANNOTATOR home::skeleton;
    GET "/api/v1/home" ANNOTATOR home::home;
    GET "/api/v1/shelf" ANNOTATOR home::shelf;
    POST "/api/v1/queue/next" ANNOTATOR tasks::next;
    GET "/api/v1/leases" REVIEWER tasks::leases;
    POST "/api/v1/leases/{id}/renew" ANNOTATOR tasks::renew;
    DELETE "/api/v1/leases/{id}" ANNOTATOR tasks::release;
    GET "/api/v1/answers" ANNOTATOR browse::mine;
    GET "/api/v1/tasks" REVIEWER browse::tasks;
    GET "/api/v1/tasks/{id}" ANNOTATOR tasks::task;
    GET "/api/v1/tasks/{id}/record" REVIEWER browse::task;
    POST "/api/v1/tasks/{id}/claim" ANNOTATOR tasks::claim;
    POST "/api/v1/tasks/{id}/events" ANNOTATOR tasks::events;
    POST "/api/v1/tasks/{id}/suggest" ANNOTATOR tasks::suggest;
    POST "/api/v1/tasks/{id}/gold" ADMIN tasks::make_gold;
    POST "/api/v1/tasks/{id}/practice" ADMIN tasks::make_practice;
    GET "/api/v1/practice" ANNOTATOR tasks::practice;
    GET "/api/v1/tasks/{id}/history" REVIEWER tasks::history;
    GET "/api/v1/motions/partners" ANNOTATOR motions::partners;
    GET "/api/v1/motions/{hash}/joints" ANNOTATOR motions::joints;
    GET "/api/v1/motions/{hash}/heat" ANNOTATOR motions::heat;
    GET "/api/v1/pairs/{id}/diff" ANNOTATOR motions::difference;
    POST "/api/v1/blend" ANNOTATOR motions::blend;
    POST "/api/v1/review/next" REVIEWER review::review_next;
    POST "/api/v1/reviews" REVIEWER review::review;
    GET "/api/v1/reviews" REVIEWER browse::decisions;
    POST "/api/v1/bulk/preview" REVIEWER browse::preview;
    POST "/api/v1/bulk" REVIEWER browse::bulk;
    GET "/api/v1/rules" REVIEWER rules::rules;
    POST "/api/v1/rules/apply" ADMIN rules::apply;
    POST "/api/v1/rules/{name}/undo" ADMIN rules::undo;
    GET "/api/v1/stats/funnel" REVIEWER dashboard::funnel;
    GET "/api/v1/stats/people" REVIEWER dashboard::people;
    GET "/api/v1/stats/agreement" REVIEWER dashboard::agreement;
    GET "/api/v1/stats/quota" REVIEWER dashboard::quota;
    GET "/api/v1/stats/edit-types" ANNOTATOR dashboard::edit_types;
    GET "/api/v1/stats/days" REVIEWER dashboard::days;
    GET "/api/v1/stats/outlook" REVIEWER dashboard::outlook;
    GET "/api/v1/captures" REVIEWER dashboard::captures;
    GET "/api/v1/settings" ADMIN admin::settings;
    GET "/api/v1/users" ADMIN admin::users;
    POST "/api/v1/users" ADMIN admin::add_user;
    POST "/api/v1/users/bulk" ADMIN admin::add_users;
    PATCH "/api/v1/users/{id}" ADMIN admin::change_user;
    GET "/api/v1/users/{id}/tokens" ADMIN admin::tokens;
    POST "/api/v1/users/{id}/tokens" ADMIN admin::add_token;
    DELETE "/api/v1/tokens/{id}" ADMIN admin::revoke;
    POST "/api/v1/exports" ADMIN jobs::export;
    GET "/api/v1/jobs" ADMIN jobs::all_jobs;
    GET "/api/v1/jobs/{id}" ADMIN jobs::one_job;
    GET "/api/v1/jobs/{id}/files/{name}" ADMIN jobs::job_file;
    GET "/api/v1/audit" ADMIN dashboard::audit;
    GET "/healthz" PUBLIC health::healthy;
    GET "/readyz" PUBLIC health::ready;
    GET "/metrics" ADMIN health::metrics;
    GET "/" PUBLIC health::asset;
    GET "/app" PUBLIC health::asset;
    GET "/app/" PUBLIC health::asset;
    GET "/app/{*rest}" PUBLIC health::asset;
    GET "/assets/{*name}" PUBLIC health::asset;
    @also Route {
        method: "PUT",
        path: "/api/v1/settings",
        access: ADMIN,
        max_body: MAX_SETTINGS_BYTES,
        handler: Handler::Work(admin::put_settings),
    };
    @also Route {
        method: "PUT",
        path: "/api/v1/captures",
        access: ADMIN,
        max_body: MAX_SETTINGS_BYTES,
        handler: Handler::Work(admin::put_captures),
    };
    @also Route {
        method: "PUT",
        path: "/api/v1/guide/pictures/{name}",
        access: ADMIN,
        max_body: MAX_PICTURE_BYTES,
        handler: Handler::Work(guide::put_picture),
    };
    @also Route {
        method: "GET",
        path: "/api/v1/stream",
        access: ANNOTATOR,
        max_body: 0,
        handler: Handler::Stream,
    };
    @also Route {
        method: "POST",
        path: "/api/v1/imports",
        access: ADMIN,
        max_body: MAX_IMPORT_BYTES,
        handler: Handler::Work(jobs::import),
    };
};

/// Routes of the address for operators, which needs no login.
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
            let role = match route.access {
                Access::Public => "–".to_owned(),
                Access::Role(role) => role.to_string(),
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
