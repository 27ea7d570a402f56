//! Drafts by a language model behind an OpenAI-compatible chat endpoint.
//!
//! Only the operator sets the address; redirects are not followed. A response is a draft for a person to judge,
//! never an answer; it is truncated and stripped of control characters. Without a model everything else works.

use std::time::Duration;

use datasets_spec::BodyPart;
use serde_json::{Value, json};

use crate::Error;
use crate::store::{NewSuggestion, Store, TaskRecord, sha256};
use crate::wire::{Code, SuggestionSource, TaskKind};

/// Maximum number of requests to the model that one person can make per minute.
pub const MAX_REQUESTS_PER_MINUTE: u32 = 30;
/// Timeout of a request to the model.
const TIMEOUT: Duration = Duration::from_secs(12);
/// Maximum characters of a draft.
const MAX_DRAFT_CHARS: usize = 300;
/// Maximum bytes of a response.
const MAX_RESPONSE_BYTES: u64 = 256 * 1024;
/// Maximum characters of a caption in a prompt; the rest is cut off.
const MAX_CAPTION_CHARS: usize = 500;
/// Maximum number of captions in a prompt.
const MAX_CAPTIONS: usize = 6;

/// Client of a language model.
pub struct Model {
    url: String,
    name: String,
    key: Option<String>,
    agent: ureq::Agent,
}

const SYSTEM: &str =
    "You help to annotate human motion. Answer with one short English phrase and nothing else.";

/// A failure of the model. Its own error text is not passed on: it could contain the key.
fn failed(problem: &str) -> Error {
    let problem = format!("the language model {problem}; write the text yourself or ask again");
    Error::refused(Code::ModelFailed, problem)
}

impl Model {
    /// A model at base address `url`, such as `http://localhost:8000/v1`.
    ///
    /// # Errors
    /// The address is not HTTP, or contains a user or a password.
    pub fn new(url: &str, name: &str, key: Option<String>) -> Result<Self, Error> {
        let refuse = |problem: &str| Error::import("the address of the language model", problem);
        let rest = url
            .strip_prefix("https://")
            .or_else(|| url.strip_prefix("http://"))
            .ok_or_else(|| refuse("it has to begin with http:// or https://"))?;
        if rest
            .split('/')
            .next()
            .is_none_or(|host| host.is_empty() || host.contains('@'))
        {
            return Err(refuse("it has to name a host, without user and password"));
        }
        let agent = ureq::Agent::config_builder()
            .timeout_global(Some(TIMEOUT))
            .max_redirects(0)
            .http_status_as_error(false)
            .build()
            .new_agent();
        Ok(Self {
            url: url.trim_end_matches('/').to_owned(),
            name: name.to_owned(),
            key: key.filter(|key| !key.is_empty()),
            agent,
        })
    }

    /// Name of the model.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Requests a draft, or returns the stored response to the same prompt.
    ///
    /// # Errors
    /// `model_failed`, or the store fails.
    pub fn suggest(
        &self,
        store: &Store,
        task: &TaskRecord,
        parts: &[BodyPart],
    ) -> Result<NewSuggestion, Error> {
        let hashes = std::iter::once(task.source.clone()).chain(task.target.clone());
        let motions = store.motions(hashes.collect())?;
        let captions = motions.iter().flat_map(|motion| &motion.captions);
        let question = question(task, captions, parts);
        let messages = [("system", SYSTEM), ("user", question.as_str())]
            .map(|(role, content)| json!({ "role": role, "content": content }));
        let mut request = json!({ "temperature": 0.2, "max_tokens": 80 });
        let params = request.to_string();
        request["model"] = json!(self.name);
        request["messages"] = json!(messages);
        let body = request.to_string();
        let prompt_hash = sha256(format!("{}\n{body}", self.url).as_bytes());
        if let Some(known) = store.cached_suggestion(&prompt_hash)? {
            return Ok(known);
        }
        let response = self.ask(body.as_bytes())?;
        let unexpected = || failed("sent an unexpected response");
        let answer: Value = serde_json::from_slice(&response).map_err(|_| unexpected())?;
        let content = &answer["choices"][0]["message"]["content"];
        let text = plain(content.as_str().ok_or_else(unexpected)?);
        if text.is_empty() {
            return Err(failed("sent an empty response"));
        }
        Ok(NewSuggestion {
            source: SuggestionSource::Llm,
            parts: parts.iter().map(|part| part.name().to_owned()).collect(),
            text,
            model: self.name.clone(),
            prompt_hash,
            params,
            tokens: answer["usage"]["total_tokens"].as_i64(),
            response_hash: sha256(&response),
        })
    }

    fn ask(&self, body: &[u8]) -> Result<Vec<u8>, Error> {
        let mut request = self
            .agent
            .post(format!("{}/chat/completions", self.url))
            .header("Content-Type", "application/json");
        if let Some(key) = &self.key {
            request = request.header("Authorization", format!("Bearer {key}"));
        }
        let mut response = request.send(body).map_err(|error| match error {
            ureq::Error::Timeout(_) => failed("took too long"),
            _ => failed("cannot be reached"),
        })?;
        let status = response.status().as_u16();
        if status != 200 {
            return Err(failed(&format!("answered with status {status}")));
        }
        response
            .body_mut()
            .with_config()
            .limit(MAX_RESPONSE_BYTES)
            .read_to_vec()
            .map_err(|_| failed("broke off, or sent too long a response"))
    }
}

fn question<'a>(
    task: &TaskRecord,
    captions: impl Iterator<Item = &'a String>,
    parts: &[BodyPart],
) -> String {
    let parts: Vec<String> = parts.iter().map(|part| part.phrase()).collect();
    let parts = parts.join(" and ");
    let captions: Vec<String> = captions
        .take(MAX_CAPTIONS)
        .map(|caption| {
            let capped: String = caption.chars().take(MAX_CAPTION_CHARS).collect();
            format!("- {}", plain(&capped))
        })
        .collect();
    let captions = if captions.is_empty() {
        "- (none)".to_owned()
    } else {
        captions.join("\n")
    };
    match task.kind {
        TaskKind::MaskText => format!(
            "Captions of a motion:\n{captions}\n\nSay what the {parts} of the person does, to complete \"The person is ...\". Leave out what other parts of the body do."
        ),
        TaskKind::Pair => format!(
            "Captions of a motion:\n{captions}\nIt was edited in the {parts}{}.\n\nGive the instruction for this edit, as an order to the person. Leave out what other parts of the body do.",
            task.hint
                .as_ref()
                .map_or(String::new(), |hint| format!(", for: {}", plain(hint)))
        ),
        TaskKind::Style => format!(
            "Captions of a motion:\n{captions}\nA second person performs it in the style {:?}, seen in the {parts}.\n\nGive the instruction that turns the first into the second.",
            task.style.as_deref().unwrap_or("unknown")
        ),
    }
}

/// A response as one line of up to [`MAX_DRAFT_CHARS`] characters, without quotes around it and without control and
/// bidirectional-text characters.
fn plain(text: &str) -> String {
    let turns = |c: &char| matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let spaced: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .filter(|c| !turns(c))
        .collect();
    let line = Vec::from_iter(spaced.split_whitespace()).join(" ");
    let short = line.trim_matches('"').chars().take(MAX_DRAFT_CHARS);
    short.collect::<String>().trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drafts_become_one_plain_line() {
        assert_eq!(
            plain("\"waving\n their\tarm\u{202e}\u{0}\""),
            "waving their arm"
        );
        assert_eq!(plain(&"x".repeat(1000)).len(), MAX_DRAFT_CHARS);
    }

    #[test]
    fn only_web_addresses_are_taken() {
        for (url, fine) in [
            ("http://localhost:8000/v1", true),
            ("https://models.example/v1/", true),
            ("file:///etc/passwd", false),
            ("http://user:secret@host/v1", false),
            ("http:///v1", false),
        ] {
            assert_eq!(Model::new(url, "m", None).is_ok(), fine, "{url}");
        }
    }
}
