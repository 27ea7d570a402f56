//! Chromium, and user actions in it.

use std::process::{Command, Stdio};

use fantoccini::actions::{
    Actions, InputSource, KeyAction, KeyActions, MOUSE_BUTTON_LEFT, MouseActions, PointerAction,
    TouchActions,
};
use fantoccini::wd::{Capabilities, WindowHandle};
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};

use crate::waits::{PATIENCE, Program, in_time, wait};

/// Number of attempts to start the driver.
const STARTS: usize = 5;

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
    /// Process id of the browser, which survives if its driver is killed.
    process: Option<i64>,
    _driver: Program,
}

impl Drop for Browser {
    /// Closes the browser. After a failed test, it is killed instead: it may not respond to commands, and would keep
    /// running.
    fn drop(&mut self) {
        if !std::thread::panicking() {
            wait(self.client.clone().close()).expect("Chromium ends");
        } else if let Some(process) = self.process {
            let mut kill = Command::new("kill");
            let kill = kill.args(["-9", &process.to_string()]);
            if let Err(error) = kill.stderr(Stdio::null()).status() {
                eprintln!("browser {process} was not ended: {error}");
            }
        }
    }
}

/// A JavaScript expression for the first matching element.
fn element(selector: &str) -> String {
    format!("document.querySelector({})", json!(selector))
}

impl Browser {
    /// Starts a driver and a browser with a window of 1280 by 900 pixels. `more` are extra command-line arguments, such
    /// as the settings of a user's system.
    pub fn start(graphics: Graphics, more: &[&str]) -> Self {
        let mut driver = Command::new("chromedriver");
        driver.arg("--port=0").stderr(Stdio::null());
        // The driver draws a port, and ends if another process holds that port. Each start draws another one.
        let mut starts = (0..STARTS).map(|_| Program::start(&mut driver, driver_port));
        let started = starts.find_map(Result::ok);
        let (driver, port) = started.unwrap_or_else(|| panic!("{driver:?} ended {STARTS} times"));
        let mut args = vec![
            "--headless=new",
            "--no-sandbox",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            "--window-size=1280,900",
            // A name of this machine other than localhost, which browsers trust even without TLS.
            "--host-resolver-rules=MAP annotate.test 127.0.0.1",
            // Expose heap size and garbage collection.
            "--js-flags=--expose-gc",
            "--enable-precise-memory-info",
        ];
        args.extend(more);
        args.extend(match graphics {
            Graphics::Software => ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
            Graphics::None => ["--disable-gpu", "--disable-3d-apis"],
        });
        let mut capabilities = Capabilities::new();
        capabilities.insert("goog:chromeOptions".to_owned(), json!({ "args": args }));
        let mut builder = ClientBuilder::new(HttpConnector::new());
        builder.capabilities(capabilities);
        let client = wait(builder.connect(&format!("http://127.0.0.1:{port}")));
        let client = client.expect("Chromium starts");
        // Scripts may take longer, because software rendering of a few hundred frames is slow on few cores.
        let mut timeouts = wait(client.get_timeouts()).expect("time limits");
        timeouts.set_script(Some(2 * PATIENCE));
        wait(client.update_timeouts(timeouts)).expect("time limits are set");
        let capabilities = client.capabilities();
        let process = capabilities.and_then(|own| own.get("goog:processID")?.as_i64());
        Self {
            client,
            process,
            _driver: driver,
        }
    }

    /// Opens a URL.
    pub fn open(&self, address: &str) {
        wait(self.client.goto(address)).expect("the page opens");
    }

    /// Reloads the page.
    pub fn reload(&self) {
        wait(self.client.refresh()).expect("the page reloads");
    }

    /// Goes back to the previous page of the history.
    pub fn back(&self) {
        wait(self.client.back()).expect("the page before");
    }

    /// The tab that is shown.
    pub fn window(&self) -> WindowHandle {
        wait(self.client.window()).expect("a window")
    }

    /// All tabs.
    pub fn windows(&self) -> Vec<WindowHandle> {
        wait(self.client.windows()).expect("windows")
    }

    /// Opens a tab, without showing it.
    pub fn new_tab(&self) -> WindowHandle {
        wait(self.client.new_window(true)).expect("a tab").handle
    }

    /// Shows a tab.
    pub fn switch_to(&self, window: &WindowHandle) {
        wait(self.client.switch_to_window(window.clone())).expect("the tab is shown");
    }

    /// Closes the tab that is shown.
    pub fn close_tab(&self) {
        wait(self.client.close_window()).expect("the tab is closed");
    }

    /// Runs JavaScript in the page and returns its result.
    pub fn js(&self, script: &str) -> Value {
        self.js_with(script, Vec::new())
    }

    /// Runs JavaScript with arguments.
    pub fn js_with(&self, script: &str, args: Vec<Value>) -> Value {
        wait(self.client.execute(script, args)).unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    /// Runs an asynchronous expression in the page and returns its result.
    pub fn js_async(&self, expression: &str) -> Value {
        let script = format!(
            "const done = arguments[arguments.length - 1]; \
             (async () => {expression})().then((value) => done({{ value }}), (error) => done({{ error: String(error) }}));"
        );
        let result = wait(self.client.execute_async(&script, Vec::new()));
        let mut result = result.unwrap_or_else(|error| panic!("{expression}: {error}"));
        let error = &result["error"];
        assert!(error.is_null(), "{expression}: {error}");
        result["value"].take()
    }

    /// The value of an expression in the page.
    pub fn value(&self, expression: &str) -> Value {
        self.js(&format!("return {expression};"))
    }

    /// Checks the value of an expression in the page.
    pub fn is(&self, expression: &str, expected: impl Into<Value>) {
        assert_eq!(self.value(expression), expected.into(), "{expression}");
    }

    /// Number of matching elements.
    pub fn count(&self, selector: &str) -> u64 {
        let all = format!("document.querySelectorAll({}).length", json!(selector));
        self.value(&all).as_u64().expect("a number")
    }

    /// The text of the first matching element.
    pub fn text_of(&self, selector: &str) -> String {
        let text = self.value(&format!("{}.textContent", element(selector)));
        text.as_str().expect("a text").to_owned()
    }

    /// Checks that the text of the first matching element contains each of these phrases.
    pub fn reads(&self, selector: &str, words: &[&str]) {
        let text = self.text_of(selector);
        for words in words {
            assert!(text.contains(words), "{words} is missing: {text}");
        }
    }

    /// Bytes of the page's heap after garbage collection.
    pub fn heap_bytes(&self) -> u64 {
        let bytes = self.js("gc(); gc(); return performance.memory.usedJSHeapSize;");
        bytes.as_u64().expect("a number of bytes")
    }

    /// Waits until the expression is true.
    pub fn until(&self, what: &str, expression: &str) {
        let script = format!("return Boolean({expression});");
        if !in_time(|| self.js(&script) == true) {
            let page = self.value("document.body.innerText.slice(0, 2000)");
            panic!("not within {PATIENCE:?}: {what} ({expression}); the page says:\n{page}");
        }
    }

    /// Waits until there is a matching element.
    pub fn shows(&self, selector: &str) {
        self.until(selector, &element(selector));
    }

    /// Waits until there is no matching element.
    pub fn lacks(&self, selector: &str) {
        self.until(selector, &format!("!{}", element(selector)));
    }

    /// Waits until there is this number of matching elements.
    pub fn has(&self, selector: &str, number: u64) {
        let all = format!("document.querySelectorAll({})", json!(selector));
        self.until(selector, &format!("{all}.length === {number}"));
    }

    /// Waits until the text of the first matching element contains these words.
    pub fn says(&self, selector: &str, words: &str) {
        let says = format!("?.textContent.includes({})", json!(words));
        self.until(words, &(element(selector) + &says));
    }

    /// Waits until a matching element has the focus.
    pub fn focuses(&self, selector: &str) {
        let matches = format!("document.activeElement?.matches({})", json!(selector));
        self.until(&format!("the focus on {selector}"), &matches);
    }

    /// Gives the first matching element the focus.
    pub fn focus(&self, selector: &str) {
        self.js(&format!("{}.focus();", element(selector)));
    }

    /// Clicks the first matching element, without moving the mouse there.
    pub fn click(&self, selector: &str) {
        self.js(&format!("{}.click();", element(selector)));
    }

    /// Clicks the first matching element with the mouse.
    pub fn click_with_mouse(&self, selector: &str) {
        let found = wait(self.client.find(Locator::Css(selector))).expect("an element");
        wait(found.click()).expect("it can be clicked");
    }

    /// Chooses a file in the first matching field.
    pub fn choose_file(&self, selector: &str, path: &str) {
        let field = wait(self.client.find(Locator::Css(selector))).expect("a field");
        wait(field.send_keys(path)).expect("a file is chosen");
    }

    /// Waits until a button is enabled, and clicks it. It is found by its choice, accessible name or text, in the open
    /// dialog or, if none is open, in the first matching element.
    pub fn press_button(&self, within: &str, label: &str) {
        let button = format!(
            "[...((document.querySelector('dialog[open]') ?? {})?.querySelectorAll('button:not([disabled])') ?? [])] \
             .find((own) => (own.dataset.choice ?? own.getAttribute('aria-label') ?? own.textContent).trim() === {})",
            element(within),
            json!(label)
        );
        self.until(label, &button);
        self.js(&format!("{button}.click();"));
    }

    /// Presses and releases keys, one after the other.
    pub fn press(&self, pressed: &[&str]) {
        self.press_with(&[], pressed);
    }

    /// Presses keys while Control is held.
    pub fn control(&self, pressed: &[&str]) {
        self.press_with(&[keys::CONTROL], pressed);
    }

    /// Presses keys while Shift is held.
    pub fn shift(&self, pressed: &[&str]) {
        self.press_with(&[keys::SHIFT], pressed);
    }

    /// Presses keys while Control and Shift are held.
    pub fn control_shift(&self, pressed: &[&str]) {
        self.press_with(&[keys::CONTROL, keys::SHIFT], pressed);
    }

    /// Types a text, letter by letter.
    pub fn type_text(&self, text: &str) {
        let letters: Vec<String> = text.chars().map(String::from).collect();
        let letters: Vec<&str> = letters.iter().map(String::as_str).collect();
        self.press(&letters);
    }

    /// Presses keys, the last of which focuses a text field, and types the text.
    pub fn write(&self, pressed: &[&str], text: &str) {
        self.press(pressed);
        self.type_text(text);
    }

    /// Presses keys while modifiers are held.
    fn press_with(&self, held: &[char], pressed: &[&str]) {
        let mut actions = KeyActions::new("keyboard".to_owned());
        for &value in held {
            actions = actions.then(KeyAction::Down { value });
        }
        for key in pressed {
            let value = key.chars().next().expect("a key");
            actions = actions.then(KeyAction::Down { value });
            actions = actions.then(KeyAction::Up { value });
        }
        for &value in held.iter().rev() {
            actions = actions.then(KeyAction::Up { value });
        }
        self.act(actions);
    }

    /// Touches the middle of the first matching element with a finger. The element must be on the screen.
    pub fn tap(&self, selector: &str) {
        let button = MOUSE_BUTTON_LEFT;
        let touch = TouchActions::new("finger".to_owned())
            .then(self.to_middle(selector, 0.0))
            .then(PointerAction::Down { button })
            .then(PointerAction::Up { button });
        self.act(touch);
    }

    /// Drags the first matching element to the right by `by` pixels with the mouse. The element must be on the screen.
    pub fn drag(&self, selector: &str, by: f64) {
        let button = MOUSE_BUTTON_LEFT;
        let mouse = MouseActions::new("mouse".to_owned())
            .then(self.to_middle(selector, 0.0))
            .then(PointerAction::Down { button })
            .then(self.to_middle(selector, by / 2.0))
            .then(self.to_middle(selector, by))
            .then(PointerAction::Up { button });
        self.act(mouse);
    }

    /// A pointer move to `right` pixels right of the middle of the first matching element.
    fn to_middle(&self, selector: &str, right: f64) -> PointerAction {
        let at = self.js_with(
            "const box = document.querySelector(arguments[0]).getBoundingClientRect();
             return [box.left + box.width / 2, box.top + box.height / 2];",
            vec![json!(selector)],
        );
        let [x, y] = [0, 1].map(|axis: usize| at[axis].as_f64().expect("a place"));
        PointerAction::MoveTo {
            duration: None,
            x: x + right,
            y,
        }
    }

    fn act(&self, actions: impl Into<Actions>) {
        wait(self.client.perform_actions(actions)).expect("the actions are performed");
    }

    /// Logs in with the token in the URL, like the address that the server prints, and opens a page.
    pub fn log_in(&self, server: &crate::Server, token: &str, path: &str) {
        self.open(&server.page(&format!("#token={token}")));
        self.shows("header.top:not([hidden])");
        let address = self.value("location.href").to_string();
        assert!(!address.contains(token), "{address} still has the token");
        self.open(&server.page(path));
    }

    /// Waits until a task is shown and drawn, and returns its number.
    pub fn task(&self) -> i64 {
        self.until(
            "a task is shown",
            "document.querySelector('.work[data-task]') && document.querySelector('.stage canvas')",
        );
        let task = self.value("Number(document.querySelector('.work').dataset.task)");
        task.as_i64().expect("a number")
    }

    /// Waits until the page no longer shows this task.
    pub fn leaves(&self, task: i64) {
        self.lacks(&format!(".work[data-task=\"{task}\"]"));
    }

    /// Waits until a task other than this one is shown, and returns its number.
    pub fn next_task(&self, task: i64) -> i64 {
        self.until(
            "the next task is shown",
            &format!("document.querySelector('.work') && document.querySelector('.work').dataset.task !== '{task}'"),
        );
        self.task()
    }

    /// Waits until all changes are saved on the server.
    pub fn saved(&self) {
        self.shows(".chip[data-state=saved]");
    }

    /// Marks the current page with `data-left`; the next page does not have this mark.
    pub fn mark(&self) {
        self.js(
            "document.querySelector('#main')?.firstElementChild?.setAttribute('data-left', '');",
        );
    }

    /// Moves the focus to a link, a button or a field with the Tab key.
    pub fn tab_to(&self, label: &str) {
        const MOST: usize = 60;
        for _ in 0..MOST {
            let here = self.js("const at = document.activeElement; return at.getAttribute('aria-label') ?? at.textContent;");
            if here.as_str().is_some_and(|text| text.trim() == label) {
                return;
            }
            self.press(&[keys::TAB]);
        }
        panic!("{label} is not within {MOST} steps of the Tab key");
    }

    /// Whether pressing F6, which cycles through the regions of the page, moves the focus into an element.
    pub fn reaches(&self, selector: &str) -> bool {
        const REGIONS: usize = 6;
        let inside = format!("document.activeElement.closest('{selector}') !== null");
        for _ in 0..REGIONS {
            if self.value(&inside) == true {
                return true;
            }
            self.press(&[keys::F6]);
        }
        self.value(&inside) == true
    }

    /// Saves screenshots of the page in two sizes if ANNOTATE_PICTURES names a folder.
    pub fn picture(&self, name: &str) {
        if std::env::var_os("ANNOTATE_PICTURES").is_some() {
            self.in_each_size(name, |_| {});
        }
    }

    /// Checks the page in two sizes, and saves a screenshot of each if ANNOTATE_PICTURES names a folder.
    pub fn in_each_size(&self, name: &str, check: impl Fn(u32)) {
        // Take the smaller size last: tests continue in it.
        for (width, height) in [(1920, 1080), (1280, 800)] {
            self.resize(width, height);
            self.photograph(&format!("{name}-{width}"));
            check(width);
        }
    }

    /// Sets the page's size in pixels, and waits until it is drawn.
    pub fn resize(&self, width: u32, height: u32) {
        let mut window = [width, height];
        // The first size shows how much of the window is not the page. It can't be read from the size before: below
        // the smallest width of a window, Chromium reports a larger window than it draws.
        for _ in 0..2 {
            wait(self.client.set_window_size(window[0], window[1]))
                .expect("the window has another size");
            self.js_async("{ await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))); return null; }");
            let page = self.value("[innerWidth, innerHeight]");
            let drawn = |at: usize| page[at].as_u64().unwrap_or(0) as u32;
            window = [window[0] + width - drawn(0), window[1] + height - drawn(1)];
        }
    }

    /// Saves a screenshot if ANNOTATE_PICTURES names a folder.
    pub fn photograph(&self, name: &str) {
        if let Some(folder) = std::env::var_os("ANNOTATE_PICTURES") {
            let png = wait(self.client.screenshot()).expect("a picture");
            let path = std::path::Path::new(&folder).join(format!("{name}.png"));
            std::fs::write(&path, png).expect("the picture is kept");
        }
    }
}

/// Parses the port from the driver's line of output.
fn driver_port(line: &str) -> Option<u16> {
    let rest = line.split("successfully on port ").nth(1)?;
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}
