//! The story of a stranger, with nobody there: badly recognised, calibrated by cues, well recognised. And what goes wrong on
//! the way.
#![allow(clippy::unwrap_used, reason = "helpers of tests may do what tests may")]

use std::net::TcpStream;
use std::path::{Path, PathBuf};

use nix::sys::signal::{Signal, kill};
use serde_json::{Value, json};
use tendon_emg_simulation::Profile;
use tendon_gesture::Gesture;
use tendon_process::{Answer, ask_session, session_status};
use tendon_report::Report;
use tendon_system_tests::{Ended, Tendon, TendonBuilder, model, unique_session, wait_until};

/// All gestures, with rest between.
const SCRIPT: &str = "rest 2s, extension 1500ms, rest 1s, flexion 1500ms, rest 1s, ulnar 1500ms, rest 1s, radial 1500ms, \
                      rest 1s, grip 1500ms, rest 1s";

/// `tendon calibrate anna` of a simulated person, whom `people` keeps.
fn calibrate(people: &Path, profile: &str, arguments: &[&str]) -> TendonBuilder {
    let session = unique_session();
    let named = format!("session=\"{session}\"");
    let profile = format!("acquisition.simulate.profile={profile}");
    TendonBuilder::command(&session, &["calibrate", "anna", "--set", &named, "--set", &profile])
        .args(arguments)
        .env("XDG_DATA_HOME", people)
}

fn run(people: &Path, recogniser: &[&str]) -> Report {
    let session = unique_session();
    TendonBuilder::command(&session, &["run", "--session", session.to_string().as_str()])
        .args(&["--json", "report.json", "--duration", "14s", "--script", SCRIPT, "--seed", "7"])
        .args(&["--set", "acquisition.simulate.profile=stranger-19"])
        .args(recogniser)
        .env("XDG_DATA_HOME", people)
        .end()
        .report()
}

/// The only recording of the person, besides check rounds.
fn recording(people: &Path) -> Option<PathBuf> {
    let folder = people.join("tendon/people/anna/recordings");
    let mut recordings = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    recordings.find(|recording| !recording.to_string_lossy().ends_with("-check"))
}

fn labels(people: &Path) -> String {
    let labels = recording(people).map(|folder| folder.join("labels.csv"));
    labels.and_then(|labels| std::fs::read_to_string(labels).ok()).unwrap_or_default()
}

fn assert_done(ended: &Ended) {
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
}

#[test]
fn a_stranger_is_recognised_badly_then_calibrated_then_recognised_well() {
    let people = tempfile::tempdir().unwrap();
    let before =
        run(people.path(), &["--strategy", "direct", "--model", model("cnn-six-class").to_str().unwrap()]);
    let share = |report: &Report| report.recognition.correct as f64 / report.recognition.windows as f64;
    assert!(share(&before) < 0.8, "{:#?}", before.recognition);
    let short = ["--rest", "3s", "--hold", "3s", "--pause", "2s"];
    let calibrated = calibrate(people.path(), "stranger-19", &short).end();
    assert_done(&calibrated);
    for said in ["expected accuracy", "SNR, dB", "now: tendon run --person anna"] {
        assert!(calibrated.output.contains(said), "{said}: {calibrated:#?}");
    }
    assert!(calibrated.errors.contains("ulnar: from light to firm and back"), "{calibrated:#?}");
    // The prior must not know the person that is simulated.
    assert!(calibrated.output.contains("what 14 other people have in common"), "{calibrated:#?}");
    let after = run(people.path(), &["--person", "anna"]);
    assert!(share(&after) >= 0.95, "{:#?}", after.recognition);
    // The same name is not given twice by mistake.
    calibrate(people.path(), "stranger-19", &[])
        .end()
        .assert_failed(2, &["there is a person `anna` already"]);
}

#[test]
fn a_calibration_that_is_broken_off_loses_nothing_and_can_be_fitted() {
    let people = tempfile::tempdir().unwrap();
    let arguments = ["--rest", "2s", "--hold", "2s", "--pause", "1s"];
    let tendon = calibrate(people.path(), "stranger-20", &arguments).start();
    let made = [Gesture::REST, Gesture::EXTENSION, Gesture::FLEXION];
    wait_until("two gestures", || {
        let labels = labels(people.path());
        made.iter().all(|gesture| labels.contains(gesture.name())).then_some(())
    });
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert_done(&ended);
    let folder = recording(people.path()).unwrap();
    let remedy = format!("tendon calibrate anna --from {}", folder.display());
    assert!(ended.errors.contains(&remedy), "{ended:#?}");
    let session = unique_session();
    let from = TendonBuilder::command(&session, &["calibrate", "anna", "--from"])
        .arg(&folder)
        .env("XDG_DATA_HOME", people.path())
        .end();
    assert_done(&from);
    assert!(from.output.contains("anna: 3 gestures on channels channel_0"), "{from:#?}");
    // A person may make one gesture again, which replaces what was recorded of it.
    let redone =
        calibrate(people.path(), "stranger-20", &["--redo", "flexion", "--rest", "2s", "--hold", "2s"]);
    let redone = redone.end();
    assert_done(&redone);
    let labels = labels(people.path());
    let files = |gesture: &str| -> Vec<&str> {
        labels
            .lines()
            .filter(|line| line.contains(gesture))
            .filter_map(|line| line.split(',').next())
            .collect()
    };
    assert_eq!((files("extension"), files("flexion")), (vec!["emg-1.csv"], vec!["emg-2.csv"]), "{labels}");
}

#[test]
fn a_new_calibration_may_have_other_gestures_and_a_redo_adds_to_what_the_person_was_fitted_to() {
    let people = tempfile::tempdir().unwrap();
    let short = ["--rest", "2s", "--hold", "2s", "--pause", "1s"];
    let calibrate = |arguments: &[&str]| calibrate(people.path(), "stranger-22", arguments).args(&short);
    assert_done(&calibrate(&["--gestures", "extension,grip"]).end());
    let replaced = calibrate(&["--replace", "--gestures", "flexion,ulnar"]).end();
    assert_done(&replaced);
    assert!(replaced.output.contains("anna: 3 gestures"), "{replaced:#?}");
    assert!(people.path().join("tendon/people/anna/person.previous.toml").exists());
    let broken_off = calibrate(&["--replace", "--gestures", "flexion,ulnar"]).start();
    let newest = || {
        let folder = people.path().join("tendon/people/anna/recordings");
        let recordings: Vec<PathBuf> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        (recordings.len() == 3).then(|| recordings.into_iter().max())?
    };
    wait_until("a gesture of the third recording", || {
        let labels = std::fs::read_to_string(newest()?.join("labels.csv")).ok()?;
        labels.contains("flexion").then_some(())
    });
    let broken_off_folder = newest().unwrap();
    // Nobody else calibrates anna meanwhile.
    calibrate(&["--replace"]).end().assert_failed(2, &["`anna` is being calibrated by another process"]);
    kill(broken_off.stage("acquisition"), Signal::SIGKILL).unwrap();
    let remedy = format!("tendon calibrate anna --from {} --replace", broken_off_folder.display());
    let broken_off = broken_off.end();
    broken_off.assert_failed(1, &["acquisition ended"]);
    broken_off.assert_failed(1, &[&remedy]);
    let redone = calibrate(&["--redo", "flexion"]).end();
    assert_done(&redone);
    assert!(redone.output.contains("anna: 3 gestures"), "{redone:#?}");
    let labels = std::fs::read_to_string(broken_off_folder.join("labels.csv")).unwrap();
    assert!(!labels.contains("emg-2.csv"), "the redo was recorded elsewhere: {labels}");
}

/// What the page is told of a calibration, and what it asks of it.
struct Page<'a>(&'a Tendon);

impl Page<'_> {
    /// The newest status of the calibration; `None` while nobody tells one.
    fn status(&self) -> Option<Value> {
        let told = session_status(self.0.session()).ok()?;
        let desk: Value = serde_json::from_str(&told).unwrap();
        Some(desk["desk"]["calibration"].clone()).filter(Value::is_object)
    }

    fn wait_for(&self, what: &str, is_it: impl Fn(&Value) -> bool) -> Value {
        wait_until(what, || self.status().filter(&is_it))
    }

    fn wait_for_phase(&self, phase: &str) -> Value {
        self.wait_for(phase, |status| status["phase"] == phase)
    }

    fn ask(&self, request: Value) -> Answer {
        ask_session(self.0.session(), &serde_json::from_value(request).unwrap()).unwrap()
    }

    fn say(&self, what: &str) {
        let answer = self.ask(json!({ "calibration": what }));
        assert!(answer.ok, "{what}: {answer:?}");
    }

    /// What a browser is told under this name.
    fn tells_browsers(&self, name: &str) -> Value {
        let errors = wait_until("the page's address", || {
            let errors = self.0.errors_so_far();
            errors.contains("page, to watch only: ").then_some(errors)
        });
        let link = errors.lines().find_map(|line| line.strip_prefix("page: http://")).unwrap();
        let (address, token) = link.split_once("/#").unwrap();
        let stream = TcpStream::connect(address).unwrap();
        let address = format!("ws://{address}/ws?token={token}");
        let (mut socket, _) = tungstenite::client(address, stream).unwrap();
        wait_until(name, || {
            let message = socket.read().unwrap();
            let said: Value = serde_json::from_str(message.to_text().ok()?).ok()?;
            said.get(name).cloned()
        })
    }
}

#[test]
fn a_stranger_is_calibrated_from_the_page_alone() {
    let people = tempfile::tempdir().unwrap();
    let short =
        ["--gestures", "extension,grip", "--rest", "2s", "--hold", "1500ms", "--pause", "1s", "--check"];
    let tendon =
        calibrate(people.path(), "stranger-19", &["--page", "--page-port", "0"]).args(&short).start();
    let page = Page(&tendon);
    // It waits for somebody, though there is no terminal.
    page.wait_for("somebody to be asked for", |status| status["may"] == json!(["go-on", "stop"]));
    let hello = page.tells_browsers("hello");
    assert_eq!((&hello["kind"], &hello["arm"]), (&json!("calibration"), &Value::Null), "{hello}");
    assert_eq!(page.tells_browsers("state")["permission"], "none");
    let early = page.ask(json!({"next": {"session": {}}}));
    assert!(!early.ok && early.text.contains("stop it first"), "{early:?}");
    page.say("go-on");
    let hold =
        page.wait_for("a gesture", |status| status["ask"] == "hold" && status["gesture"] == "extension");
    assert!(hold["asked_effort_share"].as_f64().unwrap() > 0.2, "{hold}");
    // Once more, after it is done.
    page.wait_for("the next gesture", |status| status["ask"] == "relax" && status["gesture"] == "grip");
    assert!(!page.ask(json!({"calibration": "go-on"})).ok);
    page.say("redo");
    page.wait_for("the same gesture", |status| status["ask"] == "hold" && status["gesture"] == "extension");
    page.wait_for("the check round to be begun", |status| {
        status["phase"] == "check" && status["may"][0] == "go-on"
    });
    page.say("go-on");
    let done = page.wait_for_phase("done");
    let report = &done["report"];
    assert!(report["expected_accuracy"].as_f64().unwrap() > 0.5, "{report}");
    assert_eq!(report["confusion"]["gestures"], json!(["rest", "extension", "grip"]), "{report}");
    assert_eq!(report["channels"].as_array().unwrap().len(), 4, "{report}");
    assert!(report["check"]["after"].as_f64().unwrap() > 0.8, "{report}");
    assert_eq!(done["may"], json!([]), "{done}");
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert_done(&ended);
    assert!(ended.output.contains("now: tendon run --person anna"), "{ended:#?}");
    assert_eq!(labels(people.path()).matches("extension").count(), 1, "{}", labels(people.path()));
}

#[test]
fn the_page_leads_from_a_session_into_a_calibration_and_back() {
    let people = tempfile::tempdir().unwrap();
    let short = ["--gestures", "extension", "--rest", "2s", "--hold", "1s", "--pause", "1s"];
    let page = ["--page", "--page-port", "0"];
    let tendon = calibrate(people.path(), "stranger-20", &page).args(&short).start();
    let page = Page(&tendon);
    let link = |tendon: &Tendon| tendon.errors_so_far().matches("page: http://").count();
    page.wait_for("somebody to be asked for", |status| status["may"][0] == "go-on");
    page.say("go-on");
    // Stopped in the middle: nobody is kept, and what was recorded is.
    page.wait_for("a gesture", |status| status["ask"] == "hold" && status["gesture"] == "extension");
    page.say("stop");
    page.wait_for_phase("stopped");
    assert!(labels(people.path()).contains("rest"), "{}", labels(people.path()));
    let anna = json!({"name": "anna", "gestures": ["extension", "grip"]});
    for (refused, why) in [
        (json!({"calibrate": {"name": "../x"}}), "no name for a person"),
        (json!({"calibrate": {"name": "anna", "gestures": ["fist"]}}), "cannot make all gestures"),
        (json!({"session": {"person": "anna"}}), "anna"),
    ] {
        let answer = page.ask(json!({ "next": refused }));
        assert!(!answer.ok && answer.text.contains(why), "{why}: {answer:?}");
    }
    // The same once more, at the same page, with the same times.
    assert!(page.ask(json!({"next": {"calibrate": anna}})).ok);
    page.wait_for("the next calibration", |status| status["phase"] == "cues" && status["may"][0] == "go-on");
    page.say("go-on");
    page.wait_for_phase("done");
    assert!(page.ask(json!({"next": {"session": {"person": "anna"}}})).ok);
    let session = || serde_json::from_str::<Value>(&session_status(tendon.session()).ok()?).ok();
    wait_until("a session with the person", || {
        let desk = session()?["desk"].take();
        (desk["kind"] == "session" && desk["person"] == "anna" && desk["can"]["next"] == true).then_some(())
    });
    // In a session, a calibration that could not begin is refused before anything ends.
    let taken = page.ask(json!({"next": {"calibrate": anna}}));
    assert!(!taken.ok && taken.text.contains("there is a person `anna` already"), "{taken:?}");
    assert!(page.ask(json!({"next": {"calibrate": {"name": "bert", "gestures": ["grip"]}}})).ok);
    let bert = page.wait_for("the calibration of somebody else", |status| status["name"] == "bert");
    assert_eq!(bert["phase"], "cues", "{bert}");
    wait_until("the page of each", || (link(&tendon) >= 4).then_some(()));
    let errors = tendon.errors_so_far();
    let links: std::collections::BTreeSet<&str> =
        errors.lines().filter(|line| line.starts_with("page: ")).collect();
    assert_eq!(links.len(), 1, "one address and one token throughout: {links:?}");
    tendon.signal(Signal::SIGTERM);
    assert_done(&tendon.end());
}

#[test]
fn a_gesture_that_is_not_made_is_noticed_and_the_person_is_not_kept() {
    let people = tempfile::tempdir().unwrap();
    let mut profile = Profile::default();
    let rest = profile.gestures.iter().find(|entry| entry.gesture == Gesture::REST).unwrap().clone();
    for entry in profile.gestures.iter_mut().filter(|entry| entry.gesture == Gesture::GRIP) {
        *entry = tendon_emg_simulation::GestureProfile { gesture: Gesture::GRIP, ..rest.clone() };
    }
    let file = people.path().join("lame.toml");
    std::fs::write(&file, profile.to_toml()).unwrap();
    let arguments = ["--gestures", "extension,grip", "--rest", "2s", "--hold", "2s", "--pause", "1s"];
    let ended = calibrate(people.path(), file.to_str().unwrap(), &arguments).end();
    ended.assert_failed(1, &["anna is not kept", "grip looks like rest", "--redo GESTURE"]);
    ended.assert_failed(1, &["! grip looks like rest", "once more"]);
    assert!(labels(people.path()).contains("extension"));
    assert!(!people.path().join("tendon/people/anna/person.toml").exists());
}

#[test]
fn what_nobody_can_be_asked_is_refused_before_anything_is_recorded() {
    let people = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str], parts: &[&str]| {
        calibrate(people.path(), "stranger-22", arguments).end().assert_failed(2, parts);
    };
    refused(
        &["--gestures", "extension,fist"],
        &[
            "the simulated person cannot make all gestures",
            "extension, fist; it makes rest, extension, flexion",
        ],
    );
    refused(&["--gestures", "grip,grip"], &["the gesture grip is named twice"]);
    refused(&["--hold", "100ms"], &["a gesture of 0.1 s"]);
    refused(&["--redo", "grip"], &["anna has no recording", "without --redo"]);
    refused(&["--set", "acquisition.source=replay", "--set", "acquisition.replay.path=x.csv"], &["--from"]);
    assert_eq!(recording(people.path()), None);
}
