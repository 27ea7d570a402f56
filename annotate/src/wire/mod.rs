//! Requests and responses of the HTTP API, documented in `API.md`.
//!
//! Requests with unknown fields are refused. Times are milliseconds since the epoch, ids are integers, and
//! values of enums are `snake_case`.

/// Declares messages: structs that are read from JSON and written to it, and that the page has as TypeScript types.
/// Fields with clear names need no docs.
macro_rules! messages {
    ($(
        $(#[doc = $doc:literal])+
        $(#[derive($($derived:ident),+)])?
        $(#[serde($($strictness:tt)+)])?
        pub struct $name:ident {
            $(
                $(#[doc = $said:literal])*
                $(#[serde($($form:tt)+)])?
                $(#[ts($($type_form:tt)+)])?
                pub $field:ident: $type:ty,
            )+
        }
    )+) => { $(
        $(#[doc = $doc])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize $($(, $derived)+)?)]
        #[cfg_attr(test, derive(ts_rs::TS))]
        $(#[serde($($strictness)+)])?
        pub struct $name { $(
            $(#[doc = $said])*
            $(#[serde($($form)+)])?
            $(#[cfg_attr(test, ts($($type_form)+))])?
            pub $field: $type,
        )+ }
    )+

        /// The messages by name, in TypeScript.
        #[cfg(test)]
        pub(super) fn declared(config: &ts_rs::Config) -> Vec<(String, String)> {
            vec![$( crate::wire::typescript::declaration::<$name>(config), )+]
        }
    };
}

mod names;
mod people;
mod review;
mod stats;
mod task;
#[cfg(test)]
mod typescript;

pub(crate) use names::names;
pub use names::*;
pub use people::*;
pub use review::*;
pub use stats::*;
pub use task::*;

/// Maximum characters of a text.
pub const MAX_TEXT_CHARS: usize = 2_000;
/// Maximum characters of the guideline of a style.
pub const MAX_GUIDELINE_CHARS: usize = 10_000;
/// Maximum characters of the name of a style, a phrase or the project.
pub const MAX_NAME_CHARS: usize = 100;
/// Maximum events of a batch.
pub const MAX_EVENTS: usize = 64;
/// Maximum bytes of a request body, except imports.
pub const MAX_BODY_BYTES: usize = 256 * 1024;
/// Maximum bytes of the settings, which hold the guidelines of all styles, and of a capture plan.
pub const MAX_SETTINGS_BYTES: usize = 16 * 1024 * 1024;
/// Maximum bytes of the body of an import.
pub const MAX_IMPORT_BYTES: usize = 64 * 1024 * 1024;
/// Maximum bytes of a picture of the guide.
pub const MAX_PICTURE_BYTES: usize = 2 * 1024 * 1024;
/// Maximum masks of an answer.
pub const MAX_MASKS: usize = 16;
/// Maximum pairs of a bundle.
pub const BUNDLE: usize = 8;
/// Modifiers of a key, in the order in which they are written. Alt is left to browsers and keyboard layouts.
pub const KEY_MODIFIERS: [&str; 2] = ["Ctrl+", "Shift+"];
/// Keys that can be bound, by `KeyboardEvent.code`. The page reports `NumpadEnter` as `Enter`.
#[rustfmt::skip]
pub const KEY_CODES: [&str; 100] = [
    "KeyA", "KeyB", "KeyC", "KeyD", "KeyE", "KeyF", "KeyG", "KeyH", "KeyI", "KeyJ", "KeyK", "KeyL", "KeyM",
    "KeyN", "KeyO", "KeyP", "KeyQ", "KeyR", "KeyS", "KeyT", "KeyU", "KeyV", "KeyW", "KeyX", "KeyY", "KeyZ",
    "Digit0", "Digit1", "Digit2", "Digit3", "Digit4", "Digit5", "Digit6", "Digit7", "Digit8", "Digit9",
    "Numpad0", "Numpad1", "Numpad2", "Numpad3", "Numpad4", "Numpad5", "Numpad6", "Numpad7", "Numpad8", "Numpad9",
    "F1", "F2", "F3", "F4", "F5", "F6", "F7", "F8", "F9", "F10", "F11", "F12",
    "F13", "F14", "F15", "F16", "F17", "F18", "F19", "F20", "F21", "F22", "F23", "F24",
    "Space", "Enter", "Escape", "Tab", "Backspace", "Delete", "Insert", "Home", "End",
    "PageUp", "PageDown", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Minus", "Equal",
    "BracketLeft", "BracketRight", "Backslash", "Semicolon", "Quote", "Backquote", "Comma",
    "Period", "Slash", "IntlBackslash", "IntlRo", "IntlYen", "NumpadAdd",
];

messages! {
    /// A problem (RFC 9457), as `application/problem+json`.
    pub struct Problem {
        /// `/problems/` and the code.
        #[serde(rename = "type")]
        pub kind: String,
        /// Meaning of the code.
        pub title: String,
        /// HTTP status.
        pub status: u16,
        /// Code of the problem. Codes are stable; texts may change.
        pub code: Code,
        /// What happened, and what to do.
        pub detail: String,
        /// The invalid field.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub field: Option<String>,
        /// Seconds until a retry is allowed.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub retry_after_secs: Option<u64>,
        /// The revision in the store, if the request is based on an earlier one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pub theirs: Option<Box<Revision>>,
    }
}
