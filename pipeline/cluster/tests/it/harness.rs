//! Processes of the tests.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};

use serde_json::Value;

const CLUSTER: &str = env!("CARGO_BIN_EXE_stance-cluster");

pub(crate) fn stance() -> PathBuf {
    let set = std::env::var_os("STANCE_BIN").map(PathBuf::from);
    set.expect("STANCE_BIN names the command; pipeline/cluster/check sets it")
}

/// Folder of real motion files, if the environment names one.
#[expect(clippy::print_stderr, reason = "a test says aloud that it is skipped")]
pub(crate) fn real_data() -> Option<PathBuf> {
    let set = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from);
    let found = set.filter(|path| path.is_dir());
    if found.is_none() {
        eprintln!("SKIPPED: STANCE_TEST_DATA names no folder");
    }
    found
}

pub(crate) fn run(program: &Path, args: &[&str]) -> Output {
    let output = Command::new(program)
        .args(args)
        .env("RUST_LOG", "warn")
        .output();
    output.unwrap_or_else(|error| panic!("{}: {error}", program.display()))
}

/// Runs `stance` and returns its JSON document; `allowed` are the exit codes that are accepted besides 0.
pub(crate) fn stance_json(args: &[&str], allowed: &[i32]) -> Value {
    let mut all = vec!["--json", "--no-progress"];
    all.extend(args);
    let output = run(&stance(), &all);
    let code = output.status.code().expect("it ended by itself");
    assert!(
        code == 0 || allowed.contains(&code),
        "stance {args:?}: {code}: {}",
        text(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("one document")
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Sources of a test, and the root hash of the dataset that `stance ingest` makes of them.
pub(crate) struct Job {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) sources: PathBuf,
    pub(crate) root_hash: String,
}

impl Job {
    /// The job of ingesting some clips of the built-in corpus.
    pub(crate) fn corpus(clips: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let sources = folder.path().join("corpus");
        let output = run(
            &stance(),
            &[
                "corpus",
                "--clips",
                &clips.to_string(),
                "--out",
                &sources.to_string_lossy(),
            ],
        );
        assert!(output.status.success(), "{}", text(&output.stderr));
        Self::of(folder, sources)
    }

    /// The job of ingesting a folder.
    pub(crate) fn of(folder: tempfile::TempDir, sources: PathBuf) -> Self {
        let plain = folder.path().join("plain");
        let ingested = stance_json(
            &[
                "ingest",
                &sources.to_string_lossy(),
                "--out",
                &plain.to_string_lossy(),
            ],
            &[3],
        );
        let root_hash = ingested["root_hash"].as_str().expect("a hash").to_owned();
        Self {
            folder,
            sources,
            root_hash,
        }
    }

    /// A fresh plan. Returns its folder and that of its dataset.
    pub(crate) fn plan(&self, name: &str) -> (String, String) {
        let at = |end: &str| {
            self.folder
                .path()
                .join(format!("{name}-{end}"))
                .to_string_lossy()
                .into_owned()
        };
        let (plan, dataset) = (at("plan"), at("dataset"));
        let sources = self.sources.to_string_lossy();
        stance_json(
            &[
                "stage", "plan", "ingest", &sources, "--into", &dataset, "--out", &plan,
            ],
            &[],
        );
        (plan, dataset)
    }
}

/// A line of stderr, and the number of the process that printed it.
pub(crate) struct Said {
    pub(crate) by: usize,
    pub(crate) line: String,
}

/// A process and its stderr.
pub(crate) struct Process {
    child: Child,
    listener: Option<JoinHandle<()>>,
}

impl Process {
    /// Starts a process whose lines go to `said` under the number `by`.
    pub(crate) fn start(args: &[&str], by: usize, said: Sender<Said>) -> Self {
        let mut child = Command::new(CLUSTER)
            .args(args)
            .env("RUST_LOG", "warn,stance_cluster=info")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let stderr = child.stderr.take().expect("it was asked for");
        // Read stderr to the end, even if the test no longer receives: a full pipe would block the process.
        let listener = thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                let _heard = said.send(Said { by, line });
            }
        });
        Self {
            child,
            listener: Some(listener),
        }
    }

    /// Kills the process, like a lost machine, and returns once all its output was read.
    pub(crate) fn kill(&mut self) {
        let _killed = self.child.kill();
        let _ended = self.child.wait();
        if let Some(listener) = self.listener.take() {
            listener.join().expect("a listener does not panic");
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A scheduler and its executors.
pub(crate) struct Cluster {
    scheduler: Process,
    pub(crate) address: String,
    executors: BTreeMap<usize, Process>,
    started: usize,
    say: Sender<Said>,
    pub(crate) said: Receiver<Said>,
}

impl Cluster {
    pub(crate) fn start(executors: usize) -> Self {
        let (say, said) = channel();
        let (scheduler, address) = scheduler("127.0.0.1:0");
        let mut cluster = Self {
            scheduler,
            address,
            executors: BTreeMap::new(),
            started: 0,
            say,
            said,
        };
        for _ in 0..executors {
            cluster.add(&[]);
        }
        cluster
    }

    pub(crate) fn add(&mut self, more: &[&str]) {
        let mut args = vec!["executor", "--scheduler", &self.address];
        args.extend(more);
        self.executors.insert(
            self.started,
            Process::start(&args, self.started, self.say.clone()),
        );
        self.started += 1;
    }

    /// Kills an executor and returns whether it was still there.
    pub(crate) fn lose(&mut self, executor: usize) -> bool {
        self.executors.remove(&executor).is_some()
    }

    pub(crate) fn lose_scheduler(&mut self) {
        self.scheduler.kill();
    }

    /// Starts the scheduler again, at the same address.
    pub(crate) fn restart_scheduler(&mut self) {
        (self.scheduler, _) = scheduler(&self.address);
    }

    /// Kills all processes and returns the lines of executors that were not received yet.
    pub(crate) fn end(mut self) -> Vec<String> {
        self.executors.clear();
        self.scheduler.kill();
        self.said.try_iter().map(|said| said.line).collect()
    }
}

fn scheduler(listen: &str) -> (Process, String) {
    let (say, said) = channel();
    let process = Process::start(
        &["scheduler", "--listen", listen, "--executor-timeout", "8"],
        0,
        say,
    );
    for Said { line, .. } in &said {
        if let Some((_, address)) = line.split_once("scheduler on ") {
            return (process, address.to_owned());
        }
    }
    panic!("the scheduler ended before it listened on {listen}");
}

/// Runs a plan on the scheduler at an address.
pub(crate) fn run_on(address: &str, plan: &str, more: &[&str]) -> Output {
    let mut args = vec!["run", plan, "--json", "--scheduler", address];
    args.extend(more);
    run(Path::new(CLUSTER), &args)
}

/// Runs a plan within one process.
pub(crate) fn run_local(plan: &str, more: &[&str]) -> Output {
    let mut args = vec!["run", plan, "--json", "--local"];
    args.extend(more);
    run(Path::new(CLUSTER), &args)
}

/// Asserts the exit code of a run and returns its JSON document.
pub(crate) fn document(output: &Output, code: i32) -> Value {
    assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one document")
}
