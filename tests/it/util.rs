//! A temporary folder and the `stance` command.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use datasets_spec::Dataset;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Output and exit code of a command.
pub(crate) struct Ran {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Ran {
    /// Panics with the whole output unless the command ended with `code`.
    pub(crate) fn expect_code(self, code: i32) -> Self {
        assert_eq!(self.code, code, "expected exit code {code}: {self}");
        self
    }

    /// Panics with the whole output unless the command ended with 1 and stderr contains this text.
    pub(crate) fn expect_refused(self, text: &str) -> Self {
        let refused = self.expect_code(1);
        refused.expect_said(text);
        refused
    }

    /// Panics with the whole output unless stderr contains this text.
    pub(crate) fn expect_said(&self, text: &str) -> &Self {
        assert!(
            self.stderr.contains(text),
            "{text:?} is not on stderr: {self}"
        );
        self
    }

    /// Panics with the whole output unless stdout contains this text.
    pub(crate) fn expect_printed(&self, text: &str) {
        assert!(
            self.stdout.contains(text),
            "{text:?} is not on stdout: {self}"
        );
    }

    /// Stdout of a command that succeeded.
    pub(crate) fn printed(self) -> String {
        self.expect_code(0).stdout
    }

    /// Stderr of a command that exited with 1.
    pub(crate) fn refusal(self) -> String {
        self.expect_code(1).stderr
    }

    /// The JSON document of a command that succeeded.
    pub(crate) fn done<T: DeserializeOwned>(self) -> T {
        self.expect_code(0).json()
    }

    /// Reads stdout as one JSON document.
    pub(crate) fn json<T: DeserializeOwned>(&self) -> T {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("{error}\n-- stdout\n{}", self.stdout))
    }
}

/// The whole output of the command.
impl fmt::Display for Ran {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "\n-- stdout\n{}\n-- stderr\n{}",
            self.stdout, self.stderr
        )
    }
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).expect("stdout is text"),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// The command, ready for further settings.
pub(crate) fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stance"));
    command.args(args);
    command
}

/// Runs the command to its end.
pub(crate) fn stance(args: &[&str]) -> Ran {
    command(args).output().expect("stance starts").into()
}

/// Runs a command line: words are separated by spaces, and each `{}` is replaced by the next value.
pub(crate) fn typed(line: &str, values: &[&dyn AsRef<OsStr>]) -> Ran {
    typed_with(line, values, &[])
}

/// Runs a command line as typed in a shell, with further arguments appended.
pub(crate) fn typed_with(line: &str, values: &[&dyn AsRef<OsStr>], more: &[&str]) -> Ran {
    let mut values = values.iter();
    let words = line.split_whitespace().map(|word| match word {
        "{}" => values.next().expect("a value for each place").as_ref(),
        word => OsStr::new(word),
    });
    let mut command = command(&[]);
    let ran = command.args(words).args(more).output();
    assert!(values.next().is_none(), "a place for each value: {line}");
    ran.expect("stance starts").into()
}

/// Panics with the whole text unless it contains all of these parts.
#[track_caller]
pub(crate) fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
}

/// The number of elements of a list.
#[track_caller]
pub(crate) fn len_of(list: &Value) -> usize {
    list.as_array().expect("a list").len()
}

/// The name of a file.
pub(crate) fn name_of(path: &Path) -> String {
    let name = path.file_name().expect("a name");
    name.to_string_lossy().into_owned()
}

/// The name of a file without its extension.
pub(crate) fn stem_of(path: &Path) -> String {
    name_of(&path.with_extension(""))
}

/// Writes a file, and the folders that it lies in.
pub(crate) fn put(path: impl AsRef<Path>, bytes: impl AsRef<[u8]>) {
    let path = path.as_ref();
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    std::fs::write(path, bytes).expect("written");
}

/// The text of a file.
pub(crate) fn text_of(path: impl AsRef<Path>) -> String {
    std::fs::read_to_string(path).expect("text")
}

/// A file of one JSON document.
pub(crate) fn json_of<T: DeserializeOwned>(path: impl AsRef<Path>) -> T {
    serde_json::from_str(&text_of(path)).expect("JSON")
}

/// A path as an argument.
pub(crate) fn arg(path: &Path) -> &str {
    path.to_str().expect("temporary paths are text")
}

/// A small built-in corpus in a temporary folder.
pub(crate) fn corpus(clips: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let out = dir.path().join("corpus");
    stance(&["corpus", "--clips", &clips.to_string(), "--out", arg(&out)]).expect_code(0);
    dir
}

/// The folder of real motion files. If it is not set, returns none and prints that the test is skipped.
pub(crate) fn real_data(test: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("STANCE_TEST_DATA").map(PathBuf::from);
    if folder.is_none() {
        use std::io::Write;
        let mut stderr = std::io::stderr().lock();
        let _said = writeln!(
            stderr,
            "SKIPPED {test}: STANCE_TEST_DATA names no folder of real motion"
        );
    }
    folder
}

/// The rows of a table of a dataset.
pub(crate) fn rows_of<R: Row>(dataset: &Path) -> Vec<R> {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.read(None).expect("rows")
}

pub(crate) fn root_hash_of(dataset: &Path) -> String {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.manifest().root_hash.clone()
}

/// The clips of a dataset by their ids.
pub(crate) fn motions_of(dataset: &Path) -> BTreeMap<String, MotionRow> {
    let rows = rows_of::<MotionRow>(dataset).into_iter();
    rows.map(|row| (row.id.to_string(), row)).collect()
}

/// Checks that the counts of an ingestion's document add up.
#[track_caller]
pub(crate) fn assert_counted(done: &Value) {
    let count = |name: &str| done[name].as_u64().expect("a count");
    let counted = count("ingested") + count("quarantined") + count("skipped");
    assert_eq!(count("sources"), counted, "{done}");
}

/// All files with an extension under a folder, sorted.
pub(crate) fn files_with_extension(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
