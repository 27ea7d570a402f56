//! Runs the `stance` command: makes a dataset, and starts a server on it.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::OnceLock;

use serde_json::Value;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

use crate::waits::PATIENCE;

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
async fn run(args: &[&str]) -> String {
    let output = Command::new(stance())
        .args(args)
        .args(["--quiet"])
        .stdin(Stdio::null())
        .output()
        .await
        .expect("stance starts");
    assert!(
        output.status.success(),
        "stance {args:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("stdout is text")
}

/// The report page of a run: the one named by STANCE_REPORT, or that of a short demo.
pub async fn report_page() -> PathBuf {
    static MADE: OnceLock<TempDir> = OnceLock::new();
    static MAKING: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());
    if let Some(page) = std::env::var_os("STANCE_REPORT") {
        return PathBuf::from(page);
    }
    let _guard = MAKING.lock().await;
    if MADE.get().is_none() {
        let folder = TempDir::new().expect("a temporary folder");
        run(&["demo", "--quick", "--out", &text(folder.path())]).await;
        let _ = MADE.set(folder);
    }
    MADE.get().expect("made above").path().join("report.html")
}

/// A test's copy of a dataset that is made once for all tests.
#[derive(Debug)]
pub struct Dataset {
    folder: TempDir,
}

impl Dataset {
    /// A copy of the dataset with masks, fine-grained pairs and style pairs.
    pub async fn fresh() -> Self {
        static MADE: OnceLock<TempDir> = OnceLock::new();
        static MAKING: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());
        let guard = MAKING.lock().await;
        if MADE.get().is_none() {
            let folder = TempDir::new().expect("a temporary folder");
            let sources = text(&folder.path().join("sources"));
            let dataset = text(&folder.path().join("dataset"));
            run(&["corpus", "--out", &sources, "--clips", CLIPS]).await;
            run(&["ingest", &sources, "--out", &dataset]).await;
            run(&["masks", &dataset]).await;
            run(&["pairs", &dataset]).await;
            let _ = MADE.set(folder);
        }
        drop(guard);
        let made = MADE.get().expect("made above").path().join("dataset");
        let folder = TempDir::new().expect("a temporary folder");
        copy(&made, &folder.path().join("dataset"));
        Self { folder }
    }

    /// A dataset with a style pair of any two of its clips, and at least `count` of them.
    pub async fn with_pairs(count: i64) -> Self {
        let clips = (1..).find(|clips| clips * (clips - 1) / 2 >= count);
        let clips = clips.expect("a number of clips").to_string();
        let folder = TempDir::new().expect("a temporary folder");
        let sources = folder.path().join("sources");
        let pairs = folder.path().join("pairs.csv");
        run(&["corpus", "--out", &text(&sources), "--clips", &clips]).await;
        let mut names = Vec::new();
        clip_files(&sources, &sources, &mut names);
        names.sort();
        let mut lines = String::new();
        for (at, styled) in names.iter().enumerate() {
            for original in &names[..at] {
                lines += &format!("{styled},{original},old\n");
            }
        }
        fs::write(&pairs, lines).expect("a list of pairs");
        let dataset = text(&folder.path().join("dataset"));
        run(&[
            "ingest",
            &text(&sources),
            "--out",
            &dataset,
            "--pairs",
            &text(&pairs),
        ])
        .await;
        Self { folder }
    }

    /// A copy of another dataset, with its store.
    pub fn copy_of(dataset: &Path) -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        copy(dataset, &folder.path().join("dataset"));
        Self { folder }
    }

    /// Its folder.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("dataset")
    }

    /// Runs a command of `stance annotate` on it, and returns the document that it prints.
    pub async fn annotate(&self, command: &[&str]) -> Value {
        let path = text(&self.path());
        let printed = run(&[&["annotate", &path], command, &["--json"]].concat()).await;
        serde_json::from_str(&printed).expect("one JSON document")
    }

    /// Adds a user and returns their token.
    pub async fn add_user(&self, name: &str, role: &str) -> String {
        let add = ["user", "add", name, "--role", role];
        let shown = self.annotate(&add).await;
        shown["token"].as_str().expect("a token").to_owned()
    }
}

/// A running server. It is killed when dropped.
#[derive(Debug)]
pub struct Server {
    child: Option<Child>,
    port: u16,
    dataset: PathBuf,
    printed_token: String,
    /// Address of the language model, if there is one.
    model: Option<String>,
}

impl Server {
    /// Starts a server on a free port.
    pub async fn start(dataset: &Dataset) -> Self {
        Self::start_with(dataset, None).await
    }

    /// Starts a server that asks a language model for drafts.
    pub async fn start_with(dataset: &Dataset, model: Option<String>) -> Self {
        let port = free_port();
        let mut server = Self {
            child: None,
            port,
            dataset: dataset.path(),
            printed_token: String::new(),
            model,
        };
        server.up().await;
        server
    }

    /// Starts it again on the same port.
    pub async fn up(&mut self) {
        let mut command = Command::new(stance());
        if let Some(model) = &self.model {
            command
                .env("STANCE_MODEL_URL", model)
                .env("STANCE_MODEL_NAME", "tiny");
        }
        let mut child = command
            .arg("annotate")
            .arg(&self.dataset)
            .args(["--listen", &format!("127.0.0.1:{}", self.port), "--json"])
            .args(["--host", AFAR])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .kill_on_drop(true)
            .spawn()
            .expect("stance starts");
        let stdout = child.stdout.take().expect("stdout is piped");
        let mut lines = BufReader::new(stdout).lines();
        let line = tokio::time::timeout(PATIENCE, lines.next_line())
            .await
            .expect("the server says where it is in time")
            .expect("stdout is text")
            .expect("the server says where it is");
        let shown: Value = serde_json::from_str(&line).expect("one JSON document");
        if let Some(token) = shown["token"].as_str() {
            self.printed_token = token.to_owned();
        }
        // Drain its output, so that it never blocks.
        tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
        self.child = Some(child);
    }

    /// Serves another dataset from now on, on the same port.
    pub async fn switch_to(&mut self, dataset: &Dataset) {
        self.down().await;
        self.dataset = dataset.path();
        self.up().await;
    }

    /// Kills it without warning, like a power cut.
    pub async fn down(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().await.expect("the server can be killed");
        }
    }

    /// The address of a page.
    pub fn page(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}/{path}", self.port)
    }

    /// The address of a page by the name of a host that browsers do not trust without TLS.
    pub fn page_from_afar(&self, path: &str) -> String {
        format!("http://{AFAR}:{}/{path}", self.port)
    }

    /// The token in the last printed address: an admin's one-time login token.
    pub fn printed_token(&self) -> &str {
        &self.printed_token
    }
}

/// The name of a host that browsers do not trust without TLS.
const AFAR: &str = "annotate.test";

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("a bound address").port()
}

fn text(path: &Path) -> String {
    path.to_str().expect("temporary paths are text").to_owned()
}

/// Names of the clips in a folder, relative to `root`.
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
