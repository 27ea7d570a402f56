//! Requests to the server from the page, with its session or with another user's token.

use serde_json::{Value, json};

use crate::Browser;
use crate::waits::in_time;

impl Browser {
    /// Sends a request in the page's session. Returns `{status, body}`.
    pub fn request(&self, method: &str, path: &str, body: Option<Value>) -> Value {
        self.fetch(method, path, body, None)
    }

    /// Sends a request with the token of another user. Returns `{status, body}`.
    pub fn request_as(&self, token: &str, method: &str, path: &str, body: Option<Value>) -> Value {
        self.fetch(method, path, body, Some(token))
    }

    fn fetch(&self, method: &str, path: &str, body: Option<Value>, token: Option<&str>) -> Value {
        let mut init = match token {
            Some(token) => {
                json!({ "credentials": "omit", "headers": { "Authorization": format!("Bearer {token}") } })
            }
            None => json!({ "credentials": "same-origin", "headers": { "X-Annotate": "1" } }),
        };
        init["method"] = json!(method);
        init["headers"]["Content-Type"] = json!("application/json");
        if let Some(body) = body {
            init["body"] = json!(body.to_string());
        }
        self.js_async(&format!(
            "{{ const response = await fetch({}, {init}); const text = await response.text(); \
             return {{ status: response.status, body: text === '' ? null : JSON.parse(text) }}; }}",
            json!(format!("/api/v1/{path}"))
        ))
    }

    /// Response of the server to a GET request in the page's session.
    pub fn get(&self, path: &str) -> Value {
        let mut reply = self.request("GET", path, None);
        assert_eq!(reply["status"], 200, "{path}: {reply}");
        reply["body"].take()
    }

    /// Ends the page's session.
    pub fn log_out(&self) {
        let ended = self.request("DELETE", "session", None);
        assert_eq!(ended["status"], 204, "{ended}");
    }

    /// Polls the server until a response meets the condition, because the page shows changes before they are stored.
    ///
    /// # Panics
    /// The condition is not met in time.
    pub fn until_stored(&self, what: &str, path: &str, is_so: impl Fn(&Value) -> bool) {
        let mut reply = Value::Null;
        let stored = in_time(|| {
            reply = self.request("GET", path, None);
            is_so(&reply["body"])
        });
        assert!(stored, "not in time: {what}; the server says {reply}");
    }

    /// The user's answer to a task, as stored on the server.
    pub fn mine(&self, task: i64) -> Value {
        self.get(&format!("tasks/{task}"))["mine"].clone()
    }
}
