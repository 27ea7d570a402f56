//! Test fixtures: a small dataset, a server on a free port with a manual clock, and clients.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

use annotate::http::{PATIENCE, Server, ServerConfig, UPLOAD_PATIENCE};
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::store::{KeyRange, MotionRecord, NewTask, Store, TokenUse, open_sqlite};
use annotate::transfer::from_dataset;
use annotate::wire::{
    Answer, EditType, EventKind, MaskAnswer, NewEvent, Next, Problem, Role, Settings, TaskKind,
    TaskView, User, Verdict,
};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Caption;
use datasets_spec::{BodyPart, Fps, MASK_DEF_VERSION, Motion, MotionId, Pose, Skeleton, Split};
use glam::DVec3;
use kinematics::rotation::from_axis_angle;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Start time of every test's clock.
pub(crate) const START: i64 = 1_700_000_000_000;
pub(crate) const MINUTE: i64 = 60_000;
/// Number of clips of the dataset.
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
    let skeleton = Skeleton::smplx_neutral();
    commit_rows(
        root,
        &rows,
        Some(|row: &MotionRow| row.split),
        &skeleton,
        "motions",
        "test",
    )
    .expect("motions");
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
    commit_rows(
        root,
        &[mask],
        Some(|row: &MaskRow| row.split),
        &skeleton,
        "masks",
        "test",
    )
    .expect("masks");
    let pair = |number: usize, kind: &str, style: Option<&str>| PairRow {
        id: format!("{kind}{number}"),
        split: Split::Train,
        source: "test".to_owned(),
        kind: kind.to_owned(),
        source_id: rows[number].id.clone(),
        target_id: rows[number + 1].id.clone(),
        style: style.map(str::to_owned),
        parts: Vec::new(),
        instruction: if style.is_some() {
            String::new()
        } else {
            "raise the arm higher".to_owned()
        },
        edit_type: None,
        accepted_by: None,
    };
    let mut pairs: Vec<PairRow> = (0..9)
        .map(|number| pair(number, "fine-grained", None))
        .collect();
    pairs.push(pair(10, "style", Some("proud")));
    commit_rows(
        root,
        &pairs,
        Some(|row: &PairRow| row.split),
        &skeleton,
        "pairs",
        "test",
    )
    .expect("pairs");
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
        Self::with_model(None)
    }

    pub(crate) fn with_model(model: Option<Model>) -> Self {
        Self::with(|config| config.model = model)
    }

    /// A server with this request timeout.
    pub(crate) fn with_patience(patience: Duration) -> Self {
        Self::with(|config| config.patience = patience)
    }

    /// A server with changed settings.
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

    /// Adds a user and returns a client for them.
    pub(crate) fn person(&self, name: &str, role: Role) -> Client {
        person(&self.store, &self.url(""), name, role, self.clock.now())
    }
}

/// Adds a user and returns a client for them.
pub(crate) fn person(store: &Store, base: &str, name: &str, role: Role, now: i64) -> Client {
    let user = store.add_user(None, name, role, now).expect("a user");
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

/// Starts a server on a store.
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
        clock: Arc::new(move || hands.now()),
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

/// Settings without random draws: drafts on every task, and no gold tasks.
pub(crate) fn plain_settings(store: &Store) {
    let admin = store
        .add_user(None, "root", Role::Admin, START)
        .expect("an admin");
    let settings = Settings {
        blind_percent: 0,
        gold_percent: 0,
        overlap_percent: 100,
        answers_per_task: 1,
        ..Settings::default()
    };
    store
        .put_settings(admin.id, settings, START)
        .expect("settings");
}

static KEYS: AtomicU64 = AtomicU64::new(0);

/// A new idempotency key.
pub(crate) fn key() -> String {
    format!("test-key-{}", KEYS.fetch_add(1, Ordering::Relaxed))
}

/// A response.
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

    pub(crate) fn problem(&self) -> Problem {
        assert_eq!(
            self.headers
                .get("content-type")
                .and_then(|value| value.to_str().ok()),
            Some("application/problem+json")
        );
        let problem: Problem = self.json();
        assert_eq!(problem.status, self.status);
        problem
    }

    pub(crate) fn floats(&self) -> Vec<f32> {
        assert_eq!(self.status, 200);
        self.body
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect()
    }
}

/// Sends a request with these headers.
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

/// A user with a token.
pub(crate) struct Client {
    pub(crate) base: String,
    pub(crate) user: User,
    pub(crate) token: String,
    pub(crate) agent: ureq::Agent,
}

impl Client {
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

    pub(crate) fn next(&self, kind: TaskKind) -> Next {
        self.post("queue/next", &serde_json::json!({ "kind": kind }))
            .ok()
    }

    pub(crate) fn claim(&self, kind: TaskKind) -> TaskView {
        self.next(kind).task.expect("a task")
    }

    /// Claims a task of the kind and submits an answer.
    pub(crate) fn answer(&self, kind: TaskKind, answer: Answer) -> i64 {
        let view = self.claim(kind);
        let event = submit(&view, answer);
        let results: annotate::wire::EventResults = self
            .post(
                &format!("tasks/{}/events", view.task.id),
                &serde_json::json!({ "events": [event] }),
            )
            .ok();
        assert_eq!(
            results.results[0].status, 200,
            "{:?}",
            results.results[0].problem
        );
        view.task.id
    }
}

/// A submit event.
pub(crate) fn submit(view: &TaskView, answer: Answer) -> NewEvent {
    event(
        EventKind::Submit,
        view.lease.as_ref().map_or(0, |lease| lease.epoch),
        view.mine.as_ref().map_or(0, |mine| mine.rev),
        Some(answer),
    )
}

pub(crate) fn event(
    kind: EventKind,
    lease_epoch: i64,
    base_rev: i64,
    answer: Option<Answer>,
) -> NewEvent {
    NewEvent {
        idem_key: key(),
        kind,
        lease_epoch,
        base_rev,
        answer,
        reason: None,
        note: String::new(),
        suggestion: None,
        used: None,
        secs: 12.5,
    }
}

/// An answer of two masks.
pub(crate) fn masks(text: &str) -> Answer {
    let mask = |part: &str, text: String| MaskAnswer {
        parts: vec![part.to_owned()],
        soft: true,
        joints: Vec::new(),
        range: None,
        text,
        suggestion: None,
    };
    Answer::MaskText {
        masks: vec![
            mask("LEFT_ARM", text.to_owned()),
            mask("LOWER_BODY", format!("{text}, walking")),
        ],
        count_reason: None,
        note: String::new(),
    }
}

pub(crate) fn pair(verdict: Verdict) -> Answer {
    let keep = verdict == Verdict::Keep;
    Answer::Pair {
        verdict,
        parts: if keep {
            vec!["RIGHT_ARM".to_owned()]
        } else {
            Vec::new()
        },
        edit_type: keep.then_some(EditType::Amplitude),
        text: if keep {
            "higher".to_owned()
        } else {
            String::new()
        },
        suggestion: None,
        note: String::new(),
    }
}

pub(crate) fn style() -> Answer {
    Answer::Style {
        verdict: Verdict::Keep,
        parts: Vec::new(),
        style: Some("proud".to_owned()),
        extent: Some(annotate::wire::Extent::Upper),
        text: "more proudly".to_owned(),
        suggestion: None,
        note: String::new(),
    }
}

/// The range that holds every task.
pub(crate) fn all_keys() -> KeyRange {
    KeyRange {
        after: String::new(),
        up_to: char::MAX.to_string(),
    }
}

/// A task without a dataset behind it.
pub(crate) fn bare_task(number: usize, kind: TaskKind) -> NewTask {
    NewTask {
        key: format!("task{number:06}"),
        kind,
        source: "hash".to_owned(),
        target: None,
        split: "train".to_owned(),
        bundle: None,
        bundle_index: 0,
        category: None,
        hint: None,
        style: None,
        edit_type: None,
        priority: 0,
        gold: None,
        extra: None,
        suggestions: Vec::new(),
        accepted: None,
        credit: None,
    }
}

/// The motion of [`bare_task`].
pub(crate) fn bare_motion() -> MotionRecord {
    MotionRecord {
        hash: "hash".to_owned(),
        id: "motion".to_owned(),
        split: "train".to_owned(),
        frames: 40,
        fps: 20.0,
        captions: Vec::new(),
        style: None,
        action: None,
    }
}

/// Sizes of a test, such as `50x200x100000`, that a variable sets.
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
