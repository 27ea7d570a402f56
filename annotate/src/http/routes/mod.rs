//! The table of routes.

mod admin;
mod browse;
mod dashboard;
mod guide;
mod health;
mod home;
mod jobs;
mod motions;
mod paraphrases;
mod review;
mod rules;
mod session;
mod tasks;

use super::app::{Access, Context, Handler, Reply, Route};
use crate::Error;
use crate::wire::{MAX_BODY_BYTES, MAX_IMPORT_BYTES, MAX_PICTURE_BYTES, Role};

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

/// All routes.
pub static ROUTES: &[Route] = &[
    row("POST", "/api/v1/session", PUBLIC, session::log_in),
    row("DELETE", "/api/v1/session", ANNOTATOR, session::log_out),
    row("GET", "/api/v1/me", ANNOTATOR, session::me),
    row("GET", "/api/v1/prefs", ANNOTATOR, home::prefs),
    row("PUT", "/api/v1/prefs", ANNOTATOR, home::put_prefs),
    row("GET", "/api/v1/guide", ANNOTATOR, guide::guide),
    row("PUT", "/api/v1/guide/{kind}", ADMIN, guide::put_guide),
    row("GET", "/api/v1/guide/pictures", ANNOTATOR, guide::pictures),
    row(
        "GET",
        "/api/v1/guide/pictures/{name}",
        ANNOTATOR,
        guide::picture,
    ),
    Route {
        method: "PUT",
        path: "/api/v1/guide/pictures/{name}",
        access: ADMIN,
        max_body: MAX_PICTURE_BYTES,
        handler: Handler::Work(guide::put_picture),
    },
    row(
        "DELETE",
        "/api/v1/guide/pictures/{name}",
        ADMIN,
        guide::delete_picture,
    ),
    row("GET", "/api/v1/skeleton", ANNOTATOR, home::skeleton),
    row("GET", "/api/v1/home", ANNOTATOR, home::home),
    row("GET", "/api/v1/shelf", ANNOTATOR, home::shelf),
    row("POST", "/api/v1/queue/next", ANNOTATOR, tasks::next),
    row("GET", "/api/v1/leases", REVIEWER, tasks::leases),
    row("POST", "/api/v1/leases/{id}/renew", ANNOTATOR, tasks::renew),
    row("DELETE", "/api/v1/leases/{id}", ANNOTATOR, tasks::release),
    row("GET", "/api/v1/answers", ANNOTATOR, browse::mine),
    row("GET", "/api/v1/tasks", REVIEWER, browse::tasks),
    row("GET", "/api/v1/tasks/{id}", ANNOTATOR, tasks::task),
    row("GET", "/api/v1/tasks/{id}/record", REVIEWER, browse::task),
    row("POST", "/api/v1/tasks/{id}/claim", ANNOTATOR, tasks::claim),
    row(
        "POST",
        "/api/v1/tasks/{id}/events",
        ANNOTATOR,
        tasks::events,
    ),
    row(
        "POST",
        "/api/v1/tasks/{id}/suggest",
        ANNOTATOR,
        tasks::suggest,
    ),
    row("POST", "/api/v1/tasks/{id}/gold", ADMIN, tasks::make_gold),
    row(
        "POST",
        "/api/v1/tasks/{id}/practice",
        ADMIN,
        tasks::make_practice,
    ),
    row("GET", "/api/v1/practice", ANNOTATOR, tasks::practice),
    row(
        "GET",
        "/api/v1/tasks/{id}/history",
        REVIEWER,
        tasks::history,
    ),
    row(
        "GET",
        "/api/v1/motions/partners",
        ANNOTATOR,
        motions::partners,
    ),
    row(
        "GET",
        "/api/v1/motions/{hash}/joints",
        ANNOTATOR,
        motions::joints,
    ),
    row(
        "GET",
        "/api/v1/motions/{hash}/heat",
        ANNOTATOR,
        motions::heat,
    ),
    row(
        "GET",
        "/api/v1/pairs/{id}/diff",
        ANNOTATOR,
        motions::difference,
    ),
    row("POST", "/api/v1/blend", ANNOTATOR, motions::blend),
    row("POST", "/api/v1/review/next", REVIEWER, review::review_next),
    row("POST", "/api/v1/reviews", REVIEWER, review::review),
    row("GET", "/api/v1/reviews", REVIEWER, browse::decisions),
    row("POST", "/api/v1/bulk/preview", REVIEWER, browse::preview),
    row("POST", "/api/v1/bulk", REVIEWER, browse::bulk),
    row(
        "GET",
        "/api/v1/paraphrases",
        REVIEWER,
        paraphrases::paraphrases,
    ),
    row(
        "POST",
        "/api/v1/paraphrases/{id}",
        REVIEWER,
        paraphrases::judge,
    ),
    row("GET", "/api/v1/rules", REVIEWER, rules::rules),
    row("POST", "/api/v1/rules/apply", ADMIN, rules::apply),
    row("POST", "/api/v1/rules/{name}/undo", ADMIN, rules::undo),
    row("GET", "/api/v1/stats/funnel", REVIEWER, dashboard::funnel),
    row("GET", "/api/v1/stats/people", REVIEWER, dashboard::people),
    row(
        "GET",
        "/api/v1/stats/agreement",
        REVIEWER,
        dashboard::agreement,
    ),
    row("GET", "/api/v1/stats/quota", REVIEWER, dashboard::quota),
    row("GET", "/api/v1/stats/days", REVIEWER, dashboard::days),
    row("GET", "/api/v1/stats/outlook", REVIEWER, dashboard::outlook),
    Route {
        method: "GET",
        path: "/api/v1/stream",
        access: ANNOTATOR,
        max_body: 0,
        handler: Handler::Stream,
    },
    row("GET", "/api/v1/settings", ADMIN, admin::settings),
    row("PUT", "/api/v1/settings", ADMIN, admin::put_settings),
    row("GET", "/api/v1/users", ADMIN, admin::users),
    row("POST", "/api/v1/users", ADMIN, admin::add_user),
    row("POST", "/api/v1/users/bulk", ADMIN, admin::add_users),
    row("PATCH", "/api/v1/users/{id}", ADMIN, admin::change_user),
    row("GET", "/api/v1/users/{id}/tokens", ADMIN, admin::tokens),
    row("POST", "/api/v1/users/{id}/tokens", ADMIN, admin::add_token),
    row("DELETE", "/api/v1/tokens/{id}", ADMIN, admin::revoke),
    Route {
        method: "POST",
        path: "/api/v1/imports",
        access: ADMIN,
        max_body: MAX_IMPORT_BYTES,
        handler: Handler::Work(jobs::import),
    },
    row("POST", "/api/v1/exports", ADMIN, jobs::export),
    row("GET", "/api/v1/jobs", ADMIN, jobs::all_jobs),
    row("GET", "/api/v1/jobs/{id}", ADMIN, jobs::one_job),
    row(
        "GET",
        "/api/v1/jobs/{id}/files/{name}",
        ADMIN,
        jobs::job_file,
    ),
    row("GET", "/api/v1/audit", ADMIN, dashboard::audit),
    row("GET", "/healthz", PUBLIC, health::healthy),
    row("GET", "/readyz", PUBLIC, health::ready),
    row("GET", "/metrics", ADMIN, health::metrics),
    row("GET", "/", PUBLIC, health::asset),
    row("GET", "/app", PUBLIC, health::asset),
    row("GET", "/app/{*rest}", PUBLIC, health::asset),
    row("GET", "/assets/{*name}", PUBLIC, health::asset),
];

/// Routes of the address for operators, which needs no login.
pub(super) static OPERATOR_ROUTES: &[Route] = &[
    row("GET", "/healthz", PUBLIC, health::healthy),
    row("GET", "/readyz", PUBLIC, health::ready),
    row("GET", "/metrics", PUBLIC, health::metrics),
];

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
