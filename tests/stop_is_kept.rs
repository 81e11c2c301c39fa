//! An order to stop is never forgotten: whenever it comes, the next session does not move the arm by itself.
//!
//! ```text
//! session:  connecting ───▶ follows ───▶ told to end ─▶ comes to rest ─▶ record of good order?
//!               ▲              ▲           ▲                ▲
//! stop ─────────┴──────────────┴───────────┴────────────────┘   then there is none: the next session waits
//! ```
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use tempfile::TempDir;
use tendon_process::{Answer, Order, OrderError, order_robot};
use tendon_system_tests::{EmulatedArm, Tendon, TendonBuilder, model, unique_session, wait_until};
use tendon_transport::{Leftovers, SessionLock, SessionName, own_user};

/// How long the arm of the next session is watched: through a rest and into a gesture.
const WATCHED: Duration = Duration::from_secs(3);

/// An emulated arm, and the lasting state of who drives it.
struct OwnArm {
    arm: EmulatedArm,
    state_home: TempDir,
}

impl OwnArm {
    /// One that was left in good order.
    fn start() -> OwnArm {
        let own = OwnArm { arm: EmulatedArm::start(), state_home: tempfile::tempdir().unwrap() };
        own.arm.leave_in_good_order(own.state_home.path());
        own
    }

    fn has_record(&self) -> bool {
        self.arm.record(self.state_home.path()).exists()
    }

    fn speed_mm_per_s(&self) -> f64 {
        self.arm.model().speed_mm_per_s()
    }

    /// A session that moves the arm, which it reaches by this port.
    fn session_by(&self, session: &SessionName, control_port: u16) -> TendonBuilder {
        let listen = self.arm.listen;
        let mut builder = TendonBuilder::run_with_model(session, &model("cnn-six-class"));
        builder = builder.env("XDG_STATE_HOME", self.state_home.path());
        builder = builder.args(&["--strategy", "direct", "--script", "rest 1s, ulnar 60s"]);
        for setting in [
            "robot.backend=\"xarm\"".to_owned(),
            format!("robot.xarm.address=\"{}\"", listen.address),
            format!("robot.xarm.control_port={control_port}"),
            format!("robot.xarm.normal_report_port={}", listen.normal_report_port),
            format!("robot.xarm.real_time_report_port={}", listen.real_time_report_port),
            "decision.speed_mm_per_s=100.0".to_owned(),
        ] {
            builder = builder.args(&["--set", &setting]);
        }
        builder
    }

    fn session(&self, session: &SessionName) -> TendonBuilder {
        self.session_by(session, self.arm.listen.control_port)
    }

    fn wait_for_motion(&self) {
        wait_until("motion", || (self.speed_mm_per_s() > 90.0).then_some(()));
    }

    fn assert_stays_at(&self, pose: [f32; 6]) {
        let begun = Instant::now();
        while begun.elapsed() < WATCHED {
            assert_eq!(self.arm.model().report().pose, pose, "it moves by itself");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn assert_next_session_waits(&self) {
        wait_until("rest", || (self.speed_mm_per_s() == 0.0).then_some(()));
        let pose = self.arm.model().report().pose;
        let mut tendon = self.session(&unique_session()).start();
        tendon.wait_until_running();
        self.assert_stays_at(pose);
        tendon.signal(Signal::SIGTERM);
        tendon.end();
        assert!(!self.has_record());
    }
}

/// A control port that takes connections, but does not answer before [`HeldPort::release`].
struct HeldPort {
    listener: TcpListener,
    port: u16,
}

impl HeldPort {
    fn new() -> HeldPort {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        HeldPort { listener, port }
    }

    /// Hands everything on to this port from now on.
    fn release(self, port: u16) {
        std::thread::spawn(move || {
            for client in self.listener.incoming().flatten() {
                let Ok(arm) = TcpStream::connect(("127.0.0.1", port)) else { return };
                for (mut from, mut to) in [
                    (client.try_clone().unwrap(), arm.try_clone().unwrap()),
                    (arm.try_clone().unwrap(), client.try_clone().unwrap()),
                ] {
                    std::thread::spawn(move || std::io::copy(&mut from, &mut to));
                }
            }
        });
    }
}

fn end(mut tendon: Tendon, signal: Signal, session: &SessionName) {
    tendon.signal(signal);
    tendon.end_whatever_is_left();
    Leftovers::remove(&SessionLock::take(session).unwrap());
}

/// Orders a stop as soon as the robot listens.
fn stop_once_it_listens(session: &SessionName) -> Answer {
    wait_until("the robot to listen", || order_robot(session, None, Order::Stop).ok())
}

#[test]
fn a_stop_counts_though_the_end_comes_right_after_it() {
    for keys in [" q", " \x03", "q "] {
        let (own, session) = (OwnArm::start(), unique_session());
        let terminal = nix::pty::openpty(None, None).unwrap();
        let mut tendon = own.session(&session).controlled_by(terminal.slave).start();
        tendon.wait_until_running();
        own.wait_for_motion();
        std::fs::File::from(terminal.master.try_clone().unwrap()).write_all(keys.as_bytes()).unwrap();
        tendon.end();
        assert!(!own.has_record(), "{keys:?}");
        own.assert_next_session_waits();
    }
}

#[test]
fn a_stop_while_the_session_ends_is_answered_and_counts() {
    let mut answered = 0;
    for after_ms in [0, 50, 150] {
        let (own, session) = (OwnArm::start(), unique_session());
        let mut tendon = own.session(&session).start();
        tendon.wait_until_running();
        own.wait_for_motion();
        tendon.signal(Signal::SIGINT);
        wait_until("the end to begin", || (own.speed_mm_per_s() < 80.0).then_some(()));
        std::thread::sleep(Duration::from_millis(after_ms));
        let answer = order_robot(&session, None, Order::Stop);
        tendon.end();
        match answer {
            Ok(_) => {
                answered += 1;
                assert!(!own.has_record(), "{after_ms} ms");
                own.assert_next_session_waits();
            }
            // On a machine that is busy it may come after the robot's end.
            Err(error) => assert!(matches!(error, OrderError::Find(_)), "{after_ms} ms: {error}"),
        }
    }
    assert!(answered > 0);
}

#[test]
fn a_key_that_stops_counts_before_there_is_a_robot_process() {
    let (own, session) = (OwnArm::start(), unique_session());
    let pose = own.arm.model().report().pose;
    let terminal = nix::pty::openpty(None, None).unwrap();
    // It is there before the program looks.
    std::fs::File::from(terminal.master.try_clone().unwrap()).write_all(b" ").unwrap();
    let mut tendon = own.session(&session).controlled_by(terminal.slave).start();
    tendon.wait_until_running();
    own.assert_stays_at(pose);
    tendon.signal(Signal::SIGTERM);
    tendon.end();
    assert!(!own.has_record());
    own.assert_next_session_waits();
}

#[test]
fn an_order_to_stop_waits_for_the_robot_of_a_session_that_starts() {
    let (own, session) = (OwnArm::start(), unique_session());
    let pose = own.arm.model().report().pose;
    let mut tendon = own.session(&session).start();
    wait_until("the session", || session.supervisor(own_user()));
    order_robot(&session, None, Order::Stop).unwrap();
    tendon.wait_until_running();
    own.assert_stays_at(pose);
    tendon.signal(Signal::SIGTERM);
    tendon.end();
    assert!(!own.has_record());
}

#[test]
fn a_stop_before_it_is_known_which_arm_is_there_counts() {
    let (own, session, held) = (OwnArm::start(), unique_session(), HeldPort::new());
    let tendon = own.session_by(&session, held.port).start();
    let answer = stop_once_it_listens(&session);
    assert!(!answer.ok && answer.key.as_deref() == Some("not-confirmed"), "{answer:?}");
    assert!(own.has_record());
    end(tendon, Signal::SIGINT, &session);
    assert!(!own.has_record());
    own.assert_next_session_waits();
}

#[test]
fn a_stop_before_it_is_known_which_arm_is_there_holds_once_it_is_known() {
    let (own, session, held) = (OwnArm::start(), unique_session(), HeldPort::new());
    let tendon = own.session_by(&session, held.port).start();
    stop_once_it_listens(&session);
    held.release(own.arm.listen.control_port);
    wait_until("the record to be taken", || (!own.has_record()).then_some(()));
    // Whatever comes now: even a kill of everything leaves none.
    end(tendon, Signal::SIGKILL, &session);
    own.assert_next_session_waits();
}

#[test]
fn a_session_that_is_killed_before_it_is_known_which_arm_is_there_leaves_no_record() {
    let (own, session, held) = (OwnArm::start(), unique_session(), HeldPort::new());
    let tendon = own.session_by(&session, held.port).start();
    held.listener.accept().unwrap();
    end(tendon, Signal::SIGKILL, &session);
    wait_until("the records to be removed", || (!own.has_record()).then_some(()));
    own.assert_next_session_waits();
}

#[test]
fn another_arm_at_the_same_address_is_taken_anew_and_waits() {
    let (own, session) = (OwnArm::start(), unique_session());
    let mut tendon = own.session(&session).start();
    tendon.wait_until_running();
    own.wait_for_motion();
    let robot = tendon.stage("robot");
    let OwnArm { arm, state_home } = own;
    let listen = arm.listen;
    drop(arm);
    let own = OwnArm { arm: EmulatedArm::start_on(listen), state_home };
    own.arm.leave_in_good_order(own.state_home.path());
    let pose = own.arm.model().report().pose;
    wait_until("another robot process", || tendon.find_stage("robot").filter(|process| *process != robot));
    wait_until("the record to be taken", || (!own.has_record()).then_some(()));
    assert!(tendon.errors_so_far().contains("another arm (XI1300"), "{}", tendon.errors_so_far());
    std::thread::sleep(WATCHED);
    assert_eq!(own.arm.model().report().pose, pose, "it moves by itself");
    // It is this session's now, and is left in good order.
    let ended = tendon_system_tests::arm(&session);
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    tendon.signal(Signal::SIGTERM);
    tendon.end();
    assert!(own.has_record());
}
