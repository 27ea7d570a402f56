//! Runs the `stance` command: makes a dataset, and starts a server on it.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use serde_json::Value;
use tempfile::TempDir;

use crate::waits::Program;

/// Number of clips of the built-in corpus: enough for masks, bundles of eight and style pairs.
const CLIPS: &str = "48";

/// The command under test.
fn stance() -> PathBuf {
    let path = std::env::var_os("STANCE_BIN").expect(
        "STANCE_BIN names no built `stance`; start these tests through annotate/browser/run",
    );
    PathBuf::from(path)
}

/// Runs the command to its end and returns its output.
fn run(args: &[&str]) -> String {
    let mut command = Command::new(stance());
    command.args(args).arg("--quiet").stdin(Stdio::null());
    let output = command.output().expect("stance starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "stance {args:?}: {said}");
    String::from_utf8(output.stdout).expect("stdout is text")
}

fn temporary() -> TempDir {
    TempDir::new().expect("a temporary folder")
}

/// The report page of a run: the page named by STANCE_REPORT, or the page of a short demo.
pub fn report_page() -> PathBuf {
    static MADE: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = temporary();
        run(&["demo", "--quick", "--out", &text(folder.path())]);
        folder
    });
    let named = std::env::var_os("STANCE_REPORT").map(PathBuf::from);
    named.unwrap_or_else(|| MADE.path().join("report.html"))
}

/// A test's copy of a dataset that is made once for all tests.
#[derive(Debug)]
pub struct Dataset {
    folder: TempDir,
}

impl Dataset {
    /// A copy of the dataset with masks, fine-grained pairs and style pairs.
    pub fn fresh() -> Self {
        static MADE: LazyLock<TempDir> = LazyLock::new(|| {
            let folder = temporary();
            let sources = text(&folder.path().join("sources"));
            let dataset = text(&folder.path().join("dataset"));
            run(&["corpus", "--out", &sources, "--clips", CLIPS]);
            run(&["ingest", &sources, "--out", &dataset]);
            run(&["masks", &dataset]);
            run(&["pairs", &dataset]);
            folder
        });
        Self::copy_of(&MADE.path().join("dataset"))
    }

    /// A dataset with a style pair of any two of its clips, at least `count` pairs.
    pub fn with_pairs(count: i64) -> Self {
        let clips = (1..).find(|clips| clips * (clips - 1) / 2 >= count);
        let clips = clips.expect("a number of clips").to_string();
        let folder = temporary();
        let [sources, pairs, dataset] =
            ["sources", "pairs.csv", "dataset"].map(|name| text(&folder.path().join(name)));
        run(&["corpus", "--out", &sources, "--clips", &clips]);
        let mut names = Vec::new();
        clip_files(Path::new(&sources), Path::new(&sources), &mut names);
        names.sort();
        let mut lines = String::new();
        for (at, styled) in names.iter().enumerate() {
            for original in &names[..at] {
                lines += &format!("{styled},{original},old\n");
            }
        }
        fs::write(&pairs, lines).expect("a list of pairs");
        run(&["ingest", &sources, "--out", &dataset, "--pairs", &pairs]);
        Self { folder }
    }

    /// A copy of another dataset, including its store.
    pub fn copy_of(dataset: &Path) -> Self {
        let folder = temporary();
        copy(dataset, &folder.path().join("dataset"));
        Self { folder }
    }

    /// Folder of the dataset.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("dataset")
    }

    /// Runs a `stance annotate` command on the dataset, and returns its JSON output.
    pub fn annotate(&self, command: &[&str]) -> Value {
        let path = text(&self.path());
        let printed = run(&[&["annotate", &path], command, &["--json"]].concat());
        serde_json::from_str(&printed).expect("one JSON document")
    }

    /// Adds a user and returns their token.
    pub fn add_user(&self, name: &str, role: &str) -> String {
        let shown = self.annotate(&["user", "add", name, "--role", role]);
        shown["token"].as_str().expect("a token").to_owned()
    }
}

/// A running server. It is killed when dropped.
#[derive(Debug)]
pub struct Server {
    program: Option<Program>,
    port: u16,
    dataset: PathBuf,
    printed_token: String,
    /// Address of the language model, if there is one.
    model: Option<String>,
}

impl Server {
    /// Starts a server on a free port. It asks the language model at the address `model` for drafts, if there is one.
    pub fn start(dataset: &Dataset, model: Option<String>) -> Self {
        let mut server = Self {
            program: None,
            port: free_port(),
            dataset: dataset.path(),
            printed_token: String::new(),
            model,
        };
        server.up();
        server
    }

    /// Starts the server on its port, for the first time or again.
    pub fn up(&mut self) {
        let mut command = Command::new(stance());
        if let Some(model) = &self.model {
            command.envs([
                ("STANCE_MODEL_URL", model.as_str()),
                ("STANCE_MODEL_NAME", "tiny"),
            ]);
        }
        let listen = format!("127.0.0.1:{}", self.port);
        command.arg("annotate").arg(&self.dataset);
        command.args(["--listen", &listen, "--json", "--host", AFAR]);
        let document = |line: &str| serde_json::from_str::<Value>(line).ok();
        let started = Program::start(&mut command, document);
        let (program, shown) = started.expect("the server prints its address");
        if let Some(token) = shown["token"].as_str() {
            self.printed_token = token.to_owned();
        }
        self.program = Some(program);
    }

    /// Restarts the server on another dataset, on the same port.
    pub fn switch_to(&mut self, dataset: &Dataset) {
        self.down();
        self.dataset = dataset.path();
        self.up();
    }

    /// Kills the server without warning, like a power cut.
    pub fn down(&mut self) {
        self.program = None;
    }

    /// The URL of a page.
    pub fn page(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}/{path}", self.port)
    }

    /// The URL of a page under a host name that browsers do not trust without TLS.
    pub fn page_from_afar(&self, path: &str) -> String {
        format!("http://{AFAR}:{}/{path}", self.port)
    }

    /// The token in the last printed address: an admin's one-time login token.
    pub fn printed_token(&self) -> &str {
        &self.printed_token
    }
}

/// A host name that browsers do not trust without TLS.
const AFAR: &str = "annotate.test";

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("a bound address").port()
}

fn text(path: &Path) -> String {
    path.to_str().expect("temporary paths are text").to_owned()
}

/// Adds the paths of the clips in a folder to `names`, relative to `root`.
fn clip_files(root: &Path, folder: &Path, names: &mut Vec<String>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            clip_files(root, &path, names);
        } else if path
            .extension()
            .is_some_and(|extension| extension != "json")
        {
            names.push(text(path.strip_prefix(root).expect("a path inside of it")));
        }
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("a copy");
        }
    }
}
