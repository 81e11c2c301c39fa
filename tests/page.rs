//! The page of a session, as a browser and as somebody who means harm see it.
#![allow(clippy::unwrap_used, reason = "helpers of tests may do what tests may")]

use std::fs::Permissions;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use serde_json::{Value, json};
use tendon_system_tests::{Tendon, TendonBuilder, WATCHDOG, model, program, unique_session, wait_until};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, Message, WebSocket};

/// Within this time after a stop nobody can have seen it, ns.
const REACTION_NS: u64 = 200_000_000;

/// A page that was started, by the addresses that it printed.
struct Page {
    address: SocketAddr,
    orders: String,
    watch: String,
}

impl Page {
    fn of(tendon: &Tendon) -> Page {
        let link = |start: &str| {
            let link = wait_until("the page's address", || {
                let errors = tendon.errors_so_far();
                errors.lines().find_map(|line| line.strip_prefix(start).map(str::to_owned))
            });
            let (address, token) = link.trim_start_matches("http://").split_once("/#").unwrap();
            (address.to_owned(), token.to_owned())
        };
        let ((address, orders), (_, watch)) = (link("page: "), link("page, to watch only: "));
        Page { address: address.parse().unwrap(), orders, watch }
    }

    /// A request to become a viewer, with headers of one's own.
    fn request(&self, token: &str, headers: &[(&'static str, &str)]) -> Result<Viewer, Error> {
        let mut request = format!("ws://{}/ws?token={token}", self.address).into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, HeaderValue::from_str(value).unwrap());
        }
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Viewer(socket)),
            Err(tungstenite::HandshakeError::Failure(error)) => Err(error),
            Err(tungstenite::HandshakeError::Interrupted(_)) => panic!("no answer"),
        }
    }

    fn status(&self, token: &str, headers: &[(&'static str, &str)]) -> u16 {
        match self.request(token, headers) {
            Ok(_) => 101,
            Err(Error::Http(response)) => response.status().as_u16(),
            Err(error) => panic!("{error}"),
        }
    }

    /// A connection that says nothing, or the beginning of a request.
    fn hold(&self, is_silent: bool) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).unwrap();
        if !is_silent {
            // The server may have closed it already.
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost:");
        }
        stream
    }

    /// The first line of the answer to a plain request.
    fn plain(&self, request: &str) -> String {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = [0; 64];
        let length = stream.read(&mut answer).unwrap();
        String::from_utf8_lossy(&answer[..length]).lines().next().unwrap_or_default().to_owned()
    }
}

/// Extension moves up in the one mode and away from the base in the other.
const TWO_MODES: &str = r#"decision.modes=[{name = "z", extension = "+z", flexion = "-z", grip = "next_mode"},
    {name = "x", extension = "+x", flexion = "-x", grip = "next_mode"}]"#;

struct Viewer(WebSocket<TcpStream>);

impl Viewer {
    /// Reads until there is what is looked for. Without a pause: messages come 60 times a second, and what is read late is old.
    fn read_until<T>(&mut self, what: &str, look: impl Fn(Message) -> Option<T>) -> T {
        let begun = Instant::now();
        while begun.elapsed() < WATCHDOG {
            if let Some(found) = look(self.0.read().unwrap()) {
                return found;
            }
        }
        panic!("waited {WATCHDOG:?} in vain for {what}");
    }

    /// The next text under this name for which `is_it` holds.
    fn next(&mut self, name: &str, is_it: impl Fn(&Value) -> bool) -> Value {
        self.read_until(name, |message| match message {
            Message::Text(text) => {
                let said: Value = serde_json::from_str(&text).unwrap();
                said.get(name).filter(|said| is_it(said)).cloned()
            }
            _ => None,
        })
    }

    /// First bin and number of bins of the next frame.
    fn frame(&mut self) -> (u64, u32) {
        self.read_until("a frame", |message| match message {
            Message::Binary(frame) => {
                assert_eq!(&frame[..4], b"TEMG");
                let bins = u32::from_le_bytes(frame[28..32].try_into().unwrap());
                Some((u64::from_le_bytes(frame[8..16].try_into().unwrap()), bins))
            }
            _ => None,
        })
    }

    /// The state after all that was said before.
    fn state_now(&mut self) -> Value {
        self.state_in(0)
    }

    /// The state so much later, ns.
    fn state_in(&mut self, wait_ns: u64) -> Value {
        self.say(&json!({"ping": {"t": -1.0}}));
        let now_ns = self.next("pong", |pong| pong["t"] == -1.0)["now_ns"].as_u64().unwrap();
        self.next("state", |state| {
            state["seen_ns"].as_u64().is_some_and(|seen_ns| seen_ns > now_ns + wait_ns)
        })
    }

    /// The answer to a request.
    fn ask(&mut self, what: &Value) -> Value {
        self.say(&json!({"request": {"id": 41, "what": what}}));
        self.next("answer", |answer| answer["id"] == 41)
    }

    fn say(&mut self, what: &Value) {
        self.0.send(Message::text(what.to_string())).unwrap();
    }

    /// Whether the server ends the connection, whatever comes before.
    fn is_left(&mut self) -> bool {
        loop {
            match self.0.read() {
                Ok(_) => {}
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => return false,
                Err(_) => return true,
            }
        }
    }
}

/// A session whose simulated person rests, and its page.
fn start_at_rest() -> (Tendon, Page) {
    let mut tendon = TendonBuilder::run(&unique_session())
        .args(&["--page", "--page-port", "0", "--set", "acquisition.simulate.script=\"rest 60s\""])
        .start();
    tendon.wait_until_running();
    let page = Page::of(&tendon);
    (tendon, page)
}

#[test]
fn a_session_is_seen_stopped_and_armed_and_hostile_requests_do_nothing() {
    let (tendon, page) = start_at_rest();
    let mut viewer = page.request(&page.orders, &[]).unwrap();
    let hello = viewer.next("hello", Value::is_object);
    assert_eq!(
        (&hello["rights"], &hello["session"]),
        (&json!("orders"), &json!(tendon.session().to_string()))
    );
    let (first, bins) = viewer.frame();
    assert_eq!(viewer.frame().0, first + u64::from(bins));
    viewer.say(&json!({"ping": {"t": 1.5}}));
    assert_eq!(viewer.next("pong", |_| true)["t"], 1.5);
    viewer.next("state", |state| state["permission"] == "granted");

    assert_hostile_requests_do_nothing(&page);
    assert_eq!(viewer.state_now()["permission"], "granted");

    // 500 connections that ask for nothing, or never finish asking, keep neither a browser out nor a stop.
    let idle: Vec<TcpStream> = (0..500).map(|number| page.hold(number % 2 == 0)).collect();
    let loaded = page.plain(&format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", page.address));
    assert!(loaded.starts_with("HTTP/1.1 200"), "{loaded}");
    assert!(page.request(&page.watch, &[]).is_ok());
    viewer.say(&json!({"order": {"id": 7, "what": "stop"}}));
    let answer = viewer.next("answer", |_| true);
    assert_eq!((&answer["id"], &answer["order"], &answer["ok"]), (&json!(7), &json!("stop"), &json!(true)));
    viewer.next("state", |state| state["permission"] == "stopped" && state["stop_reason"] == "ordered");
    // An order to arm counts for the state that its sender saw: not for one before the newest stop.
    // Nor for what nobody has taken in yet.
    let seen_ns = viewer.state_in(REACTION_NS)["seen_ns"].clone();
    viewer.say(&json!({"order": {"id": 8, "what": "stop"}}));
    assert_eq!(viewer.next("answer", |answer| answer["id"] == 8)["ok"], true);
    let at_once_ns = viewer.state_now()["seen_ns"].clone();
    for seen_ns in [Some(seen_ns), Some(at_once_ns), None] {
        let mut arm = json!({"id": 9, "what": "arm"});
        arm.as_object_mut().unwrap().extend(seen_ns.map(|seen_ns| ("seen_ns".to_owned(), seen_ns)));
        viewer.say(&json!({"order": arm}));
        let answer = viewer.next("answer", |answer| answer["id"] == 9);
        assert!(
            answer["ok"] == false && answer["text"].as_str().unwrap().contains("look at the arm again"),
            "{answer}"
        );
    }
    let state = viewer.state_in(REACTION_NS);
    assert_eq!(state["permission"], "stopped");
    viewer.say(&json!({"order": {"id": 10, "what": "arm", "seen_ns": state["seen_ns"]}}));
    let answer = viewer.next("answer", |answer| answer["id"] == 10);
    assert_eq!(answer["ok"], true, "{answer}");
    viewer.next("state", |state| state["permission"] == "granted");
    drop(idle);

    // Those who only watch, and those for whom there is no seat.
    let seat = || wait_until("a seat", || page.request(&page.watch, &[]).ok());
    let mut watchers: Vec<Viewer> = std::iter::repeat_with(seat).take(6).collect();
    assert_eq!(page.status(&page.watch, &[]), 503);
    assert_eq!(page.status(&page.orders, &[]), 101, "two seats are for whoever may stop");
    watchers[0].say(&json!({"order": {"id": 9, "what": "stop"}}));
    assert_eq!(watchers[0].next("answer", |_| true)["ok"], false);
    assert_eq!(viewer.state_now()["permission"], "granted");

    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    let report = ended.report();
    assert!(!ended.errors.contains("goes on without it"), "{ended:?}");
    assert_eq!(report.restarts, 0, "{report:?}");
}

#[test]
fn a_page_that_is_killed_comes_back_at_its_address_and_still_stops() {
    let (tendon, page) = start_at_rest();
    let mut viewer = page.request(&page.orders, &[]).unwrap();
    viewer.next("state", |state| state["permission"] == "granted");
    kill(tendon.stage("page"), Signal::SIGKILL).unwrap();
    assert!(viewer.is_left());
    wait_until("the note on it", || tendon.errors_so_far().contains("and was started again").then_some(()));
    let mut viewer = page.request(&page.orders, &[]).unwrap();
    viewer.next("state", |state| state["permission"] == "granted");
    viewer.say(&json!({"order": {"id": 1, "what": "stop"}}));
    assert_eq!(viewer.next("answer", |_| true)["ok"], true);
    viewer.next("state", |state| state["permission"] == "stopped");
    tendon.signal(Signal::SIGTERM);
    let report = tendon.end().report();
    assert_eq!(report.restarts, 0, "{report:?}");
}

#[test]
fn the_page_records_notes_and_makes_gestures_as_far_as_its_viewer_may() {
    let data = tempfile::tempdir().unwrap();
    let mut tendon = TendonBuilder::run_with_model(&unique_session(), &model("cnn-six-class"))
        .args(&["--page", "--page-port", "0", "--keyboard", "--task", "zones", "--strategy", "direct"])
        .args(&["--set", TWO_MODES])
        .env("XDG_DATA_HOME", data.path())
        .start();
    tendon.wait_until_running();
    let page = Page::of(&tendon);
    let mut viewer = page.request(&page.orders, &[]).unwrap();
    let is_told = |desk: &Value| desk["can"]["record"] == true && desk["task"].is_object();
    let desk = viewer.next("desk", is_told);
    assert_eq!((&desk["kind"], &desk["strategy"]), (&json!("session"), &json!("direct")));
    assert_eq!((&desk["recording"], &desk["people"]), (&Value::Null, &json!([])));

    assert_eq!(viewer.ask(&json!({"note": "too early"}))["ok"], false);
    let answer = viewer.ask(&json!({"record": true}));
    assert_eq!((&answer["ok"], &answer["order"]), (&json!(true), &json!("record")), "{answer}");
    let recording = viewer.next("desk", |desk| desk["recording"].is_string())["recording"].clone();
    viewer.next("state", |state| state["recording"] == recording);
    let noted = viewer.ask(&json!({"note": "electrode 3 is loose"}));
    assert_eq!(noted["text"], format!("noted in {}", recording.as_str().unwrap()));
    assert_eq!(viewer.ask(&json!({"record": false}))["ok"], true);
    viewer.next("desk", |desk| desk["recording"].is_null());

    // The task begins once the simulated person has been at rest.
    viewer.next("state", |state| state["permission"] == "granted");
    assert_eq!(viewer.ask(&json!({"gesture": {"gesture": "extension", "effort": 1.0}}))["ok"], true);
    viewer.next("state", |state| state["gesture"] == "extension");
    // A desk is told when it changed, and this one may have been while the viewer waited for something else.
    let mut late = page.request(&page.orders, &[]).unwrap();
    late.next("desk", |desk| desk["task"]["zone"]["width_mm"].is_number());
    viewer.next("state", |state| state["zone"]["center_mm"].is_array());
    assert_eq!(viewer.ask(&json!({"mode": "x"}))["ok"], true);
    viewer.next("state", |state| state["mode"] == 1);
    for (refused, why) in [
        (json!({"gesture": {"gesture": "fist"}}), "no gesture of this session"),
        (json!({"gesture": {"gesture": "rest", "effort": 7.0}}), "from 0 to 1"),
        (json!({"mode": "nowhere"}), "has z, x"),
        (json!({"next": {"session": {"strategy": "threshold"}}}), "--json"),
        (json!({"calibration": "go-on"}), "no calibration"),
    ] {
        let answer = viewer.ask(&refused);
        assert!(answer["ok"] == false && answer["text"].as_str().unwrap().contains(why), "{answer}");
    }
    // The page of those who watch asks for nothing, and is not told who was calibrated.
    let mut watcher = page.request(&page.watch, &[]).unwrap();
    assert_eq!(watcher.next("desk", |_| true)["people"], Value::Null);
    assert_eq!(watcher.ask(&json!({"record": true}))["ok"], false);
    assert_eq!(watcher.ask(&json!({"note": "hello"}))["ok"], false);

    // A full disk ends the recording, says so, and leaves the session alone.
    assert_eq!(viewer.ask(&json!({"record": true}))["ok"], true);
    viewer.next("desk", |desk| desk["recording"].is_string());
    let recorder = tendon.stage("recorder").to_string();
    let limited = Command::new("prlimit").args(["--fsize=1000", "--pid", &recorder]).status().unwrap();
    assert!(limited.success());
    let desk = viewer.next("desk", |desk| desk["recording_failure"].is_string());
    assert!(desk["recording_failure"].as_str().unwrap().contains("File too large"), "{desk}");
    assert_eq!(desk["recording"], Value::Null);
    assert_eq!(viewer.state_now()["permission"], "granted");

    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert_eq!(ended.report().recordings.len(), 2, "{ended:?}");
}

#[test]
fn the_next_session_has_what_was_asked_for_and_the_same_page_which_says_why_it_could_not_begin() {
    let data = tempfile::tempdir().unwrap();
    let (amplifier, unplugged) = (data.path().join("amplifier"), data.path().join("unplugged"));
    let script = format!(
        "#!/bin/sh\n[ -e {} ] && {{ echo 'the amplifier has no power' >&2; exit 2; }}\nexec {} \"$@\"\n",
        unplugged.display(),
        program("tendon-acquisition").display()
    );
    std::fs::write(&amplifier, script).unwrap();
    std::fs::set_permissions(&amplifier, Permissions::from_mode(0o755)).unwrap();
    let session = unique_session();
    let (name, source) = (session.to_string(), format!("acquisition.program={}", amplifier.display()));
    let run =
        ["run", "--session", &name, "--page", "--page-port", "0", "--no-browser", "--strategy", "direct"];
    let tendon = TendonBuilder::command(&session, &run)
        .args(&["--set", &source])
        .env("XDG_DATA_HOME", data.path())
        .start();
    let page = Page::of(&tendon);
    let mut viewer = page.request(&page.orders, &[]).unwrap();
    viewer.next("desk", |desk| desk["can"]["next"] == true);
    let next = |viewer: &mut Viewer, session: Value| viewer.ask(&json!({"next": {"session": session}}));
    for (refused, why) in [
        (json!({"person": "../x"}), "a-z 0-9"),
        (json!({"person": "nobody"}), "nobody"),
        (json!({"strategy": "magic"}), "magic"),
        (json!({"strategy": "personal"}), "person"),
        (json!({"task": "--json=x"}), "--json"),
    ] {
        let answer = next(&mut viewer, refused);
        assert!(answer["ok"] == false && answer["text"].as_str().unwrap().contains(why), "{answer}");
    }
    let back = viewer.ask(&json!({"next": "back"}));
    assert!(back["ok"] == false && back["text"].as_str().unwrap().contains("session already"), "{back}");
    // It goes on as it was.
    viewer.next("state", |_| true);
    assert_eq!(viewer.ask(&json!({"record": true}))["ok"], true);
    let recording = viewer.next("desk", |desk| desk["recording"].is_string())["recording"].clone();
    // Somebody else wants the port from now on, to be shown the tokens.
    let is_over = AtomicBool::new(false);
    let was_taken = || {
        let looks = std::iter::from_fn(|| {
            (!is_over.load(Ordering::Relaxed)).then(|| TcpListener::bind(page.address))
        });
        looks.filter(Result::is_ok).count()
    };
    // The next session has the same page: address and tokens stay.
    let change = |mut viewer: Viewer| {
        let answer = next(&mut viewer, json!({"strategy": "threshold", "task": "zones"}));
        assert_eq!(answer["ok"], true, "{answer}");
        assert!(viewer.is_left());
        wait_until("the page of the next session", || {
            TcpStream::connect(page.address).ok().and_then(|_| page.request(&page.orders, &[]).ok())
        })
    };
    std::fs::write(&unplugged, "").unwrap();
    let (mut failed, taken) = std::thread::scope(|scope| {
        let thief = scope.spawn(was_taken);
        let failed = change(viewer);
        is_over.store(true, Ordering::Relaxed);
        (failed, thief.join().unwrap())
    });
    assert_eq!(taken, 0, "the port was free between two sessions");
    assert_eq!(failed.next("hello", Value::is_object)["kind"], "failed");
    let desk = failed.next("desk", |desk| desk["failed"].is_string());
    assert!(desk["failed"].as_str().unwrap().contains("the amplifier has no power"), "{desk}");
    assert_eq!(failed.next("state", |_| true)["permission"], "none");
    std::fs::remove_file(&unplugged).unwrap();
    let mut again = change(failed);
    let hello = again.next("hello", Value::is_object);
    assert_eq!((&hello["strategy"], &hello["rights"]), (&json!("threshold"), &json!("orders")));
    // What was recorded before is recorded on, to another file.
    let desk = again.next("desk", |desk| desk["task"].is_object() && desk["recording"].is_string());
    assert_ne!(desk["recording"], recording);
    // It begins stopped, and waits for somebody who says that the arm may move.
    let state = again.next("state", |_| true);
    assert_eq!((&state["permission"], &state["stop_reason"]), (&json!("stopped"), &json!("next-session")));
    let seen_ns = again.state_in(REACTION_NS)["seen_ns"].clone();
    again.say(&json!({"order": {"id": 1, "what": "arm", "seen_ns": seen_ns}}));
    assert_eq!(again.next("answer", |_| true)["ok"], true);
    again.next("state", |state| state["permission"] != "stopped");
    assert!(page.request(&page.watch, &[]).is_ok());
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert_eq!(ended.exit_code, Some(0), "{ended:?}");
    assert_eq!(ended.errors.matches("page: http").count(), 3, "{ended:?}");
}

/// 200 requests that no page of ours sends.
fn assert_hostile_requests_do_nothing(page: &Page) {
    let stop = json!({"order": {"id": 1, "what": "stop"}}).to_string();
    let (host, token) = (page.address.to_string(), page.orders.clone());
    for _ in 0..20 {
        assert_eq!(page.status("", &[]), 401);
        assert_eq!(page.status(&token[1..], &[]), 401);
        assert_eq!(page.status(&token, &[("origin", "http://example.org")]), 403);
        assert_eq!(page.status(&token, &[("origin", "null")]), 403);
        assert_eq!(page.status(&token, &[("host", "example.org")]), 403);
        let posted = page.plain(&format!(
            "POST /ws?token={token} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {}\r\n\r\n{stop}",
            stop.len()
        ));
        assert!(posted.starts_with("HTTP/1.1 405"), "{posted}");
        let torn = page.plain("GET /ws HTTP/1.1\r\nHost\r\n\r\n");
        assert!(torn.starts_with("HTTP/1.1 400"), "{torn}");
    }
    for round in 0..20 {
        let enter = || wait_until("a seat", || page.request(&page.orders, &[]).ok());
        let mut oversized = enter();
        // The other side may be gone before all of it is sent.
        let _ = oversized.0.send(Message::text(" ".repeat(5000) + &stop));
        assert!(oversized.is_left(), "oversized");
        let mut torn = enter();
        // A frame of an order without the mask that every browser sends, or the head of one of a kind and a length that there are not.
        let frame = if round % 2 == 0 {
            [&[0x81, stop.len() as u8], stop.as_bytes()].concat()
        } else {
            vec![0xff; 16]
        };
        torn.0.get_mut().write_all(&frame).unwrap();
        assert!(torn.is_left(), "torn");
        let mut flood = enter();
        for t in 0..200 {
            if flood.0.send(Message::text(json!({"ping": {"t": t}}).to_string())).is_err() {
                break;
            }
        }
        assert!(flood.is_left(), "flood");
    }
}
