//! The client of `tendon-xarm` against the emulator: each test has an emulator of its own, on free ports.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

mod bring_up;
mod gripper;
mod identity;
mod motion;
mod watch;

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tendon_xarm::{ArmState, Client, ClientSettings, Fault, Halt, Mode, Phase, Source, Status, Velocity};
use tendon_xarm_emulator::{Emulator, Fault as Injected, Listen, Properties};

/// What does not come within this time never does.
const WATCHDOG: Duration = Duration::from_secs(60);

const ALONG_Y: Velocity = Velocity::Flange([0.0, 50.0, 0.0, 0.0, 0.0, 0.0]);
const REST: Velocity = Velocity::Flange([0.0; 6]);

fn settings(listen: &Listen) -> ClientSettings {
    let on = |port| SocketAddr::new(listen.address, port);
    ClientSettings {
        control: on(listen.control_port),
        normal_report: on(listen.normal_report_port),
        real_time_report: on(listen.real_time_report_port),
        reconnect_period: Duration::from_millis(50),
        ..ClientSettings::new(listen.address)
    }
}

fn start() -> (Emulator, Client) {
    let emulator = Emulator::start(Listen::anywhere()).expect("free ports");
    let client = Client::start(settings(&emulator.listen)).expect("threads");
    (emulator, client)
}

/// An arm like this, and its client.
fn start_as(properties: Properties) -> (Emulator, Client) {
    let emulator = Emulator::start_as(properties, Listen::anywhere()).unwrap();
    let client = Client::start(settings(&emulator.listen)).unwrap();
    (emulator, client)
}

/// An arm that follows velocities of its flange, and its client.
fn ready() -> (Emulator, Client) {
    let (emulator, client) = start();
    bring_up(&client);
    (emulator, client)
}

/// Waits for a condition on what the client knows, doing something at 250 Hz meanwhile.
fn wait(client: &Client, what: &str, mut each: impl FnMut(), condition: impl Fn(&Status) -> bool) -> Status {
    let start = Instant::now();
    loop {
        let status = client.status();
        if condition(&status) {
            return status;
        }
        assert!(start.elapsed() < WATCHDOG, "{what} did not come: {status:?}");
        each();
        std::thread::sleep(Duration::from_millis(4));
    }
}

fn is_connected(status: &Status) -> bool {
    status.phase == Phase::Connected
}

fn bring_up(client: &Client) {
    wait(client, "a connection", || {}, is_connected);
    client.arm(Mode::CartesianVelocity);
    wait(client, "ready", || {}, |status| status.phase == Phase::Ready);
}

fn is_running(status: &Status) -> bool {
    status.report.is_some_and(|report| report.state == ArmState::Running)
}

fn is_resting(status: &Status) -> bool {
    status.report.is_some_and(|report| report.state == ArmState::Ready)
}

/// The arm stays at rest and the client out of [`Phase::Ready`], whatever is asked for.
fn assert_stays_at_rest(emulator: &Emulator, client: &Client, time: Duration) {
    let start = Instant::now();
    while start.elapsed() < time {
        client.follow(ALONG_Y);
        assert_eq!(emulator.model().speed_mm_per_s(), 0.0);
        assert_ne!(client.status().phase, Phase::Ready);
        std::thread::sleep(Duration::from_millis(4));
    }
}

/// Waits for a condition on the emulated arm.
fn wait_for_arm(emulator: &Emulator, what: &str, condition: impl Fn(&tendon_xarm_emulator::Model) -> bool) {
    let start = Instant::now();
    while !condition(&emulator.model()) {
        assert!(start.elapsed() < WATCHDOG, "{what} did not come: {:?}", emulator.model());
        std::thread::sleep(Duration::from_millis(1));
    }
}
