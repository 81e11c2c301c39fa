//! Arms that move well, badly, late and not at all.

use super::*;
use crate::kinematics::UPPER_LIMITS_RAD;
use crate::velocity::joint_velocities;

const MS: u64 = 1_000_000;
const REST: Told = Told { velocity: Twist::ZERO, joints_rad_per_s: None, silent_ns: 0 };

fn guard() -> (Guard, JointVector) {
    let settings = ArmSettings::default();
    (Guard::new(&settings), settings.start_joints_rad())
}

fn along(axis: usize, speed_mm_per_s: f64) -> Twist {
    let mut twist = Twist::ZERO;
    twist.linear_mm_per_s[axis] = speed_mm_per_s;
    twist
}

/// Joints (rad) every 4 ms of an arm that moves at the velocity of each step from the start.
fn path(twist_of: impl Fn(u64) -> Twist) -> impl Iterator<Item = (u64, JointVector)> {
    let (arm, mut joints_rad) = (XArm7::new(), ArmSettings::default().start_joints_rad());
    (0..).map(move |step| {
        let now = joints_rad;
        joints_rad += joint_velocities(&arm, &joints_rad, &twist_of(step)).rad_per_s * 4e-3;
        (step * 4 * MS, now)
    })
}

fn moving(axis: usize, speed_mm_per_s: f64) -> impl Iterator<Item = (u64, JointVector)> {
    path(move |_| along(axis, speed_mm_per_s))
}

/// When, in ms, something is first found of an arm that moves and is told such velocities in each step.
fn found_ms(
    steps: usize,
    moves: impl Fn(u64) -> Twist,
    told: impl Fn(u64) -> Told,
) -> Option<(u64, LimitViolation)> {
    let (mut guard, _) = guard();
    path(moves).take(steps).enumerate().find_map(|(step, (now_ns, joints_rad))| {
        let violation = guard.check(now_ns, now_ns, &joints_rad, &told(step as u64)).err()?;
        Some((now_ns / MS, violation))
    })
}

#[test]
fn an_arm_within_its_limits_passes() {
    let told = |_| Told::velocity(along(1, 100.0));
    assert_eq!(found_ms(900, |_| along(1, 100.0), told), None);
}

#[test]
fn a_joint_beyond_its_limit_is_named() {
    let (mut guard, mut joints) = guard();
    joints[3] = UPPER_LIMITS_RAD[3] + 0.009;
    assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
    joints[3] = UPPER_LIMITS_RAD[3] + 0.011;
    let violation = guard.check(0, 0, &joints, &REST).unwrap_err();
    assert!(matches!(violation, LimitViolation::JointLimit { joint: 4, .. }));
    assert!(
        violation.to_string().contains("joint 4 is at 225.6°")
            && violation.to_string().contains("tendon arm")
    );
    joints[3] = f64::NAN;
    assert!(guard.check(0, 0, &joints, &REST).is_err());
    // The limits are those of the arm that is there.
    let (mut guard, mut joints) = self::guard();
    joints[1] = 2.035;
    assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
    let mut limits = JointLimits::default();
    limits.upper_rad[1] = 2.0246;
    guard.set_joint_limits(limits);
    assert!(matches!(guard.check(0, 0, &joints, &REST), Err(LimitViolation::JointLimit { joint: 2, .. })));
}

#[test]
fn a_flange_that_leaves_the_workspace_is_named_and_may_come_back() {
    let (mut guard, _) = guard();
    let told = Told::velocity(along(2, 100.0));
    let found = moving(2, 100.0)
        .find_map(|(now_ns, joints)| Some((guard.check(now_ns, now_ns, &joints, &told).err()?, joints)));
    let (violation, outside) = found.unwrap();
    assert!(matches!(violation, LimitViolation::WorkspaceBox { axis: 'z', .. }));
    guard.reset();
    assert_eq!(guard.check(0, 0, &outside, &told), Ok(()));
    guard.course.begin_anew();
    assert_eq!(guard.check(4 * MS, 4 * MS, &ArmSettings::default().start_joints_rad(), &told), Ok(()));
    guard.course.begin_anew();
    assert!(guard.check(8 * MS, 8 * MS, &outside, &told).is_err());
}

#[test]
fn too_fast_is_found_over_100_ms() {
    let told = |_| Told::velocity(along(1, 100.0));
    let (found_ms, violation) = found_ms(100, |_| along(1, 175.0), told).unwrap();
    assert_eq!(found_ms, 100);
    assert!(matches!(violation, LimitViolation::OverSpeed { .. }));
    // A jump within less than 100 ms is an outlier of the report, or shows in the next measurement.
    let (mut guard, joints) = guard();
    let (_, aside) = moving(1, 100.0).nth(12).unwrap();
    assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
    assert_eq!(guard.check(4 * MS, 4 * MS, &aside, &REST), Ok(()));
    assert_eq!(guard.check(52 * MS, 52 * MS, &aside, &REST), Ok(()));
}

#[test]
fn an_arm_that_creeps_at_commanded_rest_is_found_within_100_ms_of_the_braking() {
    for (speed_mm_per_s, expected_ms) in [(20.0, Some(452)), (60.0, Some(168))] {
        let found = found_ms(1000, |_| along(1, speed_mm_per_s), |_| REST);
        assert_eq!(found.map(|(at_ms, _)| at_ms), expected_ms, "{speed_mm_per_s} mm/s");
    }
    // A slower one is found once it has moved by 5 mm.
    let (found_at_ms, violation) = found_ms(1000, |_| along(1, 5.0), |_| REST).unwrap();
    assert!((1350..1370).contains(&found_at_ms), "{found_at_ms}");
    assert!(matches!(violation, LimitViolation::Drifted { .. }));
    // One that comes to rest in time does not, whatever it was commanded before.
    let late = |lag: u64| {
        move |step: u64| match step.checked_sub(lag) {
            Some(0..100) => along(1, 100.0),
            _ => Twist::ZERO,
        }
    };
    assert_eq!(found_ms(1000, late(60), |step| Told::velocity(late(0)(step))), None);
    // Nor does one that follows a command so slow that it counts as rest.
    assert_eq!(found_ms(5000, |_| along(1, 0.9), |_| Told::velocity(along(1, 0.9))), None);
}

#[test]
fn an_arm_that_does_not_move_as_it_is_told_is_found_before_it_is_far() {
    let told = |_| Told::velocity(along(2, 50.0));
    for (moves, axis, within_ms) in [
        (along(2, 0.0), 'z', 660),
        (along(2, -50.0), 'z', 660),
        (Twist { linear_mm_per_s: [0.0, 60.0, 50.0], ..Twist::ZERO }, 'y', 660),
        (along(2, 100.0), 'z', 660),
    ] {
        let (at_ms, violation) = found_ms(1000, |_| moves, told).unwrap();
        assert!(at_ms <= within_ms, "{moves:?}: {at_ms} ms");
        let is_named = match violation {
            LimitViolation::NotFollowing { axis: found, .. } => found == axis,
            LimitViolation::OffCourse { .. } => true,
            _ => false,
        };
        assert!(is_named, "{violation}");
    }
    // In the middle of a long motion it takes less: the arm begins to go sideways after 2 s.
    let aside = |step: u64| Twist {
        linear_mm_per_s: [0.0, if step < 500 { 0.0 } else { 100.0 }, 50.0],
        ..Twist::ZERO
    };
    let (at_ms, _) = found_ms(1000, aside, told).unwrap();
    assert!((2050..=2150).contains(&at_ms), "{at_ms}");
}

#[test]
fn an_arm_that_follows_late_smoothly_or_not_quite_passes() {
    // To and fro at full speed, as no ramp would command it.
    let square = |step: u64| along(1, if (step / 150).is_multiple_of(2) { 100.0 } else { -100.0 });
    let told = |step: u64| Told::velocity(square(step));
    for lag_steps in [0, 10, 60] {
        let late = move |step: u64| square(step.saturating_sub(lag_steps));
        assert_eq!(found_ms(3000, late, told), None, "{lag_steps} steps late");
    }
    let smooth = |step: u64| {
        let last = (0..60).map(|back| square(step.saturating_sub(back)).linear_mm_per_s[1]);
        along(1, last.sum::<f64>() / 60.0)
    };
    assert_eq!(found_ms(3000, smooth, told), None);
    assert_eq!(found_ms(500, |_| along(1, 60.0), |_| Told::velocity(along(1, 100.0))), None);
    // A rotation about the tip of a tool moves the flange.
    let turn = Twist { angular_rad_per_s: [0.0, 0.0, 0.5], ..Twist::ZERO };
    assert_eq!(found_ms(400, |_| along(1, 100.0), |_| Told::velocity(turn)), None);
    // One that may not have heard what it was told may rest.
    let unheard = |_| Told { silent_ns: 200 * MS, ..Told::velocity(along(1, 100.0)) };
    assert_eq!(found_ms(1000, |_| Twist::ZERO, unheard), None);
}

#[test]
fn an_arm_that_is_held_through_short_motions_with_rests_is_found() {
    for (motion, rest) in [(125, 125), (150, 100), (100, 60)] {
        let told =
            |step: u64| Told::velocity(along(0, if step % (motion + rest) < motion { 50.0 } else { 0.0 }));
        let (at_ms, violation) = found_ms(2000, |_| Twist::ZERO, told).unwrap();
        assert!(matches!(violation, LimitViolation::OffCourse { .. }), "{violation}");
        assert!(at_ms < 2000, "{motion} and {rest} steps: {at_ms} ms");
    }
}

/// Whoever looks again after a stall sees an old report first.
#[test]
fn a_guard_that_stood_still_does_not_measure_from_an_old_report() {
    let (mut guard, _) = guard();
    let moving: Vec<(u64, JointVector)> = moving(1, 100.0).take(300).collect();
    for (now_ns, joints_rad) in &moving[..100] {
        let told = Told::velocity(along(1, 100.0));
        assert_eq!(guard.check(*now_ns, *now_ns, joints_rad, &told), Ok(()));
    }
    let (stalled_ns, old_rad) = moving[99];
    let (resumed_ns, new_rad) = (stalled_ns + 140 * MS, moving[134].1);
    for step in 0..3 {
        let now_ns = resumed_ns + step * 4 * MS;
        assert_eq!(guard.check(now_ns, stalled_ns, &old_rad, &REST), Ok(()));
    }
    for step in 3..500 {
        let now_ns = resumed_ns + step * 4 * MS;
        assert_eq!(guard.check(now_ns, now_ns, &new_rad, &REST), Ok(()), "{step}");
    }
}

/// Reports that come late, and then all at once, look like no fast arm.
#[test]
fn late_reports_are_measured_from_when_they_came() {
    let (mut guard, _) = guard();
    let told = Told::velocity(along(1, 100.0));
    let path: Vec<(u64, JointVector)> = moving(1, 100.0).take(800).collect();
    let mut reported = 0;
    for (step, (now_ns, _)) in path.iter().enumerate() {
        // Every second the reports stop for 200 ms.
        if step % 250 >= 50 {
            reported = step;
        }
        let (reported_ns, joints_rad) = path[reported];
        let silent_ns = now_ns - reported_ns;
        let told = Told { silent_ns, ..told };
        assert_eq!(guard.check(*now_ns, reported_ns, &joints_rad, &told), Ok(()), "{step}");
    }
}

#[test]
fn an_arm_on_a_slow_network_that_is_held_is_found() {
    let told = |_| Told { silent_ns: 120 * MS, ..Told::velocity(along(1, 50.0)) };
    let (at_ms, _) = found_ms(2000, |_| Twist::ZERO, told).unwrap();
    assert!(at_ms < 1000, "{at_ms}");
}

#[test]
fn single_joints_that_go_elsewhere_are_found() {
    let rates = JointVector::from([0.17, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1]);
    let told = Told { joints_rad_per_s: Some(rates), ..REST };
    for (name, moves) in [
        ("held", JointVector::zeros()),
        ("joint 7 reversed", JointVector::from([0.17, 0.0, 0.0, 0.0, 0.0, 0.0, -0.1])),
        ("joint 2 turns as well", JointVector::from([0.17, 0.1, 0.0, 0.0, 0.0, 0.0, 0.1])),
    ] {
        let (mut guard, mut joints_rad) = guard();
        // What the flange is told does not matter here: the flange may go anywhere.
        guard.most_mm_per_s = f64::INFINITY;
        let found = (0..1000_u64).find_map(|step| {
            let here = guard.arm.jacobian(&joints_rad) * moves;
            let told = Told { velocity: Twist::from_vector_m(&here), ..told };
            let violation = guard.check(step * 4 * MS, step * 4 * MS, &joints_rad, &told).err();
            joints_rad += moves * 4e-3;
            violation.map(|violation| (step * 4, violation))
        });
        let (at_ms, violation) = found.unwrap();
        assert!(matches!(violation, LimitViolation::JointOffCourse { .. }), "{name}: {violation}");
        assert!(at_ms < 1500, "{name}: {at_ms} ms");
    }
}
