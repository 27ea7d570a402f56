//! Chromium, and user actions in it.

use std::process::Stdio;
use std::time::Instant;

use fantoccini::actions::{
    InputSource, KeyAction, KeyActions, MOUSE_BUTTON_LEFT, MouseActions, PointerAction,
    TouchActions,
};
use fantoccini::wd::Capabilities;
use fantoccini::{Client, ClientBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

use crate::waits::{LOOK_EVERY, PATIENCE};

/// Non-printing keys, as named by WebDriver.
pub mod keys {
    #![allow(missing_docs, reason = "the names are the documentation")]
    #![allow(
        clippy::allow_attributes,
        reason = "an expectation inside of a module is not met"
    )]

    pub const ENTER: &str = "\u{e007}";
    pub const ESCAPE: &str = "\u{e00c}";
    pub const TAB: &str = "\u{e004}";
    pub const HOME: &str = "\u{e011}";
    pub const END: &str = "\u{e010}";
    pub const LEFT: &str = "\u{e012}";
    pub const UP: &str = "\u{e013}";
    pub const DOWN: &str = "\u{e015}";
    pub const RIGHT: &str = "\u{e014}";
    pub const PAGE_DOWN: &str = "\u{e00f}";
    pub const DELETE: &str = "\u{e017}";
    pub const F1: &str = "\u{e031}";
    pub const F2: &str = "\u{e032}";
    pub const F3: &str = "\u{e033}";
    pub const F4: &str = "\u{e034}";
    pub const F6: &str = "\u{e036}";
    pub const SHIFT: char = '\u{e008}';
    pub const CONTROL: char = '\u{e009}';
}

/// Graphics support of the browser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Graphics {
    /// WebGL in software.
    Software,
    /// No WebGL at all.
    None,
}

/// A browser for one test, with its driver.
#[derive(Debug)]
pub struct Browser {
    client: Client,
    driver: Child,
    /// Process id of the browser, which survives if its driver is killed.
    process: Option<i64>,
}

impl Drop for Browser {
    /// Ends the browser of a failed test, which would otherwise keep running.
    fn drop(&mut self) {
        if let Some(process) = self.process {
            let ended = std::process::Command::new("kill")
                .args(["-9", &process.to_string()])
                .stderr(Stdio::null())
                .status();
            if let Err(error) = ended {
                eprintln!("browser {process} was not ended: {error}");
            }
        }
    }
}

impl Browser {
    /// Starts a driver and a browser of 1280 by 800 pixels.
    pub async fn start(graphics: Graphics) -> Self {
        Self::start_with(graphics, &[]).await
    }

    /// Starts a browser with more command-line arguments, for settings of its user's system.
    pub async fn start_with(graphics: Graphics, more: &[&str]) -> Self {
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()
            .expect("chromedriver starts; annotate/browser/run installs it");
        let port = driver_port(&mut driver).await;
        let mut args = vec![
            "--headless=new",
            "--no-sandbox",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            "--window-size=1280,900",
            // A host that is not this machine, for the page over plain HTTP.
            "--host-resolver-rules=MAP annotate.test 127.0.0.1",
            // Expose heap size and garbage collection.
            "--js-flags=--expose-gc",
            "--enable-precise-memory-info",
        ];
        args.extend(more);
        match graphics {
            Graphics::Software => {
                args.extend(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
            }
            Graphics::None => args.extend(["--disable-gpu", "--disable-3d-apis"]),
        }
        let mut capabilities = Capabilities::new();
        capabilities.insert("goog:chromeOptions".to_owned(), json!({ "args": args }));
        let client = ClientBuilder::new(HttpConnector::new())
            .capabilities(capabilities)
            .connect(&format!("http://127.0.0.1:{port}"))
            .await
            .expect("Chromium starts");
        // Software rendering of a few hundred frames is slow on few cores.
        let mut timeouts = client.get_timeouts().await.expect("time limits");
        timeouts.set_script(Some(2 * PATIENCE));
        client
            .update_timeouts(timeouts)
            .await
            .expect("time limits are set");
        let process = client
            .capabilities()
            .and_then(|capabilities| capabilities.get("goog:processID"))
            .and_then(Value::as_i64);
        Self {
            client,
            driver,
            process,
        }
    }

    /// Ends browser and driver; a failed test ends them on drop.
    pub async fn quit(mut self) {
        self.client.clone().close().await.expect("Chromium ends");
        self.process = None;
        self.driver.kill().await.expect("the driver ends");
    }

    /// The WebDriver client, for windows and other rare commands.
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// Opens a URL.
    pub async fn open(&self, address: &str) {
        self.client.goto(address).await.expect("the page opens");
    }

    /// Runs JavaScript in the page and returns its result.
    pub async fn js(&self, script: &str) -> Value {
        self.js_with(script, Vec::new()).await
    }

    /// Runs JavaScript with arguments.
    pub async fn js_with(&self, script: &str, args: Vec<Value>) -> Value {
        self.client
            .execute(script, args)
            .await
            .unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    /// Runs an asynchronous expression in the page and returns its result.
    pub async fn js_async(&self, expression: &str) -> Value {
        let script = format!(
            "const done = arguments[arguments.length - 1]; \
             (async () => {expression})().then((value) => done({{ value }}), (error) => done({{ error: String(error) }}));"
        );
        let result = self
            .client
            .execute_async(&script, Vec::new())
            .await
            .unwrap_or_else(|error| panic!("{expression}: {error}"));
        assert!(
            result["error"].is_null(),
            "{expression}: {}",
            result["error"]
        );
        result["value"].clone()
    }

    /// Bytes of the page's heap after garbage collection.
    pub async fn heap_bytes(&self) -> u64 {
        let bytes = self
            .js("gc(); gc(); return performance.memory.usedJSHeapSize;")
            .await;
        bytes.as_u64().expect("a number of bytes")
    }

    /// Waits until the expression is true.
    pub async fn until(&self, what: &str, expression: &str) {
        let script = format!("return Boolean({expression});");
        let begun = Instant::now();
        loop {
            if self.js(&script).await == Value::Bool(true) {
                return;
            }
            if begun.elapsed() > PATIENCE {
                let page = self
                    .js("return document.body.innerText.slice(0, 2000);")
                    .await;
                panic!("not within {PATIENCE:?}: {what} ({expression}); the page says:\n{page}");
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }

    /// Waits until the server answers a request as expected: the page says what was done before it is stored.
    ///
    /// # Panics
    /// It does not happen within [`PATIENCE`].
    pub async fn until_stored(&self, what: &str, path: &str, is_so: impl Fn(&Value) -> bool) {
        let begun = Instant::now();
        loop {
            let reply = self.request("GET", path, None).await;
            if is_so(&reply["body"]) {
                return;
            }
            assert!(
                begun.elapsed() <= PATIENCE,
                "not within {PATIENCE:?}: {what}; the server says {reply}"
            );
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }

    /// Presses and releases keys, one after the other.
    pub async fn press(&self, pressed: &[&str]) {
        self.press_with(&[], pressed).await;
    }

    /// Presses keys while Control is held.
    pub async fn control(&self, pressed: &[&str]) {
        self.press_with(&[keys::CONTROL], pressed).await;
    }

    /// Presses keys while Shift is held.
    pub async fn shift(&self, pressed: &[&str]) {
        self.press_with(&[keys::SHIFT], pressed).await;
    }

    /// Types a text, letter by letter.
    pub async fn type_text(&self, text: &str) {
        let letters: Vec<String> = text.chars().map(String::from).collect();
        let letters: Vec<&str> = letters.iter().map(String::as_str).collect();
        self.press(&letters).await;
    }

    /// Presses keys while modifiers are held.
    pub async fn press_with(&self, held: &[char], pressed: &[&str]) {
        let mut actions = KeyActions::new("keyboard".to_owned());
        for &value in held {
            actions = actions.then(KeyAction::Down { value });
        }
        for key in pressed {
            let value = key.chars().next().expect("a key");
            actions = actions
                .then(KeyAction::Down { value })
                .then(KeyAction::Up { value });
        }
        for &value in held.iter().rev() {
            actions = actions.then(KeyAction::Up { value });
        }
        self.client
            .perform_actions(actions)
            .await
            .expect("keys are pressed");
    }

    /// Touches the middle of the first matching element, which must be on the screen, with a finger.
    pub async fn tap(&self, selector: &str) {
        let [x, y] = self.middle(selector).await;
        let button = MOUSE_BUTTON_LEFT;
        let touch = TouchActions::new("finger".to_owned())
            .then(PointerAction::MoveTo {
                duration: None,
                x,
                y,
            })
            .then(PointerAction::Down { button })
            .then(PointerAction::Up { button });
        self.client
            .perform_actions(touch)
            .await
            .expect("the screen is touched");
    }

    /// Drags the middle of the first matching element, which must be on the screen, to the right with the mouse, by a
    /// number of pixels.
    pub async fn drag(&self, selector: &str, by: f64) {
        let [x, y] = self.middle(selector).await;
        let button = MOUSE_BUTTON_LEFT;
        let to = |x: f64| PointerAction::MoveTo {
            duration: None,
            x,
            y,
        };
        let mouse = MouseActions::new("mouse".to_owned())
            .then(to(x))
            .then(PointerAction::Down { button })
            .then(to(x + by / 2.0))
            .then(to(x + by))
            .then(PointerAction::Up { button });
        self.client
            .perform_actions(mouse)
            .await
            .expect("the mouse is moved");
    }

    /// The middle of the first matching element on the screen, in pixels.
    async fn middle(&self, selector: &str) -> [f64; 2] {
        let at = self
            .js_with(
                "const box = document.querySelector(arguments[0]).getBoundingClientRect();
                 return [box.left + box.width / 2, box.top + box.height / 2];",
                vec![json!(selector)],
            )
            .await;
        [0, 1].map(|axis: usize| at[axis].as_f64().expect("a place"))
    }

    /// Logs in with the token in the URL, like the printed address, and opens a page.
    pub async fn log_in(&self, server: &crate::Server, token: &str, path: &str) {
        self.open(&server.page(&format!("#token={token}"))).await;
        self.until(
            "logged in",
            "document.querySelector('header.top:not([hidden])')",
        )
        .await;
        let address = self.js("return location.href;").await;
        assert!(
            !address.as_str().expect("an address").contains(token),
            "the token stays in the address bar"
        );
        self.open(&server.page(path)).await;
    }

    /// Sends a request in the page's session. Returns `{status, body}`.
    pub async fn request(&self, method: &str, path: &str, body: Option<Value>) -> Value {
        self.fetch(method, path, body, None).await
    }

    /// Sends a request with the token of another user.
    pub async fn request_as(
        &self,
        token: &str,
        method: &str,
        path: &str,
        body: Option<Value>,
    ) -> Value {
        self.fetch(method, path, body, Some(token)).await
    }

    async fn fetch(
        &self,
        method: &str,
        path: &str,
        body: Option<Value>,
        token: Option<&str>,
    ) -> Value {
        let headers = match token {
            Some(token) => {
                json!({ "Authorization": format!("Bearer {token}"), "Content-Type": "application/json" })
            }
            None => json!({ "X-Annotate": "1", "Content-Type": "application/json" }),
        };
        let mut init = json!({ "method": method, "headers": headers });
        init["credentials"] = json!(if token.is_some() {
            "omit"
        } else {
            "same-origin"
        });
        if let Some(body) = body {
            init["body"] = json!(body.to_string());
        }
        self.js_async(&format!(
            "{{ const response = await fetch({}, {init}); const text = await response.text(); \
             return {{ status: response.status, body: text === '' ? null : JSON.parse(text) }}; }}",
            json!(format!("/api/v1/{path}"))
        ))
        .await
    }

    /// The number of the task on the page, once one is shown and drawn.
    pub async fn task(&self) -> i64 {
        self.until(
            "a task is shown",
            "document.querySelector('.work[data-task]') && document.querySelector('.stage canvas')",
        )
        .await;
        let task = self
            .js("return Number(document.querySelector('.work').dataset.task);")
            .await;
        task.as_i64().expect("a number")
    }

    /// Waits until another task than this is shown.
    pub async fn next_task(&self, task: i64) -> i64 {
        self.until(
            "the next task is shown",
            &format!("document.querySelector('.work') && document.querySelector('.work').dataset.task !== '{task}'"),
        )
        .await;
        self.task().await
    }

    /// Waits until all changes are saved on the server.
    pub async fn saved(&self) {
        self.until(
            "saved",
            "document.querySelector('.chip').dataset.state === 'saved'",
        )
        .await;
    }

    /// Moves the focus to a link, a button or a field with the Tab key.
    pub async fn tab_to(&self, label: &str) {
        const MOST: usize = 60;
        for _ in 0..MOST {
            let here = self
                .js("const at = document.activeElement; return at.getAttribute('aria-label') ?? at.textContent;")
                .await;
            if here.as_str().is_some_and(|text| text.trim() == label) {
                return;
            }
            self.press(&[keys::TAB]).await;
        }
        panic!("{label} is not within {MOST} steps of the Tab key");
    }

    /// Saves screenshots of the page in two sizes if ANNOTATE_PICTURES names a folder.
    pub async fn picture(&self, name: &str) {
        if std::env::var_os("ANNOTATE_PICTURES").is_some() {
            self.in_each_size(name, async |_| {}).await;
        }
    }

    /// Checks the page in two sizes, and saves a screenshot of each if ANNOTATE_PICTURES names a folder.
    pub async fn in_each_size(&self, name: &str, check: impl AsyncFn(u32)) {
        // Take the smaller size last: tests continue in it.
        for (width, height) in [(1920, 1080), (1280, 800)] {
            self.resize(width, height).await;
            self.photograph(&format!("{name}-{width}")).await;
            check(width).await;
        }
    }

    /// Gives the page a size in pixels, and waits until it is drawn.
    pub async fn resize(&self, width: u32, height: u32) {
        let edge = self
            .js("return [outerWidth - innerWidth, outerHeight - innerHeight];")
            .await;
        let edge = |at: usize| edge[at].as_u64().unwrap_or(0) as u32;
        self.client
            .set_window_size(width + edge(0), height + edge(1))
            .await
            .expect("the window has another size");
        self.js_async("{ await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))); return null; }")
            .await;
    }

    /// Saves a screenshot if ANNOTATE_PICTURES names a folder.
    pub async fn photograph(&self, name: &str) {
        if let Some(folder) = std::env::var_os("ANNOTATE_PICTURES") {
            let png = self.client.screenshot().await.expect("a picture");
            let path = std::path::Path::new(&folder).join(format!("{name}.png"));
            std::fs::write(&path, png).expect("the picture is kept");
        }
    }

    /// The text of the first matching element.
    pub async fn text_of(&self, selector: &str) -> String {
        let text = self
            .js_with(
                "return document.querySelector(arguments[0]).textContent;",
                vec![json!(selector)],
            )
            .await;
        text.as_str().expect("a text").to_owned()
    }
}

/// The port chosen and printed by the driver.
async fn driver_port(driver: &mut Child) -> u16 {
    let stdout = driver.stdout.take().expect("stdout is piped");
    let mut lines = BufReader::new(stdout).lines();
    let found = tokio::time::timeout(PATIENCE, async {
        while let Ok(Some(line)) = lines.next_line().await {
            if let Some(rest) = line.split("successfully on port ").nth(1) {
                let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
                if let Ok(port) = digits.parse() {
                    return port;
                }
            }
        }
        panic!("chromedriver did not say its port");
    })
    .await
    .expect("chromedriver starts in time");
    tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
    found
}
