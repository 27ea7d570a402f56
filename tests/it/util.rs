//! Helpers of all tests: the `stance` command, temporary folders, documents and tables.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use datasets_spec::Dataset;
use datasets_spec::manifest::Manifest;
use datasets_spec::record::{MotionRow, QuarantineRow, SkippedRow};
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

/// Runs a command line as [`typed`] does, with further arguments appended.
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

/// A temporary folder. In its command lines, `@name` is the path of `name` in the folder.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn empty() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    /// A folder with a small built-in corpus.
    pub(crate) fn of_clips(clips: usize) -> Self {
        let folder = Self::empty();
        folder.run(&format!("corpus --clips {clips} --out @corpus"));
        folder
    }

    /// A folder with a small built-in corpus, and the dataset of it.
    pub(crate) fn of_dataset(clips: usize) -> Self {
        let folder = Self::of_clips(clips);
        folder.run("ingest @corpus --out @dataset");
        folder
    }

    /// A folder with a small built-in corpus, and the dataset of it with automatic masks.
    pub(crate) fn of_masks(clips: usize) -> Self {
        let folder = Self::of_dataset(clips);
        folder.run("masks @dataset");
        folder
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        put(self.path(name), bytes);
    }

    pub(crate) fn text(&self, name: &str) -> String {
        text_of(self.path(name))
    }

    pub(crate) fn rows<R: Row>(&self, dataset: &str) -> Vec<R> {
        rows_of(&self.path(dataset))
    }

    pub(crate) fn dataset_at(&self, name: &str) -> Dataset {
        Dataset::open(&self.path(name)).expect("a dataset")
    }

    /// A command line as typed in a shell, in which `@name` is the path of `name` in this folder.
    pub(crate) fn command(&self, line: &str) -> Command {
        let mut command = command(&[]);
        for word in shlex::split(line).expect("closed quotes") {
            match word.strip_prefix('@') {
                Some(name) => command.arg(self.path(name)),
                None => command.arg(word),
            };
        }
        command
    }

    /// Runs a command line.
    pub(crate) fn typed(&self, line: &str) -> Ran {
        self.typed_with(line, &[])
    }

    /// Runs a command line, with further arguments appended.
    pub(crate) fn typed_with(&self, line: &str, more: &[&str]) -> Ran {
        let ran = self.command(line).args(more).output();
        ran.expect("stance starts").into()
    }

    /// Starts a command line, with further arguments appended, whose output nobody reads.
    pub(crate) fn started(&self, line: &str, more: &[&str]) -> Child {
        let mut command = self.command(line);
        command.args(more);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().expect("stance starts")
    }

    /// Runs a command line that succeeds.
    pub(crate) fn run(&self, line: &str) -> Ran {
        self.typed(line).expect_code(0)
    }

    /// Runs a command line that exits with 1, with this text on stderr.
    pub(crate) fn refused(&self, line: &str, text: &str) -> Ran {
        self.typed(line).expect_refused(text)
    }

    /// Runs `stance ingest` with this rest of a command line, and returns the document, whose counts add up.
    pub(crate) fn ingest(&self, line: &str, code: i32) -> Value {
        let ran = self.typed(&format!("--json ingest {line}"));
        let done = ran.expect_code(code).json();
        assert_counted(&done);
        done
    }

    /// Does a job in pieces, and returns the document of its commit.
    pub(crate) fn staged(&self, job: &str) -> Value {
        self.run(&format!("stage plan {job} --out @plan"));
        self.run("stage work @plan");
        self.json("stage commit @plan")
    }

    /// The JSON document of a command line that succeeds.
    pub(crate) fn json<T: DeserializeOwned>(&self, line: &str) -> T {
        self.typed(&format!("--json {line}")).done()
    }
}

/// Kills a process once it has begun. What follows must be the same whether that is before, during or after its work.
pub(crate) fn kill_once(mut child: Child, has_begun: impl Fn() -> bool) {
    while !has_begun() && child.try_wait().expect("a child").is_none() {
        std::thread::yield_now();
    }
    child.kill().expect("a child");
    child.wait().expect("a child");
}

/// Panics with the whole text unless it contains all of these parts.
#[track_caller]
pub(crate) fn assert_has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
}

/// The elements of a list.
#[track_caller]
pub(crate) fn list_of(list: &Value) -> &[Value] {
    list.as_array().expect("a list")
}

/// The number of elements of a list.
#[track_caller]
pub(crate) fn len_of(list: &Value) -> usize {
    list_of(list).len()
}

/// A number of a document.
#[track_caller]
pub(crate) fn number_of(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A text of a document.
#[track_caller]
pub(crate) fn word_of(value: &Value) -> &str {
    value.as_str().expect("a text")
}

/// The texts of a list.
#[track_caller]
pub(crate) fn words_of(list: &Value) -> Vec<&str> {
    list_of(list).iter().map(word_of).collect()
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

/// Copies a file, or a folder with all that it holds.
pub(crate) fn copy_all(from: &Path, to: &Path) {
    if from.is_dir() {
        std::fs::create_dir_all(to).expect("made");
        for entry in std::fs::read_dir(from).expect("listed") {
            let name = entry.expect("listed").file_name();
            copy_all(&from.join(&name), &to.join(&name));
        }
    } else {
        std::fs::copy(from, to).expect("copied");
    }
}

/// Unpacks a tar archive into a folder with the `tar` of the system.
pub(crate) fn unpack(archive: &Path, into: &Path) {
    std::fs::create_dir_all(into).expect("a folder");
    let mut tar = Command::new("tar");
    let done = tar.args(["-xf", arg(archive), "-C", arg(into)]).status();
    assert!(done.expect("tar starts").success(), "{}", archive.display());
}

/// The text of a file.
pub(crate) fn text_of(path: impl AsRef<Path>) -> String {
    std::fs::read_to_string(path).expect("text")
}

/// Reads a file with one JSON document.
pub(crate) fn json_of<T: DeserializeOwned>(path: impl AsRef<Path>) -> T {
    serde_json::from_str(&text_of(path)).expect("JSON")
}

/// The JSON documents of a text, one a line.
pub(crate) fn json_lines(text: &str) -> Vec<Value> {
    let lines = text.lines();
    let lines = lines.map(|line| serde_json::from_str(line).expect("JSON"));
    lines.collect()
}

/// A path as an argument.
pub(crate) fn arg(path: &Path) -> &str {
    path.to_str().expect("temporary paths are text")
}

/// The value of a variable. If it is not set, returns `None` and prints what is skipped.
pub(crate) fn needed(variable: &str, skipped: &str) -> Option<String> {
    let value = std::env::var(variable).ok();
    if value.is_none() {
        use std::io::Write;
        let _said = writeln!(std::io::stderr().lock(), "SKIPPED {skipped}");
    }
    value
}

/// The folder of real motion files. If it is not set, returns `None` and prints that the test is skipped.
pub(crate) fn real_data(test: &str) -> Option<PathBuf> {
    let skipped = format!("{test}: STANCE_TEST_DATA names no folder of real motion");
    needed("STANCE_TEST_DATA", &skipped).map(PathBuf::from)
}

/// The rows of a table of a dataset.
pub(crate) fn rows_of<R: Row>(dataset: &Path) -> Vec<R> {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.read(None).expect("rows")
}

/// The manifest of the newest version of a dataset.
pub(crate) fn manifest_of(dataset: &Path) -> Manifest {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.manifest().clone()
}

pub(crate) fn root_hash_of(dataset: &Path) -> String {
    manifest_of(dataset).root_hash
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

/// Panics with the whole value unless its JSON contains this text.
#[track_caller]
pub(crate) fn assert_tells(value: &Value, text: &str) {
    assert_has(&value.to_string(), &[text]);
}

/// Checks paths and codes of all quarantined items of a dataset, and returns the items by their paths.
#[track_caller]
pub(crate) fn assert_quarantined(
    dataset: &Path,
    expected: &[(&str, &str)],
) -> BTreeMap<String, QuarantineRow> {
    let rows: Vec<QuarantineRow> = rows_of(dataset);
    let found = rows.iter();
    let found = found.map(|row| (row.path.as_str(), row.code.as_str()));
    let [mut found, mut expected]: [Vec<(&str, &str)>; 2] = [found.collect(), expected.to_vec()];
    found.sort_unstable();
    expected.sort_unstable();
    assert_eq!(found, expected, "{rows:?}");
    let by_path = rows.into_iter().map(|row| (row.path.clone(), row));
    by_path.collect()
}

/// Reasons of the skipped items of a dataset, by their paths.
pub(crate) fn skipped_of(dataset: &Path) -> BTreeMap<String, String> {
    let rows = rows_of::<SkippedRow>(dataset).into_iter();
    rows.map(|row| (row.path, row.reason)).collect()
}

/// All files and folders below a folder, with the bytes of files.
pub(crate) fn everything(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let bytes = match path.is_dir() {
            true => {
                found.extend(everything(&path));
                Vec::new()
            }
            false => std::fs::read(&path).expect("read"),
        };
        found.insert(path, bytes);
    }
    found
}

/// Writes rows into a dataset, in the split that `split` names.
pub(crate) fn commit<R: Row>(
    dataset: &Path,
    rows: &[R],
    split: fn(&R) -> datasets_spec::Split,
    plan: &str,
) {
    let opened = Dataset::open(dataset).expect("a dataset");
    let skeleton = opened.skeleton().expect("a skeleton");
    datasets_spec::dataset::commit_rows(dataset, rows, Some(split), &skeleton, plan, "test")
        .expect("committed");
}

/// Flips a bit in the middle of a file.
pub(crate) fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).expect("a file");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    put(path, bytes);
}

/// The text of a field in each element of a list.
#[track_caller]
pub(crate) fn texts_in<'a>(list: &'a Value, field: &str) -> Vec<&'a str> {
    let elements = list_of(list).iter();
    elements.map(|element| word_of(&element[field])).collect()
}
