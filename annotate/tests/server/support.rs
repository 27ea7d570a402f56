//! Test fixtures: a small dataset, a server on a free port with a manual clock, and clients.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

use annotate::Error;
use annotate::http::{PATIENCE, Server, ServerConfig, UPLOAD_PATIENCE};
use annotate::motions::MotionLibrary;
use annotate::store::{
    KeyRange, MotionRecord, NewTask, ReviewDetail, Store, TaskDetail, TokenUse, Who, open_sqlite,
};
use annotate::transfer::from_dataset;
use annotate::wire::{
    Answer, Code, Decision, EditType, EventKind, EventResult, EventResults, NewEvent, NewReview,
    Next, Problem, ReviewNext, ReviewQueue, ReviewView, Role, Rule, RuleKind, Settings,
    SettingsChange, TaskKind, TaskView, User, Verdict,
};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Caption, Row};
use datasets_spec::{
    BodyPart, Dataset, Fps, MASK_DEF_VERSION, Motion, MotionId, Pose, Skeleton, Split,
};
use glam::DVec3;
use kinematics::rotation::from_axis_angle;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// Start time of every test's clock.
pub(crate) const START: i64 = 1_700_000_000_000;
pub(crate) const MINUTE: i64 = 60_000;
pub(crate) const HOUR: i64 = 60 * MINUTE;
pub(crate) const DAY: i64 = 24 * HOUR;
pub(crate) const CLIPS: usize = 20;

/// 40 frames in which an arm swings; `variant` makes clips differ.
pub(crate) fn motion(variant: usize) -> Motion {
    let joint = if variant.is_multiple_of(2) { 16 } else { 17 };
    let poses: Vec<Pose> = (0..40)
        .map(|frame| {
            let angle = (0.5 + 0.03 * variant as f64) * (f64::from(frame) * 0.4).sin();
            let mut pose = Pose::REST;
            pose.transl = DVec3::new(0.0, 0.0, 0.02 * f64::from(frame));
            pose.rotations[joint] = from_axis_angle(DVec3::new(angle, 0.0, angle));
            pose
        })
        .collect();
    Motion::from_poses(Fps::STORE, &poses).expect("finite")
}

pub(crate) fn motion_row(id: &str, split: Split, motion: &Motion) -> MotionRow {
    MotionRow {
        source: "test".to_owned(),
        source_path: format!("set/{id}.bvh"),
        captions: vec![Caption {
            text: format!("a person waves, take {id}"),
            ..Caption::default()
        }],
        action: Some("wave".to_owned()),
        ..MotionRow::new(MotionId::parse(id).expect("valid"), split, motion)
    }
}

pub(crate) fn commit<R: Row>(root: &Path, rows: &[R], split: fn(&R) -> Split, plan: &str) {
    let skeleton = Skeleton::smplx_neutral();
    commit_rows(root, rows, Some(split), &skeleton, plan, "test").expect("a table");
}

pub(crate) fn read<R: Row>(root: &Path) -> Vec<R> {
    let dataset = Dataset::open(root).expect("a dataset");
    dataset.read(None).expect("rows")
}

/// A dataset of clips, one automatic mask, nine fine-grained pairs and a style pair.
pub(crate) fn dataset(root: &Path) {
    let rows: Vec<MotionRow> = (0..CLIPS)
        .map(|clip| {
            let split = if clip < CLIPS - 2 {
                Split::Train
            } else {
                Split::Test
            };
            motion_row(&format!("clip{clip:02}"), split, &motion(clip))
        })
        .collect();
    commit(root, &rows, |row| row.split, "motions");
    let arm = BodyPart::LeftArm.mask();
    let mask = MaskRow {
        id: "clip00#LEFT_ARM".to_owned(),
        motion_id: rows[0].id.clone(),
        split: Split::Train,
        parts: vec!["LEFT_ARM".to_owned()],
        hard_joints: arm.hard().names(),
        soft_joints: arm.soft().names(),
        start: None,
        end: None,
        mask_def_version: MASK_DEF_VERSION,
        text: "The person is waving with their left arm.".to_owned(),
        text_origin: "automatic".to_owned(),
        author: "stance-activity-1".to_owned(),
        accepted_by: None,
    };
    commit(root, &[mask], |row| row.split, "masks");
    let pair = |number: usize, kind: &str, style: Option<&str>, instruction: &str| PairRow {
        id: format!("{kind}{number}"),
        split: Split::Train,
        source: "test".to_owned(),
        kind: kind.to_owned(),
        source_id: rows[number].id.clone(),
        target_id: rows[number + 1].id.clone(),
        style: style.map(str::to_owned),
        parts: Vec::new(),
        instruction: instruction.to_owned(),
        edit_type: None,
        accepted_by: None,
    };
    let fine = |number| pair(number, "fine-grained", None, "raise the arm higher");
    let mut pairs: Vec<PairRow> = (0..9).map(fine).collect();
    pairs.push(pair(10, "style", Some("proud"), ""));
    commit(root, &pairs, |row| row.split, "pairs");
}

/// A clock that only the test advances.
#[derive(Clone)]
pub(crate) struct Hands(Arc<AtomicI64>);

impl Hands {
    pub(crate) fn at(millis: i64) -> Self {
        Self(Arc::new(AtomicI64::new(millis)))
    }

    pub(crate) fn now(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }

    pub(crate) fn advance(&self, millis: i64) {
        self.0.fetch_add(millis, Ordering::SeqCst);
    }
}

/// A server with its store and users.
pub(crate) struct Site {
    pub(crate) server: Server,
    pub(crate) store: Arc<Store>,
    pub(crate) clock: Hands,
    pub(crate) dataset: PathBuf,
    pub(crate) folder: tempfile::TempDir,
}

impl Site {
    pub(crate) fn new() -> Self {
        Self::with(|_| {})
    }

    pub(crate) fn with(change: impl FnOnce(&mut ServerConfig)) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path().join("dataset");
        dataset(&root);
        let store = open_sqlite(&folder.path().join("store.sqlite")).expect("a store");
        plain_settings(store.as_ref());
        from_dataset(store.as_ref(), &root, None, START, &mut |_, _| {}).expect("imports");
        let clock = Hands::at(START);
        let server = serve(&store, &clock, &root, folder.path().join("data"), change);
        Self {
            server,
            store,
            clock,
            dataset: root,
            folder,
        }
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.server.address())
    }

    /// The response to a request without a session.
    pub(crate) fn get(&self, path: &str) -> Answered {
        self.get_with(path, &[])
    }

    pub(crate) fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answered {
        send(&agent(), "GET", &self.url(path), headers, None)
    }

    /// Logs in with a token as the page does, with extra headers.
    pub(crate) fn log_in(&self, token: &str, more: &[(&str, &str)]) -> Answered {
        let origin = self.url("");
        let mut headers = vec![("origin", origin.as_str()), ("x-annotate", "1")];
        headers.extend_from_slice(more);
        let body = json!({ "token": token }).to_string();
        let url = self.url("/api/v1/session");
        send(&agent(), "POST", &url, &headers, Some(body.as_bytes()))
    }

    pub(crate) fn person(&self, name: &str) -> Client {
        person(&self.store, &self.url(""), name, self.clock.now())
    }

    pub(crate) fn people<const N: usize>(&self, names: [&str; N]) -> [Client; N] {
        names.map(|name| self.person(name))
    }

    pub(crate) fn set(&self, change: impl FnOnce(&mut Settings)) {
        set(&self.store, change);
    }

    pub(crate) fn whole(&self) {
        whole(&self.store);
    }
}

/// Checks that the tables of a store follow from its log.
pub(crate) fn whole(store: &Store) {
    assert_eq!(store.verify().expect("checks"), Vec::<String>::new());
}

/// Roles in the tests: eve reviews, the boss is an admin, and all others annotate.
pub(crate) fn role(name: &str) -> Role {
    match name {
        "eve" => Role::Reviewer,
        "boss" => Role::Admin,
        _ => Role::Annotator,
    }
}

pub(crate) fn join(store: &Store, name: &str, role: Role) -> i64 {
    let user = store.add_user(None, name, role, START);
    user.expect("a user").id
}

/// The id of a user by name.
pub(crate) fn user_id(store: &Store, name: &str) -> i64 {
    let mut users = store.users().expect("users").into_iter();
    users.find(|user| user.name == name).expect("a user").id
}

/// The user of a request.
pub(crate) fn who(id: i64, role: Role) -> Who {
    Who {
        id,
        name: String::new(),
        role,
    }
}

pub(crate) fn person(store: &Store, base: &str, name: &str, now: i64) -> Client {
    let user = store.add_user(None, name, role(name), now).expect("a user");
    let token = store
        .issue(user.id, TokenUse::Token, i64::MAX, now)
        .expect("a token")
        .token;
    Client {
        base: base.to_owned(),
        user,
        token,
        agent: agent(),
    }
}

pub(crate) fn serve(
    store: &Arc<Store>,
    clock: &Hands,
    dataset: &Path,
    data: PathBuf,
    change: impl FnOnce(&mut ServerConfig),
) -> Server {
    let hands = clock.clone();
    let mut config = ServerConfig {
        listen: ([127, 0, 0, 1], 0).into(),
        operators: None,
        secure: false,
        hosts: Vec::new(),
        trusted_proxies: Vec::new(),
        data,
        dataset: dataset.to_owned(),
        model: None,
        patience: PATIENCE,
        upload_patience: UPLOAD_PATIENCE,
        clock: Arc::new(move || {
            // As with PostgreSQL, whose driver waits in a runtime of its own: that panics inside of a future.
            let runtime = tokio::runtime::Builder::new_current_thread().build();
            runtime.expect("a runtime").block_on(async { hands.now() })
        }),
        log: |text| panic!("the server reports a defect: {text}"),
    };
    change(&mut config);
    let motions = Arc::new(MotionLibrary::open(dataset).expect("motions"));
    Server::start(Arc::clone(store), motions, config).expect("listens")
}

pub(crate) fn agent() -> ureq::Agent {
    ureq::Agent::config_builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .build()
        .new_agent()
}

/// The admin of every store with [`plain_settings`].
pub(crate) const ROOT: i64 = 1;

/// Adds the admin [`ROOT`], and settings without random draws: drafts on every task, one answer to each, no gold tasks.
pub(crate) fn plain_settings(store: &Store) {
    let root = store.add_user(None, "root", Role::Admin, START);
    assert_eq!(root.expect("an admin").id, ROOT);
    set(store, |settings| {
        settings.blind_percent = 0;
        settings.gold_percent = 0;
        settings.overlap_percent = 100;
        settings.answers_per_task = 1;
    });
}

pub(crate) fn set(store: &Store, change: impl FnOnce(&mut Settings)) {
    let was = store.settings().expect("settings");
    let mut now = was.clone();
    change(&mut now);
    let changed = store.change_settings(ROOT, SettingsChange { was, now }, START);
    changed.expect("settings");
}

/// A rule that accepts equal answers of one person or more, and leaves none to reviewers.
pub(crate) fn rule(name: &str, accepts: RuleKind) -> Rule {
    from_json(json!({ "name": name, "enabled": true, "accepts": accepts }))
}

pub(crate) fn refusal<T>(result: Result<T, Error>) -> Code {
    let error = result.err().expect("it is refused");
    error.problem().code
}

static KEYS: AtomicU64 = AtomicU64::new(0);

pub(crate) fn key() -> String {
    format!("test-key-{}", KEYS.fetch_add(1, Ordering::Relaxed))
}

#[derive(Debug)]
pub(crate) struct Answered {
    pub(crate) status: u16,
    pub(crate) headers: ureq::http::HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answered {
    pub(crate) fn json<T: DeserializeOwned>(&self) -> T {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&self.body)))
    }

    pub(crate) fn ok<T: DeserializeOwned>(self) -> T {
        assert_eq!(self.status, 200, "{}", String::from_utf8_lossy(&self.body));
        self.json()
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.get(name)?.to_str().ok()
    }

    pub(crate) fn problem(&self) -> Problem {
        let mime = self.header("content-type");
        assert_eq!(mime, Some("application/problem+json"));
        let problem: Problem = self.json();
        assert_eq!(problem.status, self.status);
        problem
    }

    pub(crate) fn code(&self) -> Code {
        self.problem().code
    }

    pub(crate) fn text(self) -> String {
        String::from_utf8(self.body).expect("text")
    }

    pub(crate) fn floats(&self) -> Vec<f32> {
        assert_eq!(self.status, 200);
        self.body
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect()
    }
}

pub(crate) fn send(
    agent: &ureq::Agent,
    method: &str,
    url: &str,
    headers: &[(&str, &str)],
    body: Option<&[u8]>,
) -> Answered {
    let mut request = ureq::http::Request::builder().method(method).uri(url);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    if body.is_some() {
        // A server that refuses an upload without reading it closes the connection, which then cannot be used again.
        request = request.header("connection", "close");
    }
    let response = match body {
        Some(body) => agent.run(request.body(body).expect("a request")),
        None => agent.run(request.body(()).expect("a request")),
    };
    let mut response = response.unwrap_or_else(|error| panic!("{method} {url}: {error}"));
    Answered {
        status: response.status().as_u16(),
        headers: response.headers().clone(),
        body: response
            .body_mut()
            .with_config()
            .limit(64 << 20)
            .read_to_vec()
            .expect("a body"),
    }
}

pub(crate) struct Client {
    pub(crate) base: String,
    pub(crate) user: User,
    pub(crate) token: String,
    pub(crate) agent: ureq::Agent,
}

impl Client {
    /// The same user on another server of the store.
    pub(crate) fn at(&self, base: String) -> Self {
        Self {
            base,
            user: self.user.clone(),
            token: self.token.clone(),
            agent: agent(),
        }
    }

    pub(crate) fn call(&self, method: &str, path: &str, body: Option<&[u8]>) -> Answered {
        let bearer = format!("Bearer {}", self.token);
        send(
            &self.agent,
            method,
            &format!("{}/api/v1/{path}", self.base),
            &[("authorization", &bearer)],
            body,
        )
    }

    pub(crate) fn get(&self, path: &str) -> Answered {
        self.call("GET", path, None)
    }

    pub(crate) fn post<T: Serialize>(&self, path: &str, body: &T) -> Answered {
        let body = serde_json::to_vec(body).expect("JSON");
        self.call("POST", path, Some(&body))
    }

    pub(crate) fn put<T: Serialize>(&self, path: &str, body: &T) -> Answered {
        let body = serde_json::to_vec(body).expect("JSON");
        self.call("PUT", path, Some(&body))
    }

    /// Asks for the change of the settings from `was` to `now`.
    pub(crate) fn put_settings(&self, was: &Settings, now: &Settings) -> Answered {
        let change = SettingsChange {
            was: was.clone(),
            now: now.clone(),
        };
        self.put("settings", &change)
    }

    pub(crate) fn delete(&self, path: &str) -> Answered {
        self.call("DELETE", path, None)
    }

    pub(crate) fn next(&self, kind: TaskKind) -> Next {
        self.post("queue/next", &json!({ "kind": kind })).ok()
    }

    pub(crate) fn claim(&self, kind: TaskKind) -> TaskView {
        self.next(kind).task.expect("a task")
    }

    pub(crate) fn tell(&self, view: &TaskView, event: NewEvent) -> EventResult {
        let path = format!("tasks/{}/events", view.task.id);
        let sent: EventResults = self.post(&path, &json!({ "events": [event] })).ok();
        sent.results.into_iter().next().expect("a result")
    }

    /// Claims a task of the answer's kind, submits the answer, and returns the task.
    pub(crate) fn answer(&self, answer: Answer) -> i64 {
        let view = self.claim(answer.kind());
        let result = self.tell(&view, submit(&view, answer));
        assert_eq!(result.status, 200, "{:?}", result.problem);
        view.task.id
    }

    /// The next task to review, with its answers.
    pub(crate) fn review(&self) -> Option<ReviewView> {
        let next: ReviewNext = self.post("review/next", &json!({ "queue": "sample" })).ok();
        next.review
    }

    /// Sends a decision about a task, with extra fields.
    pub(crate) fn decide(
        &self,
        task: i64,
        epoch: i64,
        decision: Decision,
        more: Value,
    ) -> Answered {
        let review = json!({
            "idem_key": key(), "task": task, "lease_epoch": epoch, "decision": decision,
        });
        self.post("reviews", &with(review, more))
    }

    /// Accepts the first answer to every task that waits for review. Returns the number of tasks.
    pub(crate) fn accept_all(&self) -> usize {
        let accept = |review: ReviewView| {
            let author = json!({ "author": review.candidates[0].revision.author });
            let (task, epoch) = (review.task.id, review.lease.epoch);
            let done = self.decide(task, epoch, Decision::Accept, author);
            assert_eq!(done.status, 200);
        };
        std::iter::from_fn(|| self.review().map(&accept)).count()
    }
}

pub(crate) fn submit(view: &TaskView, answer: Answer) -> NewEvent {
    event(
        EventKind::Submit,
        view.lease.as_ref().map_or(0, |lease| lease.epoch),
        view.mine.as_ref().map_or(0, |mine| mine.rev),
        answer,
    )
}

pub(crate) fn event(
    kind: EventKind,
    lease_epoch: i64,
    base_rev: i64,
    answer: impl Into<Option<Answer>>,
) -> NewEvent {
    NewEvent {
        idem_key: key(),
        kind,
        lease_epoch,
        base_rev,
        answer: answer.into(),
        reason: None,
        note: String::new(),
        suggestion: None,
        used: None,
        secs: 12.5,
    }
}

/// A decision about all answers to a task.
pub(crate) fn decision(task: i64, lease_epoch: i64, decision: Decision) -> NewReview {
    NewReview {
        idem_key: key(),
        task,
        lease_epoch,
        decision,
        author: None,
        answer: None,
        comment: "because".to_owned(),
        secs: 40.0,
    }
}

/// A document with fields added or replaced.
pub(crate) fn with(mut document: Value, more: Value) -> Value {
    for (name, value) in more.as_object().expect("fields") {
        document[name] = value.clone();
    }
    document
}

/// Parses a value from JSON, in which fields with defaults may be missing.
pub(crate) fn from_json<T: DeserializeOwned>(value: Value) -> T {
    serde_json::from_value(value).expect("all fields")
}

pub(crate) fn masks(text: &str) -> Answer {
    from_json(json!({ "kind": "mask_text", "masks": [
        { "parts": ["LEFT_ARM"], "text": text },
        { "parts": ["LOWER_BODY"], "text": format!("{text}, walking") },
    ] }))
}

pub(crate) fn pair(verdict: Verdict) -> Answer {
    let mut said = json!({ "kind": "pair", "verdict": verdict });
    if verdict == Verdict::Keep {
        said["parts"] = json!(["RIGHT_ARM"]);
        said["edit_type"] = json!("amplitude");
        said["text"] = json!("higher");
    }
    from_json(said)
}

/// An answer that keeps a pair, with this edit type.
pub(crate) fn kept(of_type: EditType) -> Answer {
    let mut answer = pair(Verdict::Keep);
    if let Answer::Pair { edit_type, .. } = &mut answer {
        *edit_type = Some(of_type);
    }
    answer
}

pub(crate) fn style() -> Answer {
    from_json(
        json!({ "kind": "style", "verdict": "keep", "style": "proud", "extent": "upper", "text": "more proudly" }),
    )
}

pub(crate) fn all_keys() -> KeyRange {
    KeyRange {
        after: String::new(),
        up_to: char::MAX.to_string(),
    }
}

/// A task whose motion is in no dataset.
pub(crate) fn bare_task(number: usize, kind: TaskKind) -> NewTask {
    from_json(json!({
        "key": format!("task{number:06}"), "kind": kind, "source": "hash", "split": "train",
        "bundle_index": 0, "priority": 0, "suggestions": [],
    }))
}

pub(crate) fn bare_motion() -> MotionRecord {
    from_json(json!({
        "hash": "hash", "id": "motion", "split": "train", "frames": 40, "fps": 20.0, "captions": [],
    }))
}

/// Claims a task of a kind for a person in a store without a server.
pub(crate) fn claim(store: &Store, user: i64, kind: TaskKind, now: i64) -> Option<TaskDetail> {
    let claimed = store.claim(user, kind, 3, now).expect("claims");
    claimed.ok().map(|(detail, _)| detail)
}

/// An event of a claimed task.
pub(crate) fn event_of(
    detail: &TaskDetail,
    kind: EventKind,
    answer: impl Into<Option<Answer>>,
) -> NewEvent {
    let epoch = detail.lease.as_ref().map_or(0, |lease| lease.epoch);
    let rev = detail.mine.as_ref().map_or(0, |mine| mine.rev);
    event(kind, epoch, rev, answer)
}

/// Sends an event to a store without a server, and checks that the store accepts it.
pub(crate) fn tell(store: &Store, user: i64, task: i64, event: NewEvent, now: i64) -> EventResult {
    let results = store.append(user, task, vec![event], now);
    let result = results.expect("takes events").remove(0);
    assert_eq!(result.status, 200, "{:?}", result.problem);
    result
}

/// The next task to review in a store without a server.
pub(crate) fn review(
    store: &Store,
    reviewer: i64,
    queue: ReviewQueue,
    now: i64,
) -> Option<ReviewDetail> {
    let claimed = store.review_next(reviewer, queue, None, now);
    claimed.expect("claims").ok()
}

/// Writes a line to the terminal past the test runner's capture.
pub(crate) fn say(line: &str) {
    use std::io::Write;
    let _said = writeln!(std::io::stderr().lock(), "{line}");
}

/// Sizes of a test from an environment variable, such as `50x200x100000`.
pub(crate) fn sizes<const N: usize>(variable: &str, otherwise: &str) -> [usize; N] {
    let text = std::env::var(variable).unwrap_or_else(|_| otherwise.to_owned());
    let numbers: Option<Vec<usize>> = text.split('x').map(|number| number.parse().ok()).collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .unwrap_or_else(|| panic!("{variable} must be like {otherwise}"))
}

/// Peak memory of this process in MB since the last call.
pub(crate) fn peak_memory_mb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    let kb: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    Some(kb / 1024)
}
