//! The HTTP API: response shapes, roles, errors.

use annotate::http::ROUTES;
use annotate::wire::{
    Answer, Audit, Code, Decision, EventKind, EventResults, Guide, HeldLease, Home, Job, Lease, Me,
    MotionInfo, Next, Person, Prefs, QuotaRow, ReviewDone, ReviewNext, Role, Settings, Shelf,
    SkeletonInfo, TaskKind, TaskState, TaskView, TokenInfo, TokenShown, User, Verdict,
};
use serde_json::json;

use crate::deployment::stream;
use crate::support::{
    CLIPS, Client, MINUTE, Site, agent, event, key, masks, pair, send, style, submit,
};

fn code(answered: &crate::support::Answered) -> Code {
    answered.problem().code
}

/// A path with its parameters filled in.
fn filled(path: &str) -> String {
    // An unused id, so that the requests change nothing.
    path.replace("{id}", "999999")
        .replace("{hash}", "nothing")
        .replace("{name}", "nothing")
        .replace("{*rest}", "home")
        .replace("{*name}", "nothing.js")
}

#[test]
fn every_route_asks_for_its_role() {
    let site = Site::new();
    let people = [
        (None, None),
        (
            Some(Role::Annotator),
            Some(site.person("a", Role::Annotator)),
        ),
        (Some(Role::Reviewer), Some(site.person("r", Role::Reviewer))),
        (Some(Role::Admin), Some(site.person("x", Role::Admin))),
    ];
    let mut walked = 0;
    for route in ROUTES {
        // Logout would end the session, and a stream never ends.
        let url = site.url(&filled(route.path));
        for (role, client) in &people {
            if route.path.ends_with("/stream") && client.is_some() {
                continue;
            }
            let bearer = client
                .as_ref()
                .map(|client| format!("Bearer {}", client.token));
            let mut headers = vec![("x-annotate", "1")];
            let origin = site.url("");
            headers.push(("origin", &origin));
            if let Some(bearer) = &bearer {
                headers.push(("authorization", bearer));
            }
            let body = (route.method != "GET" && route.method != "DELETE").then_some(&b"{}"[..]);
            let answered = send(&agent(), route.method, &url, &headers, body);
            let refused = answered.status == 401 || answered.status == 403;
            let let_in = match (route.role, role) {
                (None, _) => true,
                (Some(_), None) => false,
                (Some(needed), Some(role)) => *role >= needed,
            };
            let by_login = route.path == "/api/v1/session" && route.method == "POST";
            if !by_login {
                assert_eq!(
                    !refused, let_in,
                    "{} {} as {role:?}: {}",
                    route.method, route.path, answered.status
                );
            }
            if !let_in {
                let expected = if role.is_none() {
                    Code::Unauthenticated
                } else {
                    Code::Forbidden
                };
                assert_eq!(code(&answered), expected, "{} {}", route.method, route.path);
            }
            walked += 1;
        }
    }
    assert!(walked > 150, "{walked} were walked");
}

/// A browser session: cookie and headers.
fn log_in(site: &Site, client: &Client) -> String {
    let origin = site.url("");
    let body = json!({ "token": client.token }).to_string();
    let answered = send(
        &agent(),
        "POST",
        &site.url("/api/v1/session"),
        &[("origin", &origin), ("x-annotate", "1")],
        Some(body.as_bytes()),
    );
    let cookie = answered
        .headers
        .get("set-cookie")
        .and_then(|value| value.to_str().ok())
        .expect("a cookie")
        .to_owned();
    let me: Me = answered.ok();
    assert_eq!(me.user.id, client.user.id);
    for part in ["HttpOnly", "SameSite=Strict", "Path=/"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    cookie.split(';').next().expect("a pair").to_owned()
}

#[test]
fn a_session_belongs_to_one_store() {
    let one = Site::new();
    let two = Site::new();
    let ann = one.person("ann", Role::Annotator);
    let cookie = log_in(&one, &ann);
    let of_two = log_in(&two, &two.person("ann", Role::Annotator));
    let name = |cookie: &str| cookie.split('=').next().unwrap_or("").to_owned();
    assert_ne!(
        name(&cookie),
        name(&of_two),
        "browsers send cookies of one host to all its ports"
    );
    let both = format!("{of_two}; {cookie}");
    for site in [&one, &two] {
        let me: Me = send(
            &agent(),
            "GET",
            &site.url("/api/v1/me"),
            &[("cookie", &both)],
            None,
        )
        .ok();
        assert_eq!(me.store, site.store.id().expect("an id"));
    }
}

#[test]
fn requests_of_another_site_change_nothing() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let cookie = log_in(&site, &ann);
    let own = site.url("");
    let before = site.store.last_seq().expect("a place");
    let body = json!({ "kind": "mask_text" }).to_string();
    for route in ROUTES.iter().filter(|route| route.method != "GET") {
        let url = site.url(&filled(route.path));
        let cases: [(&[(&str, &str)], Code); 4] = [
            (&[("origin", &own)], Code::Csrf),
            (&[("x-annotate", "1")], Code::WrongOrigin),
            (
                &[("x-annotate", "1"), ("origin", "http://evil.example")],
                Code::WrongOrigin,
            ),
            (
                &[("x-annotate", "1"), ("origin", "null")],
                Code::WrongOrigin,
            ),
        ];
        for (headers, expected) in cases {
            let mut headers = headers.to_vec();
            headers.push(("cookie", &cookie));
            let answered = send(
                &agent(),
                route.method,
                &url,
                &headers,
                Some(body.as_bytes()),
            );
            assert_eq!(code(&answered), expected, "{} {}", route.method, route.path);
        }
    }
    assert_eq!(site.store.last_seq().expect("a place"), before);
    let fine = [
        ("cookie", cookie.as_str()),
        ("x-annotate", "1"),
        ("origin", &own),
    ];
    let next: Next = send(
        &agent(),
        "POST",
        &site.url("/api/v1/queue/next"),
        &fine,
        Some(body.as_bytes()),
    )
    .ok();
    assert!(next.task.is_some());
    let out = send(
        &agent(),
        "DELETE",
        &site.url("/api/v1/session"),
        &fine,
        None,
    );
    assert_eq!(out.status, 204);
    let after = send(
        &agent(),
        "GET",
        &site.url("/api/v1/me"),
        &[("cookie", &cookie)],
        None,
    );
    assert_eq!(code(&after), Code::Unauthenticated);
}

#[test]
fn every_answer_carries_the_headers_that_keep_a_page_safe() {
    let site = Site::new();
    for path in ["/", "/api/v1/me", "/nothing", "/healthz", "/assets/none.js"] {
        let answered = send(&agent(), "GET", &site.url(path), &[], None);
        let header = |name: &str| {
            answered
                .headers
                .get(name)
                .and_then(|value| value.to_str().ok())
        };
        let csp = header("content-security-policy").expect("a policy");
        for rule in [
            "default-src 'none'",
            "script-src 'self'",
            "frame-ancestors 'none'",
            "base-uri 'none'",
        ] {
            assert!(csp.contains(rule), "{path}");
        }
        assert!(!csp.contains("unsafe"));
        assert_eq!(header("x-content-type-options"), Some("nosniff"));
        assert_eq!(header("referrer-policy"), Some("no-referrer"));
    }
}

#[test]
fn logins_are_few_in_a_minute() {
    let site = Site::new();
    let origin = site.url("");
    let attempt = || {
        send(
            &agent(),
            "POST",
            &site.url("/api/v1/session"),
            &[("origin", &origin), ("x-annotate", "1")],
            Some(br#"{"token":"guess"}"#),
        )
    };
    for _ in 0..10 {
        assert_eq!(code(&attempt()), Code::Unauthenticated);
    }
    let refused = attempt();
    assert_eq!(code(&refused), Code::RateLimited);
    assert_eq!(
        refused
            .headers
            .get("retry-after")
            .and_then(|value| value.to_str().ok()),
        Some("60")
    );
    site.clock.advance(MINUTE);
    assert_eq!(code(&attempt()), Code::Unauthenticated);
}

#[test]
fn a_mask_task_goes_from_claim_to_shelf() {
    let site = Site::new();
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    let _: Me = ann.get("me").ok();
    let guide: Guide = ann.get("guide").ok();
    let of_masks = &guide.kinds[&TaskKind::MaskText];
    assert!(of_masks.text.contains("actively take part"));
    let skeleton: SkeletonInfo = ann.get("skeleton").ok();
    assert_eq!(skeleton.parts[3].name, "LEFT_ARM");
    let home: Home = ann.get("home").ok();
    assert_eq!(home.queues[0].total, CLIPS as i64);

    let next = ann.next(TaskKind::MaskText);
    let view = next.task.expect("a task");
    assert_eq!(view.task.motions[0].id, "clip00");
    assert_eq!(next.prefetch.len(), 3);
    let draft = &view.suggestions[0];
    assert_eq!(draft.text, "waving with their left arm");
    assert!(
        view.suggestions
            .iter()
            .any(|suggestion| suggestion.parts == ["LEFT_ARM"] && suggestion.text.is_empty())
    );

    let lease = view.lease.clone().expect("a lease");
    let renewed: Lease = ann
        .post(&format!("leases/{}/renew", lease.id), &json!({}))
        .ok();
    assert_eq!(renewed.epoch, lease.epoch);
    let path = format!("tasks/{}/events", view.task.id);
    let drafted: EventResults = ann
        .post(
            &path,
            &json!({ "events": [event(EventKind::Draft, lease.epoch, 0, Some(masks("half")))] }),
        )
        .ok();
    assert_eq!(
        (drafted.results[0].status, drafted.results[0].rev),
        (200, 1)
    );
    let again: TaskView = ann.get(&format!("tasks/{}", view.task.id)).ok();
    assert_eq!(
        again.mine.as_ref().map(|mine| &mine.answer),
        Some(&masks("half"))
    );
    let done: EventResults = ann
        .post(
            &path,
            &json!({ "events": [submit(&again, masks("waving"))] }),
        )
        .ok();
    assert_eq!(done.results[0].state, Some(TaskState::Submitted));

    let review: ReviewNext = eve.post("review/next", &json!({ "queue": "sample" })).ok();
    let review = review.review.expect("a review");
    assert_eq!(review.candidates[0].author_name, "ann");
    assert!(review.candidates[0].joints.contains(&16));
    let decided: ReviewDone = eve
        .post(
            "reviews",
            &json!({ "idem_key": key(), "task": review.task.id, "lease_epoch": review.lease.epoch,
                     "decision": Decision::Accept, "author": ann.user.id }),
        )
        .ok();
    assert_eq!(decided.state, TaskState::Accepted);
    let shelf: Shelf = ann.get("shelf?kind=mask_text&part=LEFT_ARM&q=waving").ok();
    assert_eq!(shelf.items.len(), 1);
    let none: Shelf = ann.get("shelf?q=100%25").ok();
    assert!(none.items.is_empty());
    let history: Vec<annotate::wire::AuditEntry> =
        eve.get(&format!("tasks/{}/history", view.task.id)).ok();
    let kinds: Vec<&str> = history.iter().map(|entry| entry.kind.as_str()).collect();
    assert_eq!(
        kinds,
        [
            "imported",
            "claimed",
            "renewed",
            "draft_saved",
            "submitted",
            "claimed",
            "accepted"
        ]
    );
}

#[test]
fn pairs_and_styles_are_answered_too() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::Pair);
    assert_eq!(view.task.hint.as_deref(), Some("raise the arm higher"));
    let bundle = view.task.bundle.clone().expect("a bundle");
    assert_eq!(bundle.tasks.len(), 8);
    assert!(bundle.tasks.iter().all(|item| item.leased));
    ann.answer(TaskKind::Pair, pair(Verdict::Unnatural));
    ann.answer(TaskKind::Pair, pair(Verdict::Keep));
    ann.answer(TaskKind::Style, style());
    let next = ann.next(TaskKind::Style);
    let empty = next.empty.expect("nothing is left");
    assert_eq!((empty.total, empty.done), (1, 1));
    let rows = ann.get(&format!("pairs/{}/diff", view.task.id)).floats();
    assert_eq!(rows.len(), 6 * 40);
    assert!(rows.iter().any(|apart| *apart > 0.01));
}

#[test]
fn motions_are_sent_as_they_are_documented() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let view = ann.claim(TaskKind::MaskText);
    let hash = &view.task.motions[0].hash;
    let answered = ann.get(&format!("motions/{hash}/joints"));
    let cache = answered
        .headers
        .get("cache-control")
        .and_then(|value| value.to_str().ok());
    assert_eq!(cache, Some("private, max-age=31536000, immutable"));
    let joints = answered.floats();
    assert_eq!(joints.len(), view.task.motions[0].frames * 28 * 3);
    let heat = ann.get(&format!("motions/{hash}/heat")).floats();
    assert_eq!(heat.len(), 5 * view.task.motions[0].frames);
    assert!(heat.iter().all(|value| value.is_finite() && *value >= 0.0));
    let partners: Vec<MotionInfo> = ann.get(&format!("motions/partners?of={hash}&n=4")).ok();
    assert_eq!(partners.len(), 4);
    assert!(
        partners
            .iter()
            .all(|partner| partner.split == "train" && partner.hash != *hash)
    );
    let blend = |parts: &[&str], alpha: f64| {
        ann.post(
            "blend",
            &json!({ "src": hash, "tgt": partners[0].hash, "parts": parts, "soft": true, "alpha": alpha }),
        )
    };
    let blended = blend(&["LEFT_ARM"], 0.5).floats();
    assert_eq!(blended.len(), joints.len());
    let moved: Vec<usize> = (0..28)
        .filter(|joint| {
            (0..40).any(|frame| {
                let at = (frame * 28 + joint) * 3;
                blended[at..at + 3] != joints[at..at + 3]
            })
        })
        .collect();
    assert!(!moved.is_empty());
    let allowed = [13, 16, 18, 20, 24, 25];
    assert!(
        moved.iter().all(|joint| allowed.contains(joint)),
        "only the masked arm moves: {moved:?}"
    );
    // A joint of the ring can be chosen away.
    let with = |change: serde_json::Value| {
        let mut request =
            json!({ "src": hash, "tgt": partners[0].hash, "parts": ["LEFT_ARM"], "alpha": 0.5 });
        let fields = change.as_object().expect("fields").clone();
        request.as_object_mut().expect("fields").extend(fields);
        ann.post("blend", &request)
    };
    let collar = json!({ "joint": "left_collar", "weight": "none" });
    assert_eq!(
        with(json!({ "joints": [collar] })).floats(),
        with(json!({ "soft": false })).floats()
    );
    let tail = json!({ "joint": "tail", "weight": "none" });
    assert_eq!(code(&with(json!({ "joints": [tail] }))), Code::Invalid);
    assert_eq!(code(&blend(&["LEFT_ARM"], 1.5)), Code::Invalid);
    assert_eq!(code(&blend(&["TAIL"], 0.5)), Code::Invalid);
    assert_eq!(code(&ann.get("motions/none/joints")), Code::NotFound);
}

#[test]
fn what_is_somebody_elses_is_not_found() {
    let site = Site::new();
    let (ann, bob) = (
        site.person("ann", Role::Annotator),
        site.person("bob", Role::Annotator),
    );
    let view = ann.claim(TaskKind::MaskText);
    let (task, lease) = (view.task.id, view.lease.expect("a lease"));
    let sent =
        json!({ "events": [event(EventKind::Draft, lease.epoch, 0, Some(masks("stolen")))] });
    for (method, path, body) in [
        ("GET", format!("tasks/{task}"), None),
        ("POST", format!("tasks/{task}/claim"), Some("{}".to_owned())),
        (
            "POST",
            format!("tasks/{task}/events"),
            Some(sent.to_string()),
        ),
        ("DELETE", format!("leases/{}", lease.id), None),
        ("GET", "tasks/999999".to_owned(), None),
        ("GET", "tasks/nonsense".to_owned(), None),
    ] {
        let answered = bob.call(method, &path, body.as_deref().map(str::as_bytes));
        assert_eq!(code(&answered), Code::NotFound, "{method} {path}");
    }
    let renewal = bob.post(&format!("leases/{}/renew", lease.id), &json!({}));
    assert_eq!(code(&renewal), Code::LeaseLost);
    // Idempotency keys of different users do not collide.
    let shared = event(EventKind::Draft, lease.epoch, 0, Some(masks("ann's")));
    let path = format!("tasks/{task}/events");
    let _: EventResults = ann.post(&path, &json!({ "events": [shared] })).ok();
    assert_eq!(
        code(&bob.post(&path, &json!({ "events": [shared] }))),
        Code::NotFound
    );
    let prefs: Prefs = bob.get("prefs").ok();
    assert_eq!(prefs, Prefs::default());
}

#[test]
fn malformed_requests_are_refused_by_name() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    let admin = site.person("adm", Role::Admin);
    let view = ann.claim(TaskKind::MaskText);
    let path = format!("tasks/{}/events", view.task.id);
    let lease = view.lease.as_ref().expect("a lease").epoch;
    let send_answer = |answer: Answer| {
        let results: EventResults = ann
            .post(
                &path,
                &json!({ "events": [event(EventKind::Submit, lease, 0, Some(answer))] }),
            )
            .ok();
        results.results[0].problem.clone().expect("a problem").code
    };
    assert_eq!(send_answer(pair(Verdict::Keep)), Code::Invalid);
    let Answer::MaskText { masks: list, .. } = masks("one") else {
        unreachable!("masks makes masks")
    };
    let one = Answer::MaskText {
        masks: list[..1].to_vec(),
        count_reason: None,
        note: String::new(),
    };
    assert_eq!(send_answer(one), Code::MaskCount);
    // A parameter without a value is left out.
    let _: Shelf = ann.get("shelf?kind=&q=&limit=").ok();
    for (answered, expected) in [
        (
            ann.post("queue/next", &json!({ "kind": "mask_text", "more": 1 })),
            Code::BadRequest,
        ),
        (
            ann.post("queue/next", &json!({ "kind": "nothing" })),
            Code::BadRequest,
        ),
        (ann.call("POST", "queue/next", Some(b"{")), Code::BadRequest),
        (ann.get("shelf?kind=nothing"), Code::BadRequest),
        (ann.get("shelf?colour=red"), Code::BadRequest),
        (ann.get("shelf?limit=ten"), Code::BadRequest),
        (ann.get("shelf?q=%zz"), Code::BadRequest),
        (ann.post(&path, &json!({ "events": [] })), Code::Invalid),
        (
            ann.post(
                &path,
                &json!({ "events": vec![event(EventKind::Draft, lease, 0, Some(masks("much"))); 65] }),
            ),
            Code::Invalid,
        ),
        (ann.get("nothing"), Code::NotFound),
        (ann.call("PATCH", "me", Some(b"{}")), Code::MethodNotAllowed),
        (
            ann.call("POST", "queue/next", Some(&vec![b' '; 300_000])),
            Code::TooLarge,
        ),
        (
            ann.post(
                &format!("tasks/{}/suggest", view.task.id),
                &json!({ "parts": ["HEAD"] }),
            ),
            Code::NoModel,
        ),
        (
            ann.call("PUT", "prefs", Some(br#"{"keys":{"undo":["<script>"]}}"#)),
            Code::Invalid,
        ),
        (
            admin.post("imports?format=nothing", &json!({})),
            Code::BadRequest,
        ),
        (admin.get("audit?kind=drop%20table"), Code::BadRequest),
        (
            admin.post("users", &json!({ "name": "ann", "role": "annotator" })),
            Code::Invalid,
        ),
        (
            admin.post("users", &json!({ "name": " ", "role": "annotator" })),
            Code::Invalid,
        ),
    ] {
        assert_eq!(code(&answered), expected);
    }
}

#[test]
fn an_admin_adds_people_changes_settings_and_reads_the_log() {
    let site = Site::new();
    let admin = site.person("adm", Role::Admin);
    let shown: TokenShown = admin
        .post("users", &json!({ "name": "new", "role": "annotator" }))
        .ok();
    let new = Client {
        base: admin.base.clone(),
        user: shown.user.clone(),
        token: shown.token,
        agent: agent(),
    };
    let me: Me = new.get("me").ok();
    assert_eq!(me.user.name, "new");
    let tokens: Vec<TokenInfo> = admin.get(&format!("users/{}/tokens", new.user.id)).ok();
    assert_eq!(tokens.len(), 1);
    assert_eq!(
        admin
            .call("DELETE", &format!("tokens/{}", tokens[0].id), None)
            .status,
        204
    );
    assert_eq!(code(&new.get("me")), Code::Unauthenticated);
    let again: TokenShown = admin
        .post(
            &format!("users/{}/tokens", new.user.id),
            &json!({ "days": 5 }),
        )
        .ok();
    assert_eq!(again.expires, site.clock.now() + 5 * 24 * 60 * MINUTE);
    let changed: User = admin
        .call(
            "PATCH",
            &format!("users/{}", new.user.id),
            Some(br#"{"role":"reviewer"}"#),
        )
        .ok();
    assert_eq!(changed.role, Role::Reviewer);
    let mut settings: Settings = admin.get("settings").ok();
    settings.min_masks = 1;
    let body = serde_json::to_vec(&settings).expect("JSON");
    let kept: Settings = admin.call("PUT", "settings", Some(&body)).ok();
    assert_eq!(kept, settings);
    settings.gold_percent = 200;
    let body = serde_json::to_vec(&settings).expect("JSON");
    assert_eq!(
        code(&admin.call("PUT", "settings", Some(&body))),
        Code::Invalid
    );
    let audit: Audit = admin.get("audit?kind=role_changed&limit=2").ok();
    assert_eq!(audit.entries.len(), 2);
    assert!(audit.next.is_some());
    let users: Vec<User> = admin.get("users").ok();
    assert!(users.len() >= 3);
    let _: Vec<Job> = admin.get("jobs").ok();
}

#[test]
fn the_dashboard_counts_tasks_and_people() {
    let site = Site::new();
    let (ann, eve) = (
        site.person("ann", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    ann.answer(TaskKind::MaskText, masks("waving"));
    ann.answer(TaskKind::Pair, pair(Verdict::Keep));
    let funnel: annotate::wire::Funnel = eve.get("stats/funnel").ok();
    assert_eq!(funnel.counts[&TaskKind::MaskText][&TaskState::Submitted], 1);
    assert_eq!(funnel.weeks.last().map(|week| week.submitted), Some(2));
    let people: Vec<Person> = eve.get("stats/people").ok();
    let me = people
        .iter()
        .find(|person| person.user.name == "ann")
        .expect("ann");
    assert_eq!(
        (me.done, me.median_secs, me.agreement),
        (2, Some(12.5), None)
    );
    let agreement: annotate::wire::Agreement = eve.get("stats/agreement").ok();
    assert_eq!((agreement.shared_items, agreement.jaccard), (0, None));
    let quota: Vec<QuotaRow> = eve.get("stats/quota").ok();
    assert_eq!((quota[0].category.as_str(), quota[0].kept), ("wave", 1));
    let leases: Vec<HeldLease> = eve.get("leases").ok();
    assert_eq!(leases.len(), 7, "the rest of the bundle");
}

#[test]
fn metrics_speak_of_requests() {
    let site = Site::new();
    let ann = site.person("ann", Role::Annotator);
    ann.claim(TaskKind::MaskText);
    let refused = send(&agent(), "GET", &site.url("/metrics"), &[], None);
    assert_eq!(
        code(&refused),
        Code::Unauthenticated,
        "not even from loopback"
    );
    let admin = site.person("adm", Role::Admin);
    let bearer = format!("Bearer {}", admin.token);
    let headers = [("authorization", bearer.as_str())];
    let answered = send(&agent(), "GET", &site.url("/metrics"), &headers, None);
    let text = String::from_utf8(answered.body).expect("text");
    assert!(text.contains(
        "annotate_requests_total{method=\"POST\",path=\"/api/v1/queue/next\",status=\"200\"} 1"
    ));
    for path in ["/healthz", "/readyz"] {
        assert_eq!(
            send(&agent(), "GET", &site.url(path), &[], None).status,
            200
        );
    }
}

#[test]
fn the_stream_tells_reviewers_all_and_annotators_what_is_theirs() {
    let site = Site::new();
    let (ann, bob, eve) = (
        site.person("ann", Role::Annotator),
        site.person("bob", Role::Annotator),
        site.person("eve", Role::Reviewer),
    );
    let (mut to_bob, mut to_eve) = (stream(&bob), stream(&eve));
    let hers = ann.claim(TaskKind::MaskText).task.id;
    let his = bob.claim(TaskKind::MaskText).task.id;
    fn first(mut lines: impl Iterator<Item = String>) -> annotate::wire::Change {
        let data = lines
            .find_map(|line| line.strip_prefix("data: ").map(str::to_owned))
            .expect("a change");
        serde_json::from_str(&data).expect("a change")
    }
    let change = first(&mut to_bob);
    assert_eq!((change.task, change.mine), (Some(his), true));
    let change = first(&mut to_eve);
    assert_eq!(
        (change.task, change.mine, change.kind.as_str()),
        (Some(hers), false, "claimed")
    );
}
