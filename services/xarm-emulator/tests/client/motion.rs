//! Motion, stops, errors and broken connections.

use std::net::Ipv4Addr;

use super::*;

#[test]
fn it_brings_the_arm_up_moves_it_and_grips() {
    let (emulator, client) = start();
    client.follow(ALONG_Y);
    let connected = wait(&client, "a report", || {}, |status| status.report.is_some());
    let start_y_mm = connected.report.unwrap().pose[1];
    assert_eq!(emulator.model().speed_mm_per_s(), 0.0, "nothing moves before it is armed");
    bring_up(&client);
    wait(
        &client,
        "20 mm",
        || client.follow(ALONG_Y),
        |status| status.report.is_some_and(|report| report.pose[1] - start_y_mm > 20.0),
    );
    wait(&client, "rest", || client.follow(REST), is_resting);
    client.move_gripper(300);
    let status = wait(
        &client,
        "the gripper",
        || {},
        |status| status.gripper.is_some_and(|gripper| gripper.position_pulses == 300),
    );
    assert_eq!((status.late_replies, status.timeouts, status.garbage_bytes), (0, 0, 0));
    assert_eq!(status.halt, None);
}

#[test]
fn joints_follow_in_their_own_mode_and_not_in_another() {
    let (emulator, client) = start();
    wait(&client, "a connection", || {}, is_connected);
    client.arm(Mode::JointVelocity);
    wait(&client, "ready", || {}, |status| status.phase == Phase::Ready);
    let before = emulator.model().report().joints_rad;
    client.follow(ALONG_Y);
    let joints = Velocity::Joints([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2]);
    wait(
        &client,
        "joint 7",
        || client.follow(joints),
        |status| status.report.is_some_and(|report| report.joints_rad[6] - before[6] > 0.02),
    );
    assert_eq!(emulator.model().report().joints_rad[..6], before[..6]);
}

#[test]
fn without_new_velocities_the_arm_rests_by_itself() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    wait(&client, "rest", || {}, is_resting);
    assert_eq!(emulator.model().speed_mm_per_s(), 0.0);
    assert_eq!(client.status().phase, Phase::Ready);
}

#[test]
fn a_stop_lasts_until_the_arm_is_armed_again() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    client.follow(ALONG_Y);
    client.stop();
    let status =
        wait(&client, "the stop", || client.follow(ALONG_Y), |status| status.stops_acknowledged == 1);
    assert_eq!((status.phase, status.halt), (Phase::Connected, Some(Halt::Ordered)));
    let stopped = emulator.model();
    assert_eq!((stopped.speed_mm_per_s(), stopped.state()), (0.0, ArmState::Stopped));
    client.follow(ALONG_Y);
    bring_up(&client);
    assert_eq!(emulator.model().report().pose, stopped.report().pose, "no motion without a new velocity");
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
}

#[test]
fn a_stop_does_not_wait_for_the_reply_of_another_request() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    // The reply to the gripper would be waited for, for two seconds.
    emulator.inject(Injected::Silent(1));
    client.move_gripper(100);
    let start = Instant::now();
    while emulator.model().gripper().target_pulses != 100.0 {
        assert!(start.elapsed() < WATCHDOG);
        std::thread::yield_now();
    }
    let connections = client.status().connections;
    client.stop();
    let status = wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
    assert_eq!((status.timeouts, status.connections), (0, connections));
}

#[test]
fn errors_stop_the_motion_and_say_what_to_do() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    emulator.inject(Injected::Collision);
    let collision = Fault { source: Source::Controller, code: 31 };
    let status = wait(
        &client,
        "the collision",
        || client.follow(ALONG_Y),
        |status| status.fault == Some(collision) && status.phase == Phase::Connected,
    );
    assert!(status.halt.is_some(), "{status:?}");
    assert!(collision.to_string().contains("look for what was touched"));
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);

    emulator.inject(Injected::EmergencyStop);
    wait(
        &client,
        "the emergency stop",
        || client.follow(ALONG_Y),
        |status| {
            status.fault.is_some_and(|fault| fault.is_emergency_stop()) && status.phase == Phase::Connected
        },
    );
    client.arm(Mode::CartesianVelocity);
    let pressed = Halt::Fault(Fault { source: Source::Controller, code: 1 });
    wait(&client, "the refusal", || {}, |status| status.halt == Some(pressed));
    emulator.inject(Injected::Release);
    bring_up(&client);
}

#[test]
fn a_cut_connection_is_made_anew_and_waits_to_be_armed() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    emulator.inject(Injected::Drop);
    let status = wait(
        &client,
        "a new connection",
        || client.follow(ALONG_Y),
        |status| status.connections == 2 && status.phase == Phase::Connected,
    );
    assert_eq!(status.halt, Some(Halt::ConnectionBroke));
    wait(&client, "rest", || client.follow(ALONG_Y), is_resting);
    assert_eq!(emulator.model().speed_mm_per_s(), 0.0);
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
}

#[test]
fn late_torn_missing_and_garbage_replies_are_survived() {
    let (emulator, client) = start();
    bring_up(&client);
    for (fault, is_noticed) in [
        (
            Injected::Late(Duration::from_millis(250), 1),
            (|now, before| now.late_replies > before.late_replies) as fn(&Status, &Status) -> bool,
        ),
        (Injected::Torn(3), |now, before| now.velocities_sent > before.velocities_sent + 20),
        (Injected::Silent(2), |now, before| now.timeouts > before.timeouts + 1),
        (Injected::Garbage(2), |now, before| now.garbage_bytes > before.garbage_bytes),
    ] {
        let before = client.status();
        emulator.inject(fault);
        wait(&client, "the fault", || client.follow(ALONG_Y), |now| is_noticed(now, &before));
        let sent = client.status().velocities_sent;
        wait(&client, "more velocities", || client.follow(REST), |status| status.velocities_sent > sent + 10);
        wait(&client, "rest", || client.follow(REST), is_resting);
        assert_eq!(client.status().phase, Phase::Ready, "{fault:?}");
    }
    assert_eq!(client.status().connections, 1);
}

#[test]
fn an_arm_that_comes_later_is_found() {
    // An address of its own: a port of 127.0.0.1 that is given back may be taken by any connection, even by
    // that of the client to itself.
    let address = Ipv4Addr::new(127, 0, 0, 2).into();
    let listen = Emulator::start(Listen { address, ..Listen::anywhere() }).unwrap().listen;
    let client = Client::start(settings(&listen)).unwrap();
    client.arm(Mode::CartesianVelocity);
    let start = Instant::now();
    // The ports may stay taken for a moment after the first emulator.
    let _emulator = loop {
        match Emulator::start(listen) {
            Ok(emulator) => break emulator,
            Err(error) => assert!(start.elapsed() < WATCHDOG, "{error}"),
        }
    };
    // The first connection may be one that the first emulator still took, and break.
    let arm_if_connected = || {
        if client.status().phase == Phase::Connected {
            client.arm(Mode::CartesianVelocity);
        }
    };
    wait(&client, "ready", arm_if_connected, |status| status.phase == Phase::Ready);
}

#[test]
fn a_client_that_goes_leaves_the_arm_stopped() {
    let (emulator, client) = start();
    bring_up(&client);
    wait(&client, "motion", || client.follow(ALONG_Y), is_running);
    drop(client);
    let start = Instant::now();
    while emulator.model().state() != ArmState::Stopped {
        assert!(start.elapsed() < WATCHDOG);
        std::thread::yield_now();
    }
}
