//! The gripper: it stops with the arm, keeps what it holds, and never holds up the arm.

use super::*;

/// Where the gripper is, pulses.
fn position(emulator: &Emulator) -> f64 {
    emulator.model().gripper().position_pulses
}

fn close_slowly(emulator: &Emulator, client: &Client) {
    client.move_gripper(0);
    wait_for_arm(emulator, "a moving gripper", |model| model.gripper().moves());
}

fn assert_gripper_stands(emulator: &Emulator) {
    wait_for_arm(emulator, "a standing gripper", |model| !model.gripper().moves());
    let stopped = position(emulator);
    assert!(stopped > 100.0, "it went on to {stopped} pulses");
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(position(emulator), stopped);
}

/// An arm that is ready, with a gripper that takes 8 s to close.
fn ready_with_slow_fingers() -> (Emulator, Client) {
    let emulator = Emulator::start(Listen::anywhere()).unwrap();
    let settings = ClientSettings { gripper_speed: Some(100), ..settings(&emulator.listen) };
    let client = Client::start(settings).unwrap();
    bring_up(&client);
    wait_for_arm(&emulator, "the speed", |model| model.gripper().speed_pulses_per_s == 100.0);
    (emulator, client)
}

#[test]
fn it_is_known_where_it_stands_before_anything_is_ordered() {
    let emulator = Emulator::start(Listen::anywhere()).unwrap();
    let client = Client::start(settings(&emulator.listen)).unwrap();
    let status = wait(&client, "the gripper", || {}, |status| status.gripper.is_some());
    let gripper = status.gripper.unwrap();
    assert_eq!((gripper.position_pulses, gripper.moves), (850, false));
    assert!(!emulator.model().gripper().enabled);
}

#[test]
fn a_stop_stops_it_and_its_grip_is_kept() {
    let (emulator, client) = ready_with_slow_fingers();
    close_slowly(&emulator, &client);
    wait(&client, "that it moves", || {}, |status| status.gripper.is_some_and(|gripper| gripper.moves));
    client.stop();
    assert_gripper_stands(&emulator);
    assert!(emulator.model().gripper().enabled, "its motor holds it");
    wait(&client, "that it stands", || {}, |status| status.gripper.is_some_and(|gripper| !gripper.moves));
}

#[test]
fn every_halt_stops_it() {
    for fault in [Injected::Collision, Injected::Mode(Mode::Position), Injected::Drop] {
        let (emulator, client) = ready_with_slow_fingers();
        close_slowly(&emulator, &client);
        emulator.inject(fault);
        assert_gripper_stands(&emulator);
    }
}

#[test]
fn a_client_that_goes_leaves_it_standing() {
    let (emulator, client) = ready_with_slow_fingers();
    close_slowly(&emulator, &client);
    drop(client);
    assert_gripper_stands(&emulator);
}

#[test]
fn a_stop_does_not_loosen_what_it_holds() {
    let (emulator, client) = ready();
    emulator.inject(Injected::Object(400));
    client.move_gripper(0);
    wait_for_arm(&emulator, "a grip", |model| model.gripper().holds());
    wait(
        &client,
        "that it stands",
        || {},
        |status| status.gripper.is_some_and(|gripper| !gripper.moves && gripper.position_pulses == 400),
    );
    // It is read again once it has had time to begin to move.
    std::thread::sleep(Duration::from_millis(600));
    client.stop();
    wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
    std::thread::sleep(Duration::from_millis(200));
    assert!(emulator.model().gripper().holds());
}

#[test]
fn one_that_does_not_say_where_it_is_is_switched_off() {
    let (emulator, client) = ready_with_slow_fingers();
    close_slowly(&emulator, &client);
    emulator.inject(Injected::GripperLate(Duration::from_secs(2)));
    client.stop();
    assert_gripper_stands(&emulator);
    assert!(!emulator.model().gripper().enabled);
}

#[test]
fn a_slow_one_holds_up_neither_velocities_nor_stops() {
    for late_ms in [120, 2000] {
        let (emulator, client) = ready();
        emulator.inject(Injected::GripperLate(Duration::from_millis(late_ms)));
        wait(&client, "motion", || client.follow(ALONG_Y), is_running);
        client.move_gripper(300);
        wait_for_arm(&emulator, "the gripper's order", |model| model.gripper().target_pulses == 300.0);
        let sent = client.status().velocities_sent;
        // It answers 25 velocities before its gripper has answered one request.
        let before = client.status();
        let status = wait(
            &client,
            "more velocities",
            || client.follow(ALONG_Y),
            |status| status.velocities_sent > sent + 25,
        );
        assert_eq!((status.timeouts, status.halt, status.connections), (before.timeouts, None, 1));
        client.move_gripper(500);
        client.stop();
        let status = wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
        assert_eq!(status.connections, 1);
        assert_eq!(emulator.model().state(), ArmState::Stopped);
    }
}

#[test]
fn a_slow_one_is_read_all_the_same_and_the_newest_order_wins() {
    let (emulator, client) = ready();
    emulator.inject(Injected::GripperLate(Duration::from_millis(120)));
    client.move_gripper(300);
    client.move_gripper(500);
    wait(
        &client,
        "the position",
        || client.follow(ALONG_Y),
        |status| status.gripper.is_some_and(|gripper| gripper.position_pulses == 500 && !gripper.moves),
    );
}

#[test]
fn one_that_was_switched_off_obeys_after_arming() {
    let (emulator, client) = ready();
    emulator.inject(Injected::GripperOff);
    client.move_gripper(300);
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(position(&emulator), 850.0);
    client.arm(Mode::CartesianVelocity);
    wait(&client, "ready", || {}, |status| status.phase == Phase::Ready);
    client.move_gripper(300);
    wait_for_arm(&emulator, "the position", |model| model.gripper().position_pulses == 300.0);
}

#[test]
fn without_one_nothing_is_asked_of_it() {
    let emulator = Emulator::start(Listen::anywhere()).unwrap();
    let client = Client::start(ClientSettings { gripper_speed: None, ..settings(&emulator.listen) }).unwrap();
    bring_up(&client);
    client.move_gripper(0);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    client.stop();
    wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
    assert_eq!(client.status().gripper, None);
    let gripper = *emulator.model().gripper();
    assert!(!gripper.enabled && gripper.target_pulses == 850.0);
    assert_eq!(emulator.gripper_requests(), 0);
}
