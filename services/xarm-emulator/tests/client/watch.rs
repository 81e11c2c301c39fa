//! What is watched while the arm follows: mode, state, refusals, silence.

use tendon_xarm::StateOrder;

use super::*;

fn halted(client: &Client) -> Status {
    wait(client, "a halt", || client.follow(ALONG_Y), |status| status.halt.is_some())
}

#[test]
fn another_mode_is_a_halt_even_at_rest() {
    let (emulator, client) = ready();
    emulator.inject(Injected::Mode(Mode::Position));
    // Nothing is sent meanwhile: the reports tell.
    let status = wait(&client, "a halt", || {}, |status| status.halt.is_some());
    assert_eq!((status.phase, status.halt), (Phase::Connected, Some(Halt::ModeChanged(0))));
    assert!(status.halt.unwrap().to_string().contains("mode 0 (positions)"));
    assert_stays_at_rest(&emulator, &client, Duration::from_millis(200));
    bring_up(&client);
}

#[test]
fn another_state_is_a_halt() {
    for (order, state) in [(StateOrder::Pause, ArmState::Paused), (StateOrder::Stop, ArmState::Stopped)] {
        let (emulator, client) = ready();
        emulator.inject(Injected::State(order));
        let status = wait(&client, "a halt", || {}, |status| status.halt.is_some());
        assert_eq!((status.phase, status.halt), (Phase::Connected, Some(Halt::NotReady(state))));
        assert_stays_at_rest(&emulator, &client, Duration::from_millis(100));
    }
}

#[test]
fn a_mode_that_is_changed_and_changed_back_is_noticed() {
    let (emulator, client) = ready();
    emulator.inject(Injected::Mode(Mode::Position));
    std::thread::sleep(Duration::from_millis(50));
    emulator.inject(Injected::Mode(Mode::CartesianVelocity));
    assert_eq!(halted(&client).phase, Phase::Connected);
}

#[test]
fn a_refused_velocity_is_a_halt() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    emulator.inject(Injected::Refuse(1));
    let status = halted(&client);
    assert_eq!((status.phase, status.halt), (Phase::Connected, Some(Halt::VelocityRefused)));
    wait_for_arm(&emulator, "rest", |model| model.speed_mm_per_s() == 0.0);
    assert_stays_at_rest(&emulator, &client, Duration::from_millis(200));
}

#[test]
fn the_error_behind_a_stop_is_told() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    emulator.inject(Injected::Error(24));
    let speed = Some(Halt::Fault(Fault { source: Source::Controller, code: 24 }));
    let status = wait(&client, "the error", || client.follow(ALONG_Y), |status| status.halt == speed);
    assert_eq!(status.phase, Phase::Connected);
}

#[test]
fn silence_tells_how_long_the_arm_has_not_answered() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    assert!(client.status().answered_at.is_some());
    emulator.inject(Injected::Silent(1000));
    let long = Duration::from_millis(300);
    wait(&client, "silence", || client.follow(ALONG_Y), |status| status.silence(Instant::now()) >= long);
    emulator.inject(Injected::Silent(0));
    wait(&client, "an answer", || client.follow(REST), |status| status.silence(Instant::now()) < long);
}

#[test]
fn a_slow_connection_is_told_and_kept() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    // Each reply comes after the time for it, and later than the one before.
    emulator.inject(Injected::Late(Duration::from_millis(150), 20));
    let before = client.status().timeouts;
    let status = wait(
        &client,
        "timeouts",
        || client.follow(ALONG_Y),
        |status| status.timeouts > before + 12 && status.silence(Instant::now()) > Duration::from_millis(300),
    );
    assert_eq!((status.connections, status.phase), (1, Phase::Ready));
}

#[test]
fn a_stop_that_is_not_acknowledged_is_sent_over_a_new_connection() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    // More than are sent within 2 s.
    emulator.inject(Injected::Silent(25));
    client.stop();
    let status = wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
    assert_eq!((status.connections, emulator.model().state()), (2, ArmState::Stopped));
}

#[test]
fn a_stop_is_acknowledged_by_an_arm_that_answers_slowly() {
    let (emulator, client) = ready();
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    // Later than the stop is sent again.
    emulator.inject(Injected::Late(Duration::from_millis(150), 1000));
    client.stop();
    assert_ne!(client.status().phase, Phase::Ready, "as soon as it is ordered");
    wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
    assert_eq!(emulator.model().state(), ArmState::Stopped);
}
