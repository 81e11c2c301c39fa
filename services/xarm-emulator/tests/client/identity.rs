//! Who the arm is: asked before anything is sent that moves, and refused by name.

use tendon_xarm::identity::Text;
use tendon_xarm::{Firmware, Setup, Unsupported};

use super::*;

#[test]
fn the_arm_says_who_it_is_and_what_is_set() {
    let setup = Setup {
        tcp_offset: [0.0, 0.0, 172.0, 0.0, 0.0, 0.0],
        load_kg: 0.82,
        load_centre_mm: [0.0, 0.0, 48.0],
        collision_sensitivity: 0,
        teaching_sensitivity: 4,
        gravity: Some([0.0, 0.0, 1.0]),
    };
    let serial_number = "XI130506D01L04".to_owned();
    let (_emulator, client) = start_as(Properties { serial_number, setup, ..Properties::default() });
    let status = wait(&client, "the setup", || {}, |status| status.setup.is_some() && is_connected(status));
    assert_eq!((status.setup, status.halt), (Some(setup), None));
    let identity = status.identity.unwrap();
    assert_eq!((identity.axes, identity.model), (7, 7));
    assert_eq!(identity.serial_number.as_str(), "XI130506D01L04");
    assert_eq!(identity.firmware, Firmware { major: 1, minor: 12, revision: 10 });
    assert_eq!(identity.joint_limits().upper_rad[1], 2.024581);
}

#[test]
fn an_arm_that_is_not_supported_is_never_set_in_motion() {
    let default = Properties::default;
    let old = Firmware { major: 1, minor: 7, revision: 9 };
    let unreadable = "7,7,7,B,AC1300,v1.12.10";
    for (properties, unsupported) in [
        (Properties { axes: 6, model: 6, ..default() }, Unsupported::Axes(6)),
        (Properties { model: 13, ..default() }, Unsupported::Model(13)),
        (Properties { firmware: old, ..default() }, Unsupported::Firmware(old)),
        (
            Properties { serial_number: "7,B".to_owned(), ..default() },
            Unsupported::Version(Text::new(unreadable)),
        ),
    ] {
        let (emulator, client) = start_as(properties);
        let refused = Some(Halt::Unsupported(unsupported));
        wait(&client, "the refusal", || {}, |status| is_connected(status) && status.halt == refused);
        client.arm(Mode::CartesianVelocity);
        assert_stays_at_rest(&emulator, &client, Duration::from_millis(300));
        client.bring_up_unless_fault(Mode::CartesianVelocity);
        client.move_gripper(0);
        assert_stays_at_rest(&emulator, &client, Duration::from_millis(100));
        let model = emulator.model();
        assert_eq!((model.report().mode, model.report().health.unwrap().motors_on), (0, 0));
        assert!(!model.gripper().enabled);
        assert_eq!(client.status().halt, refused);
        // A stop is obeyed by any arm.
        client.stop();
        wait(&client, "the stop", || {}, |status| status.stops_acknowledged == 1);
        assert_eq!(client.status().halt, refused);
    }
}
