//! Bringing up: after errors, with the emergency stop held, after another client.

use super::*;

/// Waits until bringing up has come to its end.
fn outcome(client: &Client) -> Status {
    wait(client, "the outcome", || {}, |status| status.phase == Phase::Ready || status.halt.is_some())
}

fn halt_of(code: u8) -> Option<Halt> {
    Some(Halt::Fault(Fault { source: Source::Controller, code }))
}

#[test]
fn an_error_that_nobody_acknowledged_is_not_cleared() {
    let (emulator, client) = start();
    wait(&client, "a connection", || {}, is_connected);
    emulator.inject(Injected::Collision);
    client.bring_up_unless_fault(Mode::CartesianVelocity);
    assert_eq!(outcome(&client).halt, halt_of(31));
    assert_stays_at_rest(&emulator, &client, Duration::from_millis(300));
    assert_eq!(emulator.model().codes(), (31, 0));
    // A person orders it.
    client.arm(Mode::CartesianVelocity);
    assert_eq!(outcome(&client).phase, Phase::Ready);
    assert_eq!(emulator.model().codes(), (0, 0));
}

#[test]
fn without_an_error_the_program_brings_it_up_by_itself() {
    let (_emulator, client) = start();
    wait(&client, "a connection", || {}, is_connected);
    client.bring_up_unless_fault(Mode::JointVelocity);
    assert_eq!(client.status().phase, Phase::BringingUp, "as soon as it is ordered");
    assert_eq!(outcome(&client).phase, Phase::Ready);
}

#[test]
fn while_the_emergency_stop_is_held_arming_says_so() {
    let (emulator, client) = start();
    wait(&client, "a connection", || {}, is_connected);
    emulator.inject(Injected::EmergencyStop);
    for _ in 0..2 {
        client.arm(Mode::CartesianVelocity);
        let status = wait(&client, "the reason", || {}, |status| status.halt == halt_of(1));
        assert_eq!(status.phase, Phase::Connected);
    }
    assert_stays_at_rest(&emulator, &client, Duration::from_millis(200));
    emulator.inject(Injected::Release);
    // Released, but not acknowledged.
    client.bring_up_unless_fault(Mode::CartesianVelocity);
    assert_eq!(outcome(&client).halt, halt_of(1));
    client.arm(Mode::CartesianVelocity);
    assert_eq!(outcome(&client).phase, Phase::Ready);
}

#[test]
fn without_a_connection_arming_says_so_at_once() {
    let listen = Emulator::start(Listen::anywhere()).unwrap().listen;
    let client = Client::start(settings(&listen)).unwrap();
    client.arm(Mode::CartesianVelocity);
    assert_eq!(client.status().halt, Some(Halt::ConnectionBroke));
}

#[test]
fn without_real_time_reports_it_does_not_become_ready() {
    let emulator = Emulator::start(Listen::anywhere()).unwrap();
    let mut settings = settings(&emulator.listen);
    // Normal reports come here, and are too short for real-time ones in no way; nothing listens on port 1.
    settings.real_time_report.set_port(1);
    let client = Client::start(settings).unwrap();
    wait(&client, "a connection", || {}, is_connected);
    client.arm(Mode::CartesianVelocity);
    assert_eq!(outcome(&client).halt, Some(Halt::NoReports));
}

#[test]
fn it_is_brought_up_whatever_another_client_left() {
    let (emulator, client) = ready();
    for mode in [Mode::Position, Mode::Teach, Mode::JointVelocity, Mode::CartesianOnline] {
        for state in [None, Some(tendon_xarm::StateOrder::Pause), Some(tendon_xarm::StateOrder::Stop)] {
            emulator.inject(Injected::Mode(mode));
            if let Some(state) = state {
                emulator.inject(Injected::State(state));
            }
            client.arm(Mode::CartesianVelocity);
            assert_eq!(outcome(&client).phase, Phase::Ready, "{mode:?} {state:?}");
            wait(&client, "motion", || client.follow(ALONG_Y), is_running);
            wait(&client, "rest", || client.follow(REST), is_resting);
        }
    }
}
