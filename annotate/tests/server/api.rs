//! The HTTP API: response shapes, roles, errors.

use annotate::http::ROUTES;
use annotate::wire::{
    Agreement, Audit, AuditEntry, Change, Code, Decision, EventKind, Funnel, Guide, HeldLease,
    Home, Job, Lease, Me, MotionInfo, Next, Person, Prefs, QuotaRow, ReviewDone, Role, Settings,
    Shelf, SkeletonInfo, TaskKind, TaskState, TaskView, TokenInfo, TokenShown, User, Verdict,
};
use serde_json::{Value, json};

use crate::deployment::stream;
use crate::support::{
    CLIPS, Client, DAY, MINUTE, Site, agent, event, from_json, masks, pair, send, style, submit,
    with,
};

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
    let people = [None, Some("ann"), Some("eve"), Some("boss")];
    let people = people.map(|name| name.map(|name| site.person(name)));
    let mut walked = 0;
    for route in ROUTES {
        // Skip logout, which would end the session, and streams, which never end.
        let url = site.url(&filled(route.path));
        for client in &people {
            if route.path.ends_with("/stream") && client.is_some() {
                continue;
            }
            let role = client.as_ref().map(|client| client.user.role);
            let bearer = client
                .as_ref()
                .map(|client| format!("Bearer {}", client.token));
            let origin = site.url("");
            let mut headers = vec![("x-annotate", "1"), ("origin", origin.as_str())];
            headers.extend(bearer.as_deref().map(|bearer| ("authorization", bearer)));
            let body = (route.method != "GET" && route.method != "DELETE").then_some(&b"{}"[..]);
            let answered = send(&agent(), route.method, &url, &headers, body);
            let asked = format!(
                "{} {} as {role:?}: {}",
                route.method, route.path, answered.status
            );
            let refused = answered.status == 401 || answered.status == 403;
            let let_in = match (route.role, role) {
                (None, _) => true,
                (Some(_), None) => false,
                (Some(needed), Some(role)) => role >= needed,
            };
            let by_login = route.path == "/api/v1/session" && route.method == "POST";
            assert!(by_login || refused != let_in, "{asked}");
            if !let_in {
                let expected = match role {
                    None => Code::Unauthenticated,
                    Some(_) => Code::Forbidden,
                };
                assert_eq!(answered.code(), expected, "{asked}");
            }
            walked += 1;
        }
    }
    assert!(walked > 150, "{walked} were walked");
}

/// The cookie of a browser session.
fn log_in(site: &Site, client: &Client) -> String {
    let answered = site.log_in(&client.token, &[]);
    let cookie = answered.cookie().to_owned();
    let me: Me = answered.ok();
    assert_eq!(me.user.id, client.user.id);
    for part in ["HttpOnly", "SameSite=Strict", "Path=/"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    cookie.split(';').next().expect("a pair").to_owned()
}

#[test]
fn a_session_belongs_to_one_store() {
    let (one, two) = (Site::new(), Site::new());
    let cookies = [&one, &two].map(|site| log_in(site, &site.person("ann")));
    let names = cookies.each_ref().map(|cookie| cookie.split('=').next());
    // Browsers send cookies of one host to all its ports.
    assert_ne!(names[0], names[1]);
    let both = cookies.join("; ");
    for site in [&one, &two] {
        let me: Me = site.get_with("/api/v1/me", &[("cookie", &both)]).ok();
        assert_eq!(me.store, site.store.id().expect("an id"));
    }
}

#[test]
fn requests_of_another_site_change_nothing() {
    let site = Site::new();
    let ann = site.person("ann");
    let cookie = log_in(&site, &ann);
    let own = site.url("");
    let before = site.store.last_seq().expect("a place");
    let body = Some(&br#"{"kind":"mask_text"}"#[..]);
    for route in ROUTES.iter().filter(|route| route.method != "GET") {
        let url = site.url(&filled(route.path));
        let marked = ("x-annotate", "1");
        let cases: [(&[(&str, &str)], Code); 4] = [
            (&[("origin", &own)], Code::Csrf),
            (&[marked], Code::WrongOrigin),
            (
                &[marked, ("origin", "http://evil.example")],
                Code::WrongOrigin,
            ),
            (&[marked, ("origin", "null")], Code::WrongOrigin),
        ];
        for (headers, expected) in cases {
            let headers = [headers, &[("cookie", cookie.as_str())]].concat();
            let answered = send(&agent(), route.method, &url, &headers, body);
            assert_eq!(answered.code(), expected, "{} {}", route.method, route.path);
        }
    }
    assert_eq!(site.store.last_seq().expect("a place"), before);
    let fine = [
        ("cookie", cookie.as_str()),
        ("x-annotate", "1"),
        ("origin", &own),
    ];
    let ask = |method, path: &str, body| send(&agent(), method, &site.url(path), &fine, body);
    let next: Next = ask("POST", "/api/v1/queue/next", body).ok();
    assert!(next.task.is_some());
    assert_eq!(ask("DELETE", "/api/v1/session", None).status, 204);
    let after = site.get_with("/api/v1/me", &[("cookie", &cookie)]);
    assert_eq!(after.code(), Code::Unauthenticated);
}

#[test]
fn every_answer_carries_the_headers_that_keep_a_page_safe() {
    let site = Site::new();
    for path in ["/", "/api/v1/me", "/nothing", "/healthz", "/assets/none.js"] {
        let answered = site.get(path);
        let csp = answered.header("content-security-policy");
        let csp = csp.expect("a policy");
        for rule in [
            "default-src 'none'",
            "script-src 'self'",
            "frame-ancestors 'none'",
            "base-uri 'none'",
        ] {
            assert!(csp.contains(rule), "{path}");
        }
        assert!(!csp.contains("unsafe"));
        assert_eq!(answered.header("x-content-type-options"), Some("nosniff"));
        assert_eq!(answered.header("referrer-policy"), Some("no-referrer"));
    }
}

#[test]
fn logins_are_few_in_a_minute() {
    let site = Site::new();
    let attempt = || site.log_in("guess", &[]);
    for _ in 0..10 {
        assert_eq!(attempt().code(), Code::Unauthenticated);
    }
    let refused = attempt();
    assert_eq!(refused.code(), Code::RateLimited);
    assert_eq!(refused.header("retry-after"), Some("60"));
    site.clock.advance(MINUTE);
    assert_eq!(attempt().code(), Code::Unauthenticated);
}

#[test]
fn a_mask_task_goes_from_claim_to_shelf() {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
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
    let mut drafts = view.suggestions.iter();
    assert!(drafts.any(|draft| draft.parts == ["LEFT_ARM"] && draft.text.is_empty()));

    let lease = view.lease.clone().expect("a lease");
    let renew = format!("leases/{}/renew", lease.id);
    let renewed: Lease = ann.post(&renew, &json!({})).ok();
    assert_eq!(renewed.epoch, lease.epoch);
    let half = event(EventKind::Draft, lease.epoch, 0, masks("half"));
    let drafted = ann.tell(&view, half);
    assert_eq!((drafted.status, drafted.rev), (200, 1));
    let again: TaskView = ann.get(&format!("tasks/{}", view.task.id)).ok();
    let mine = again.mine.as_ref().map(|mine| &mine.answer);
    assert_eq!(mine, Some(&masks("half")));
    let done = ann.tell(&view, submit(&again, masks("waving")));
    assert_eq!(done.state, Some(TaskState::Submitted));

    let review = eve.review().expect("a review");
    assert_eq!(review.candidates[0].author_name, "ann");
    assert!(review.candidates[0].joints.contains(&16));
    let (task, epoch) = (review.task.id, review.lease.epoch);
    let author = json!({ "author": ann.user.id });
    let decided: ReviewDone = eve.decide(task, epoch, Decision::Accept, author).ok();
    assert_eq!(decided.state, TaskState::Accepted);
    let shelf: Shelf = ann.get("shelf?kind=mask_text&part=LEFT_ARM&q=waving").ok();
    assert_eq!(shelf.items.len(), 1);
    let none: Shelf = ann.get("shelf?q=100%25").ok();
    assert!(none.items.is_empty());
    let history: Vec<AuditEntry> = eve.get(&format!("tasks/{task}/history")).ok();
    let kinds: Vec<&str> = history.iter().map(|entry| entry.kind.as_str()).collect();
    let expected = "imported claimed renewed draft_saved submitted claimed accepted";
    assert_eq!(kinds.join(" "), expected);
}

#[test]
fn pairs_and_styles_are_answered_too() {
    let site = Site::new();
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::Pair);
    assert_eq!(view.task.hint.as_deref(), Some("raise the arm higher"));
    let bundle = view.task.bundle.clone().expect("a bundle");
    assert_eq!(bundle.tasks.len(), 8);
    assert!(bundle.tasks.iter().all(|item| item.leased));
    ann.answer(pair(Verdict::Unnatural));
    ann.answer(pair(Verdict::Keep));
    ann.answer(style());
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
    let ann = site.person("ann");
    let view = ann.claim(TaskKind::MaskText);
    let hash = &view.task.motions[0].hash;
    let answered = ann.get(&format!("motions/{hash}/joints"));
    let cache = answered.header("cache-control");
    assert_eq!(cache, Some("private, max-age=31536000, immutable"));
    let joints = answered.floats();
    assert_eq!(joints.len(), view.task.motions[0].frames * 28 * 3);
    let heat = ann.get(&format!("motions/{hash}/heat")).floats();
    assert_eq!(heat.len(), 5 * view.task.motions[0].frames);
    assert!(heat.iter().all(|value| value.is_finite() && *value >= 0.0));
    let partners: Vec<MotionInfo> = ann.get(&format!("motions/partners?of={hash}&n=4")).ok();
    assert_eq!(partners.len(), 4);
    let apart = |other: &MotionInfo| other.split == "train" && other.hash != *hash;
    assert!(partners.iter().all(apart));
    // Blends the left arm, with changes to the request.
    let blend = |change: Value| {
        let request =
            json!({ "src": hash, "tgt": partners[0].hash, "parts": ["LEFT_ARM"], "alpha": 0.5 });
        ann.post("blend", &with(request, change))
    };
    let blended = blend(json!({})).floats();
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
    // A joint of the ring can be excluded.
    let without = |joint: &str| json!({ "joints": [{ "joint": joint, "weight": "none" }] });
    let without_ring = blend(json!({ "soft": false })).floats();
    assert_eq!(blend(without("left_collar")).floats(), without_ring);
    for wrong in [
        without("tail"),
        json!({ "alpha": 1.5 }),
        json!({ "parts": ["TAIL"] }),
    ] {
        assert_eq!(blend(wrong).code(), Code::Invalid);
    }
    assert_eq!(ann.get("motions/none/joints").code(), Code::NotFound);
}

#[test]
fn what_is_somebody_elses_is_not_found() {
    let site = Site::new();
    let [ann, bob] = site.people(["ann", "bob"]);
    let view = ann.claim(TaskKind::MaskText);
    let (task, lease) = (view.task.id, view.lease.expect("a lease"));
    let events = format!("tasks/{task}/events");
    let draft =
        |text: &str| json!({ "events": [event(EventKind::Draft, lease.epoch, 0, masks(text))] });
    let stolen = draft("stolen").to_string();
    for (method, path, body) in [
        ("GET", format!("tasks/{task}"), None),
        ("POST", format!("tasks/{task}/claim"), Some("{}")),
        ("POST", events.clone(), Some(stolen.as_str())),
        ("DELETE", format!("leases/{}", lease.id), None),
        ("GET", "tasks/999999".to_owned(), None),
        ("GET", "tasks/nonsense".to_owned(), None),
    ] {
        let answered = bob.call(method, &path, body.map(str::as_bytes));
        assert_eq!(answered.code(), Code::NotFound, "{method} {path}");
    }
    let renewal = bob.post(&format!("leases/{}/renew", lease.id), &json!({}));
    assert_eq!(renewal.code(), Code::LeaseLost);
    // Idempotency keys of different users do not collide.
    let shared = draft("ann's");
    assert_eq!(ann.post(&events, &shared).status, 200);
    assert_eq!(bob.post(&events, &shared).code(), Code::NotFound);
    let prefs: Prefs = bob.get("prefs").ok();
    assert_eq!(prefs, Prefs::default());
}

#[test]
fn malformed_requests_are_refused_by_name() {
    let site = Site::new();
    let ann = site.person("ann");
    let boss = site.person("boss");
    let view = ann.claim(TaskKind::MaskText);
    let path = format!("tasks/{}/events", view.task.id);
    let draft = event(EventKind::Draft, 0, 0, masks("much"));
    let one = json!({ "kind": "mask_text", "masks": [{ "parts": ["LEFT_ARM"], "text": "one" }] });
    for (answer, expected) in [
        (pair(Verdict::Keep), Code::Invalid),
        (from_json(one), Code::MaskCount),
    ] {
        let result = ann.tell(&view, submit(&view, answer));
        assert_eq!(result.problem.expect("a problem").code, expected);
    }
    // A parameter without a value is ignored.
    let _: Shelf = ann.get("shelf?kind=&q=&limit=").ok();
    let next = |body: Value| ann.post("queue/next", &body);
    let raw = |method: &str, path: &str, body: &[u8]| ann.call(method, path, Some(body));
    let user = |name: &str| json!({ "name": name, "role": "annotator" });
    let suggest = format!("tasks/{}/suggest", view.task.id);
    let script = br#"{"keys":{"undo":["<script>"]}}"#;
    for (expected, answers) in [
        (
            Code::BadRequest,
            vec![
                next(json!({ "kind": "mask_text", "more": 1 })),
                next(json!({ "kind": "nothing" })),
                raw("POST", "queue/next", b"{"),
                ann.get("shelf?kind=nothing"),
                ann.get("shelf?colour=red"),
                ann.get("shelf?limit=ten"),
                ann.get("shelf?q=%zz"),
                boss.post("imports?format=nothing", &json!({})),
                boss.get("audit?kind=drop%20table"),
            ],
        ),
        (
            Code::Invalid,
            vec![
                ann.post(&path, &json!({ "events": [] })),
                ann.post(&path, &json!({ "events": vec![draft; 65] })),
                raw("PUT", "prefs", script),
                boss.post("users", &user("ann")),
                boss.post("users", &user(" ")),
            ],
        ),
        (Code::NotFound, vec![ann.get("nothing")]),
        (Code::MethodNotAllowed, vec![raw("PATCH", "me", b"{}")]),
        (
            Code::TooLarge,
            vec![raw("POST", "queue/next", &vec![b' '; 300_000])],
        ),
        (
            Code::NoModel,
            vec![ann.post(&suggest, &json!({ "parts": ["HEAD"] }))],
        ),
    ] {
        for answered in answers {
            assert_eq!(answered.code(), expected);
        }
    }
}

#[test]
fn an_admin_adds_people_changes_settings_and_reads_the_log() {
    let site = Site::new();
    let boss = site.person("boss");
    let new = json!({ "name": "new", "role": "annotator" });
    let shown: TokenShown = boss.post("users", &new).ok();
    let new = Client {
        base: boss.base.clone(),
        user: shown.user.clone(),
        token: shown.token,
        agent: agent(),
    };
    let me: Me = new.get("me").ok();
    assert_eq!(me.user.name, "new");
    let user = format!("users/{}", new.user.id);
    let tokens: Vec<TokenInfo> = boss.get(&format!("{user}/tokens")).ok();
    assert_eq!(tokens.len(), 1);
    let revoked = boss.delete(&format!("tokens/{}", tokens[0].id));
    assert_eq!(revoked.status, 204);
    assert_eq!(new.get("me").code(), Code::Unauthenticated);
    let days = json!({ "days": 5 });
    let again: TokenShown = boss.post(&format!("{user}/tokens"), &days).ok();
    assert_eq!(again.expires, site.clock.now() + 5 * DAY);
    let promotion = Some(&br#"{"role":"reviewer"}"#[..]);
    let changed: User = boss.call("PATCH", &user, promotion).ok();
    assert_eq!(changed.role, Role::Reviewer);
    let mut settings: Settings = boss.get("settings").ok();
    settings.min_masks = 1;
    let kept: Settings = boss.put("settings", &settings).ok();
    assert_eq!(kept, settings);
    settings.gold_percent = 200;
    assert_eq!(boss.put("settings", &settings).code(), Code::Invalid);
    let audit: Audit = boss.get("audit?kind=role_changed&limit=2").ok();
    assert_eq!(audit.entries.len(), 2);
    assert!(audit.next.is_some());
    let users: Vec<User> = boss.get("users").ok();
    assert!(users.len() >= 3);
    let _: Vec<Job> = boss.get("jobs").ok();
}

#[test]
fn the_dashboard_counts_tasks_and_people() {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
    ann.answer(masks("waving"));
    ann.answer(pair(Verdict::Keep));
    let funnel: Funnel = eve.get("stats/funnel").ok();
    assert_eq!(funnel.counts[&TaskKind::MaskText][&TaskState::Submitted], 1);
    assert_eq!(funnel.weeks.last().map(|week| week.submitted), Some(2));
    let people: Vec<Person> = eve.get("stats/people").ok();
    let me = people.iter().find(|person| person.user.name == "ann");
    let me = me.expect("ann");
    let figures = (me.done, me.median_secs, me.agreement);
    assert_eq!(figures, (2, Some(12.5), None));
    let agreement: Agreement = eve.get("stats/agreement").ok();
    assert_eq!((agreement.shared_items, agreement.jaccard), (0, None));
    let quota: Vec<QuotaRow> = eve.get("stats/quota").ok();
    assert_eq!((quota[0].category.as_str(), quota[0].kept), ("wave", 1));
    let leases: Vec<HeldLease> = eve.get("leases").ok();
    assert_eq!(leases.len(), 7, "the rest of the bundle");
}

#[test]
fn metrics_speak_of_requests() {
    let site = Site::new();
    let ann = site.person("ann");
    ann.claim(TaskKind::MaskText);
    let refused = site.get("/metrics").code();
    assert_eq!(refused, Code::Unauthenticated, "not even from loopback");
    let bearer = format!("Bearer {}", site.person("boss").token);
    let answered = site.get_with("/metrics", &[("authorization", &bearer)]);
    let text = answered.text();
    assert!(text.contains(
        "annotate_requests_total{method=\"POST\",path=\"/api/v1/queue/next\",status=\"200\"} 1"
    ));
    for path in ["/healthz", "/readyz"] {
        assert_eq!(site.get(path).status, 200);
    }
}

#[test]
fn the_stream_tells_reviewers_all_and_annotators_what_is_theirs() {
    let site = Site::new();
    let [ann, bob, eve] = site.people(["ann", "bob", "eve"]);
    let (mut to_bob, mut to_eve) = (stream(&bob), stream(&eve));
    let hers = ann.claim(TaskKind::MaskText).task.id;
    let his = bob.claim(TaskKind::MaskText).task.id;
    fn first(mut lines: impl Iterator<Item = String>) -> Change {
        let data = lines.find_map(|line| line.strip_prefix("data: ").map(str::to_owned));
        serde_json::from_str(&data.expect("a change")).expect("a change")
    }
    let change = first(&mut to_bob);
    assert_eq!((change.task, change.mine), (Some(his), true));
    let change = first(&mut to_eve);
    let said = (change.task, change.mine, change.kind.as_str());
    assert_eq!(said, (Some(hers), false, "claimed"));
}
