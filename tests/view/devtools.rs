//! Headless Chromium, driven by its DevTools protocol over two named pipes.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Longest wait for what a page should come to.
const PATIENCE: Duration = Duration::from_secs(60);

/// A page in a browser.
pub struct Page {
    browser: Child,
    commands: File,
    answers: BufReader<File>,
    session: Option<String>,
    last_id: u64,
    /// Events of the browser between answers.
    events: VecDeque<Value>,
    _profile: tempfile::TempDir,
}

impl Page {
    /// Opens an address. `None` without Chromium.
    pub fn open(address: &str) -> Option<Self> {
        let is_there = Command::new("chromium")
            .arg("--version")
            .stderr(Stdio::null())
            .output();
        if !is_there.is_ok_and(|output| output.status.success()) {
            println!("skipped: needs `chromium` (apt-get install chromium)");
            return None;
        }
        let mut page = Self::start();
        let target = page.send("Target.createTarget", json!({"url": "about:blank"}))["targetId"].clone();
        let attached = page.send(
            "Target.attachToTarget",
            json!({"targetId": target, "flatten": true}),
        );
        page.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page", "Runtime", "Log", "Network"] {
            page.send(&format!("{domain}.enable"), json!({}));
        }
        page.send("Page.navigate", json!({"url": address}));
        page.waits_for("document.readyState === 'complete'");
        Some(page)
    }

    fn start() -> Self {
        let profile = tempfile::tempdir().unwrap();
        let [to, from] = ["to", "from"].map(|name| profile.path().join(name));
        assert!(
            Command::new("mkfifo")
                .args([&to, &from])
                .status()
                .unwrap()
                .success()
        );
        // Chromium reads commands from descriptor 3 and writes answers to 4.
        let script = "exec chromium --headless --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader \
            --disable-dev-shm-usage --window-size=1280,1000 \
            --remote-debugging-pipe --user-data-dir=\"$0\" 3<\"$1\" 4>\"$2\"";
        let browser = Command::new("sh")
            .arg("-c")
            .arg(script)
            .args([&profile.path().join("profile"), &to, &from])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Self {
            browser,
            commands: File::options().write(true).open(&to).unwrap(),
            answers: BufReader::new(File::open(&from).unwrap()),
            session: None,
            last_id: 0,
            events: VecDeque::new(),
            _profile: profile,
        }
    }

    /// Sends a command and returns its result.
    pub fn send(&mut self, method: &str, params: Value) -> Value {
        self.last_id += 1;
        let mut command = json!({"id": self.last_id, "method": method, "params": params});
        if let Some(session) = &self.session {
            command["sessionId"] = json!(session);
        }
        self.commands
            .write_all(format!("{command}\0").as_bytes())
            .unwrap();
        loop {
            let mut bytes = Vec::new();
            self.answers.read_until(0, &mut bytes).unwrap();
            assert_eq!(bytes.pop(), Some(0), "Chromium has ended");
            let message: Value = serde_json::from_slice(&bytes).unwrap();
            if message["id"] != self.last_id {
                self.events.push_back(message);
                continue;
            }
            assert!(message["error"].is_null(), "{method}: {message}");
            return message["result"].clone();
        }
    }

    /// Returns the value of an expression.
    pub fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let result = self.send("Runtime.evaluate", params);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    #[track_caller]
    pub fn waits_for(&mut self, expression: &str) {
        let began = Instant::now();
        while self.value(expression) != json!(true) {
            assert!(
                began.elapsed() < PATIENCE,
                "never true: {expression}\n{:?}",
                self.complaints()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Unfolds what is folded.
    pub fn opens_all_sections(&mut self) {
        self.value("document.querySelectorAll('details').forEach((one) => { one.open = true; })");
    }

    /// Presses the left button at a place, moves by some pixels, and lets it go.
    pub fn drags(&mut self, [x, y]: [f64; 2], [dx, dy]: [f64; 2]) {
        for (kind, x, y, buttons) in [
            ("mousePressed", x, y, 1),
            ("mouseMoved", x + dx, y + dy, 1),
            ("mouseReleased", x + dx, y + dy, 0),
        ] {
            let event =
                json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1});
            self.send("Input.dispatchMouseEvent", event);
        }
    }

    /// Presses a key. `text` is the text it types, empty for a key without text.
    pub fn presses_key(&mut self, key: &str, code: &str, number: u32, text: &str) {
        self.key("keyDown", key, code, number, text);
        self.key("keyUp", key, code, number, "");
    }

    /// Holds a key for some time.
    pub fn holds(&mut self, key: &str, code: &str, number: u32, time_ms: u64) {
        self.key("keyDown", key, code, number, "");
        std::thread::sleep(Duration::from_millis(time_ms));
        self.key("keyUp", key, code, number, "");
    }

    fn key(&mut self, kind: &str, key: &str, code: &str, number: u32, text: &str) {
        let mut event = json!({"type": kind, "key": key, "code": code, "windowsVirtualKeyCode": number});
        if !text.is_empty() {
            event["text"] = json!(text);
        }
        self.send("Input.dispatchKeyEvent", event);
    }

    /// Keeps a picture of the window, to be looked at.
    pub fn keeps(&mut self, name: &str) {
        use base64::Engine as _;
        let shot = self.send("Page.captureScreenshot", json!({"format": "png"}));
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(shot["data"].as_str().unwrap())
            .unwrap();
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("view");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(name), bytes).unwrap();
    }

    /// Returns errors and messages of the console, and exceptions.
    pub fn complaints(&self) -> Vec<String> {
        let kinds = [
            "Runtime.consoleAPICalled",
            "Runtime.exceptionThrown",
            "Log.entryAdded",
        ];
        self.events_of(&kinds)
            .map(|event| event["params"].to_string())
            .collect()
    }

    /// Returns the addresses that the page has asked for.
    pub fn asked_for(&self) -> Vec<String> {
        let requests = self.events_of(&["Network.requestWillBeSent"]);
        requests
            .map(|event| event["params"]["request"]["url"].as_str().unwrap().to_owned())
            .collect()
    }

    fn events_of<'p>(&'p self, kinds: &'p [&str]) -> impl Iterator<Item = &'p Value> {
        self.events
            .iter()
            .filter(|event| kinds.iter().any(|kind| event["method"] == *kind))
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.browser.kill();
        let _ = self.browser.wait();
    }
}
