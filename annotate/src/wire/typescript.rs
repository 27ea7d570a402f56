//! The types of the API in TypeScript: `annotate/web/src/wire.ts`, which this test writes and compares.
//!
//! The macro `messages!` lists the messages; the enums are listed here. The test fails if the committed file differs.
//! `STANCE_WRITE_WIRE=1 cargo test -p annotate --lib wire` writes it.

use std::fmt::Write as _;
use std::path::Path;

use datasets_spec::record::MaskRow;
use ts_rs::{Config, TS};

/// First lines of the file.
const HEAD: &str = "\
/**
 * Types of the HTTP API. Generated from `annotate/src/wire`; do not edit. After a change there run
 * `STANCE_WRITE_WIRE=1 cargo test --release -p annotate --lib wire`.
 */
";

/// A type by name, with its documentation and declaration.
pub(super) fn declaration<T: TS>(config: &Config) -> (String, String) {
    let docs = T::docs().map(|docs| docs.to_string()).unwrap_or_default();
    let name = T::ident(config);
    (
        name,
        laid_out(&format!("{docs}export {}\n", T::decl(config))),
    )
}

/// The text of a declaration: its comment on one line, then a line for each field. Comments of fields are left out.
fn laid_out(text: &str) -> String {
    let text = text.replace("\n */", " */").replace("/**\n *", "/**");
    let text = text.replace("\n *", "");
    let (head, declaration) = text.split_at(text.find("export type").expect("a declaration"));
    let lines = declaration.lines();
    let words = lines
        .filter(|line| !line.starts_with("/**"))
        .flat_map(str::split_whitespace);
    let mut laid = String::new();
    for word in words {
        laid.push_str(if is_field(word) { "\n  " } else { " " });
        laid.push_str(word);
    }
    format!("{head}{}\n", laid.trim_start())
}

/// Whether a word is the name of a field.
fn is_field(word: &str) -> bool {
    let name = word.strip_suffix(':').unwrap_or_default();
    let name = name.strip_suffix('?').unwrap_or(name);
    !name.is_empty()
        && name
            .chars()
            .all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

/// `EDIT_TYPES` for `EditType`.
fn plural(name: &str) -> String {
    let mut text = String::new();
    for (at, letter) in name.char_indices() {
        if at > 0 && letter.is_ascii_uppercase() {
            text.push('_');
        }
        text.push(letter.to_ascii_uppercase());
    }
    text + "S"
}

/// A list of strings, with as many per line as fit.
fn list(items: &[&str]) -> String {
    let (mut text, mut line) = ("[\n".to_owned(), " ".to_owned());
    for item in items {
        let shown = format!(" {item:?},");
        if line.len() + shown.len() > 111 {
            text += &format!("{line}\n");
            " ".clone_into(&mut line);
        }
        line += &shown;
    }
    text + &line + "\n]"
}

macro_rules! enums {
    ($($name:ident)*) => {
        /// The enums, each with a list of its values.
        fn enums(config: &Config) -> Vec<(String, String)> {
            vec![$( {
                let (name, text) = declaration::<super::$name>(config);
                let values: Vec<&str> = super::$name::ALL.iter().map(|value| value.as_str()).collect();
                let (plural, values) = (plural(&name), list(&values));
                let text = format!("{text}export const {plural}: readonly {name}[] = {values};\n");
                (name, text)
            }, )*]
        }
    };
}

enums! {
    Action BulkAction Code CountReason Decision EditType EventKind ExportFormat Extent ImportFormat JointWeight
    ReviewQueue RevisionState Role RuleKind SkipFilter SkipReason Standing SuggestionSource SuggestionUse TaskKind
    TaskSort TaskState TextForm Verdict
}

/// The enums, and then the messages, sorted by name.
fn declarations(config: &Config) -> Vec<(String, String)> {
    let mut messages = vec![declaration::<super::Answer>(config)];
    for declared in [
        super::declared,
        super::people::declared,
        super::review::declared,
        super::stats::declared,
        super::task::declared,
    ] {
        messages.extend(declared(config));
    }
    messages.sort();
    [enums(config), messages].concat()
}

fn generated() -> String {
    let config = Config::new().with_large_int("number");
    let mut text = HEAD.to_owned();
    let shortest = usize::try_from(MaskRow::SHORTEST).expect("a number of frames");
    let constants: [(&str, usize); 8] = [
        ("MAX_TEXT_CHARS", super::MAX_TEXT_CHARS),
        ("MAX_GUIDELINE_CHARS", super::MAX_GUIDELINE_CHARS),
        ("MAX_NAME_CHARS", super::MAX_NAME_CHARS),
        ("MAX_EVENTS", super::MAX_EVENTS),
        ("MAX_BODY_BYTES", super::MAX_BODY_BYTES),
        ("MAX_MASKS", super::MAX_MASKS),
        ("SHORTEST_RANGE", shortest),
        ("BUNDLE", super::BUNDLE),
    ];
    text.push('\n');
    for (name, value) in constants {
        writeln!(text, "export const {name} = {value};").expect("a string takes text");
    }
    for (name, items) in [
        ("KEY_MODIFIERS", super::KEY_MODIFIERS.as_slice()),
        ("KEY_CODES", super::KEY_CODES.as_slice()),
    ] {
        let list = list(items);
        writeln!(text, "export const {name}: readonly string[] = {list};")
            .expect("a string takes text");
    }
    for (_, declaration) in declarations(&config) {
        text.push('\n');
        text.push_str(&declaration);
    }
    text
}

#[test]
fn the_page_is_compiled_against_the_types_of_the_server() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("web/src/wire.ts");
    let generated = generated();
    if std::env::var_os("STANCE_WRITE_WIRE").is_some() {
        std::fs::write(&path, &generated).expect("the file of the page");
    }
    let committed = std::fs::read_to_string(&path).expect("the file of the page");
    assert!(
        committed == generated,
        "annotate/web/src/wire.ts differs from annotate/src/wire; run \
         `STANCE_WRITE_WIRE=1 cargo test --release -p annotate --lib wire`, then rebuild annotate/web"
    );
}
