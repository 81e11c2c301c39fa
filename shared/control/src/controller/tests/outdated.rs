//! Orders to arm that come late, or that a stop has overtaken.

use super::*;

#[test]
fn an_order_to_arm_counts_for_two_seconds_and_for_no_state_before_the_newest_stop() {
    let mut rig = Rig::moving();
    let seen_ns = rig.now_ns;
    rig.pass(4);
    rig.controller.order_stop(rig.now_ns);
    let stopped_ns = rig.now_ns;
    rig.pass(300);
    assert_eq!(rig.order_arm(seen_ns), Some(Outdated::StoppedSince));
    assert_eq!(rig.order_arm(0), Some(Outdated::StoppedSince), "it does not say what it saw");
    assert_eq!(rig.order_arm(stopped_ns - 1), Some(Outdated::StoppedSince));
    assert_eq!(rig.order_arm(rig.now_ns + 1), Some(Outdated::TooLate), "nobody sees what is to come");
    assert_eq!(rig.order_arm(u64::MAX), Some(Outdated::TooLate));
    // A stop of an arm that is stopped counts as any other.
    let seen_ns = rig.now_ns;
    rig.pass(4);
    rig.controller.order_stop(rig.now_ns);
    assert_eq!(rig.order_arm(seen_ns), Some(Outdated::StoppedSince));
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Waiting, Permission::Stopped));
    let seen_ns = rig.now_ns;
    rig.pass(2000);
    assert_eq!(rig.controller.is_outdated(seen_ns, rig.now_ns), None);
    rig.pass(4);
    assert_eq!(rig.order_arm(seen_ns), Some(Outdated::TooLate));
    assert_eq!(rig.controller.take_answer(), None, "those who wait for another order hear nothing of it");
    rig.assert_arms();
}

#[test]
fn whatever_stopped_the_arm_has_to_be_seen_before_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::moving();
        let seen_ns = rig.now_ns;
        rig.pass(4);
        cause(&mut rig);
        rig.pass(8);
        assert_eq!(rig.permission(), Permission::Stopped, "{reason:?}");
        assert_eq!(rig.order_arm(seen_ns), Some(Outdated::StoppedSince), "{reason:?}");
    }
    // Nor is an error acknowledged that was not shown, or what was before a robot process that was started again.
    let mut rig = Rig::moving();
    rig.controller.order_stop(rig.now_ns);
    rig.pass(300);
    let seen_ns = rig.now_ns;
    rig.pass(4);
    rig.arm.0.borrow_mut().report.error_code = Some(31);
    rig.pass(200);
    assert_eq!(rig.order_arm(seen_ns), Some(Outdated::StoppedSince));
    assert_eq!(rig.order_arm(rig.now_ns - 100 * MS), None, "an error that stands is no new one");
    let arm = FakeArm::at(&settings().arm, settings().arm.start_joints_rad());
    let again = Controller::new(Box::new(arm), settings(), Some(StopReason::StageEnded), 500 * MS);
    assert_eq!(again.is_outdated(499 * MS, 501 * MS), Some(Outdated::StoppedSince));
    assert_eq!(again.is_outdated(500 * MS, 501 * MS), None);
}

/// A stop at one time, an order to arm that was given at another and comes at a third: all orders of these.
#[test]
fn no_order_to_arm_of_somebody_who_saw_the_arm_before_a_stop_undoes_it() {
    const STEP_MS: u64 = 52;
    for stop_at in 0..5 {
        for seen_at in 0..5 {
            for comes_at in seen_at..5 {
                for stop_is_first in [false, true] {
                    let mut rig = Rig::moving();
                    rig.controller.order_stop(rig.now_ns);
                    let begun_ns = rig.now_ns;
                    for step in 0..5 {
                        rig.pass(STEP_MS);
                        if step == stop_at && stop_is_first {
                            rig.controller.order_stop(rig.now_ns);
                        }
                        if step == comes_at {
                            rig.order_arm(begun_ns + (seen_at + 1) * STEP_MS * MS);
                        }
                        if step == stop_at && !stop_is_first {
                            rig.controller.order_stop(rig.now_ns);
                        }
                    }
                    rig.pass(200);
                    rig.rest(3);
                    let came_after = comes_at > stop_at || (comes_at == stop_at && stop_is_first);
                    let is_armed = seen_at >= stop_at && came_after;
                    let expected = if is_armed { Permission::Granted } else { Permission::Stopped };
                    let case = (stop_at, seen_at, comes_at, stop_is_first);
                    assert_eq!(rig.permission(), expected, "{case:?}");
                }
            }
        }
    }
}
