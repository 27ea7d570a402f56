//! The HTTP API: response shapes, roles, errors.

use annotate::http::ROUTES;
use annotate::wire::{
    Agreement, Audit, AuditEntry, Code, Decision, EventKind, Funnel, Guide, HeldLease, Home, Job,
    Lease, Me, MotionInfo, Next, Person, Prefs, QuotaRow, ReviewDone, Role, Settings, Shelf,
    SkeletonInfo, TaskKind, TaskState, TaskView, TokenInfo, TokenShown, User, Verdict,
};
use serde_json::{Value, json};

use crate::deployment::session;
use crate::support::{
    CLIPS, Client, DAY, Site, agent, event, from_json, masks, pair, send, style, submit, with,
};

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
    let origin = site.url("");
    let people = [None, Some("ann"), Some("eve"), Some("boss")];
    let people = people.map(|name| name.map(|name| site.person(name)));
    let mut walked = 0;
    for route in ROUTES {
        let url = site.url(&filled(route.path));
        let body = (route.method != "GET" && route.method != "DELETE").then_some(&b"{}"[..]);
        for client in people.each_ref().map(Option::as_ref) {
            // Streams never end.
            if route.path.ends_with("/stream") && client.is_some() {
                continue;
            }
            let role = client.map(|client| client.user.role);
            let bearer = client.map(|client| format!("Bearer {}", client.token));
            let mut headers = vec![("x-annotate", "1"), ("origin", origin.as_str())];
            headers.extend(bearer.as_deref().map(|bearer| ("authorization", bearer)));
            let answered = send(&agent(), route.method, &url, &headers, body);
            let status = answered.status;
            let asked = format!("{} {} as {role:?}: {status}", route.method, route.path);
            let is_let_in = |needed: Role| role.is_some_and(|role| role >= needed);
            let is_let_in = route.role.is_none_or(is_let_in);
            let by_login = route.path == "/api/v1/session" && route.method == "POST";
            assert!(
                by_login || matches!(status, 401 | 403) != is_let_in,
                "{asked}"
            );
            if !is_let_in {
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

#[test]
fn a_session_belongs_to_one_store() {
    let (one, two) = (Site::new(), Site::new());
    let cookies = [&one, &two].map(|site| session(site, &site.person("ann").token).0);
    let names = cookies.each_ref().map(|cookie| cookie.split('=').next());
    // Browsers send cookies of one host to all its ports.
    assert_ne!(names[0], names[1]);
    let both = cookies.join("; ");
    for site in [&one, &two] {
        let me: Me = site.get_with("/api/v1/me", &[("cookie", &both)]).ok();
        let id = site.store.id().expect("an id");
        assert_eq!((me.store, me.user.name.as_str()), (id, "ann"));
    }
}

#[test]
fn requests_of_another_site_change_nothing() {
    let site = Site::new();
    let (cookie, _) = session(&site, &site.person("ann").token);
    let (cookie, own) = (("cookie", cookie.as_str()), site.url(""));
    let (marked, own) = (("x-annotate", "1"), ("origin", own.as_str()));
    let before = site.store.last_seq().expect("a place");
    let body = Some(&br#"{"kind":"mask_text"}"#[..]);
    for route in ROUTES.iter().filter(|route| route.method != "GET") {
        let url = site.url(&filled(route.path));
        for (headers, expected) in [
            (vec![cookie, own], Code::Csrf),
            (vec![cookie, marked], Code::WrongOrigin),
            (
                vec![cookie, marked, ("origin", "http://evil.example")],
                Code::WrongOrigin,
            ),
            (vec![cookie, marked, ("origin", "null")], Code::WrongOrigin),
        ] {
            let answered = send(&agent(), route.method, &url, &headers, body);
            assert_eq!(answered.code(), expected, "{} {}", route.method, route.path);
        }
    }
    assert_eq!(site.store.last_seq().expect("a place"), before);
    let fine = [cookie, marked, own];
    let ask = |method, path: &str, body| send(&agent(), method, &site.url(path), &fine, body);
    let next: Next = ask("POST", "/api/v1/queue/next", body).ok();
    assert!(next.task.is_some());
    assert_eq!(ask("DELETE", "/api/v1/session", None).status, 204);
    let after = site.get_with("/api/v1/me", &[cookie]);
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
    ann.answer(style());
    let empty = ann.next(TaskKind::Style).empty.expect("nothing is left");
    assert_eq!((empty.total, empty.done), (1, 1));
    let none: Shelf = ann.get("shelf?q=100%25").ok();
    assert!(none.items.is_empty());
    let history: Vec<AuditEntry> = eve.get(&format!("tasks/{task}/history")).ok();
    let kinds: Vec<&str> = history.iter().map(|entry| entry.kind.as_str()).collect();
    let expected = "imported claimed renewed draft_saved submitted claimed accepted";
    assert_eq!(kinds.join(" "), expected);
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
    let answered = ann.get(&format!("motions/{hash}/heat"));
    // Activity is relative to the other clips, so no cache may keep it.
    assert_eq!(answered.header("cache-control"), Some("no-store"));
    let heat = answered.floats();
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
    // A joint of the ring can be excluded.
    let without = |joint: &str| json!({ "joints": [{ "joint": joint, "weight": "none" }] });
    let without_ring = blend(json!({ "soft": false })).floats();
    assert_eq!(blend(without("left_collar")).floats(), without_ring);
    // Only the masked arm moves; without the ring the shoulder stays where it is.
    for (blended, allowed) in [
        (blend(json!({})).floats(), &[13, 16, 18, 20, 24, 25][..]),
        (without_ring, &[18, 20, 24, 25]),
    ] {
        assert_eq!(blended.len(), joints.len());
        let moves = |joint: &usize| {
            let mut places = (0..40).map(|frame| (frame * 28 + joint) * 3);
            places.any(|at| blended[at..at + 3] != joints[at..at + 3])
        };
        let moved: Vec<usize> = (0..28).filter(moves).collect();
        assert!(!moved.is_empty());
        assert!(
            moved.iter().all(|joint| allowed.contains(joint)),
            "{moved:?}"
        );
    }
    for wrong in [
        without("tail"),
        json!({ "alpha": 1.5 }),
        json!({ "parts": ["TAIL"] }),
    ] {
        assert_eq!(blend(wrong).code(), Code::Invalid);
    }
    assert_eq!(ann.get("motions/none/joints").code(), Code::NotFound);
    let pair = ann.claim(TaskKind::Pair).task;
    assert_eq!(pair.hint.as_deref(), Some("raise the arm higher"));
    let difference = |align: &str| {
        ann.get(&format!("pairs/{}/diff?align={align}", pair.id))
            .floats()
    };
    let rows = difference("none");
    assert_eq!((rows.len(), difference("stretch").len()), (6 * 40, 6 * 40));
    assert!(rows.iter().any(|apart| *apart > 0.01));
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
    let [ann, boss] = site.people(["ann", "boss"]);
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
    let raw = |method: &str, path: &str, body: &[u8]| ann.call(method, path, Some(body));
    let next = |body: &[u8]| raw("POST", "queue/next", body);
    let user = |name: &str| boss.post("users", &json!({ "name": name, "role": "annotator" }));
    let suggest = format!("tasks/{}/suggest", view.task.id);
    for (expected, answers) in [
        (
            Code::BadRequest,
            vec![
                next(br#"{"kind":"mask_text","more":1}"#),
                next(br#"{"kind":"nothing"}"#),
                next(br#"{"kind":"mask_text"} trailing"#),
                next(b"{"),
                next("[".repeat(100_000).as_bytes()),
                next(b"\xff\xfe"),
                next(b"null"),
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
                raw("PUT", "prefs", br#"{"keys":{"undo":["<script>"]}}"#),
                user("ann"),
                user(" "),
            ],
        ),
        (Code::NotFound, vec![ann.get("nothing")]),
        (Code::MethodNotAllowed, vec![raw("PATCH", "me", b"{}")]),
        (Code::TooLarge, vec![next(&vec![b' '; 300_000])]),
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
    let was: Settings = boss.get("settings").ok();
    let mut settings = was.clone();
    settings.min_masks = 1;
    let kept: Settings = boss.put_settings(&was, &settings).ok();
    assert_eq!(kept, settings);
    settings.gold_percent = 200;
    let refused = boss.put_settings(&kept, &settings);
    assert_eq!(refused.code(), Code::Invalid);
    // Two people read the settings, and then both change them. Both changes are kept unless they are of one setting.
    let change = |text: &str, of: fn(&mut Settings) -> &mut String| {
        let mut now = was.clone();
        text.clone_into(of(&mut now));
        boss.put_settings(&was, &now)
    };
    let kept: Settings = change("Gaits", |settings| &mut settings.name).ok();
    assert_eq!((kept.min_masks, kept.name.as_str()), (1, "Gaits"));
    let refused = change("Runs", |settings| &mut settings.name).problem();
    let said = (refused.code, refused.field.as_deref());
    assert_eq!(said, (Code::SettingChanged, Some("name")));
    let kept: Settings = change("Be quick.", |settings| &mut settings.guide).ok();
    assert_eq!(
        (kept.name.as_str(), kept.guide.as_str()),
        ("Gaits", "Be quick.")
    );
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
    let leases: Vec<HeldLease> = eve.get("leases").ok();
    assert_eq!(leases.len(), 7, "the rest of the bundle");
    site.set(|settings| (settings.quota, settings.category_quota) = (3, 5));
    let quota: Vec<QuotaRow> = eve.get("stats/quota").ok();
    let [row] = quota.as_slice() else {
        panic!("{}", json!(quota));
    };
    let counts = (row.kept, row.wanted, row.category_wanted);
    assert_eq!((row.category.as_str(), counts), ("wave", (1, 3, 5)));
}

#[test]
fn metrics_speak_of_requests() {
    let site = Site::new();
    site.person("ann").claim(TaskKind::MaskText);
    let refused = site.get("/metrics").code();
    assert_eq!(refused, Code::Unauthenticated, "not even from loopback");
    let bearer = format!("Bearer {}", site.person("boss").token);
    let answered = site.get_with("/metrics", &[("authorization", &bearer)]);
    let words = r#"requests_total{method="POST",path="/api/v1/queue/next",status="200"} 1"#;
    let text = answered.text();
    assert!(text.contains(&format!("annotate_{words}")), "{text}");
}

#[test]
fn a_blind_answer_that_came_back_shows_no_suggestions_before_it_is_claimed() {
    let site = Site::new();
    let [ann, eve] = site.people(["ann", "eve"]);
    let shown = |task: i64| -> (bool, usize) {
        let view: TaskView = ann.get(&format!("tasks/{task}")).ok();
        (view.blind, view.suggestions.len())
    };
    let task = ann.answer(masks("waving"));
    assert!(matches!(shown(task), (false, 1..)));
    site.set(|settings| settings.blind_percent = 100);
    let task = ann.answer(masks("hopping"));
    let reviews = std::iter::from_fn(|| eve.review());
    for review in reviews.take(2) {
        let note = json!({ "comment": "Which hand?" });
        let done = eve.decide(review.task.id, review.lease.epoch, Decision::Return, note);
        assert_eq!(done.status, 200);
    }
    assert_eq!(shown(task), (true, 0));
}
