//! Every cause of a stop, in every phase.

use super::*;

#[test]
fn whatever_stops_the_arm_on_the_way_to_its_start_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::on_the_way();
        cause(&mut rig);
        rig.assert_stopped(reason);
        repair(&mut rig);
        // From where it is: not a step of the way that was left.
        rig.assert_arms();
    }
}

#[test]
fn whatever_stops_the_arm_while_it_follows_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::moving();
        cause(&mut rig);
        rig.assert_stopped(reason);
        repair(&mut rig);
        rig.assert_arms();
    }
}

#[test]
fn whatever_stops_the_arm_while_it_is_brought_up_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::near();
        rig.pass(60);
        assert_eq!(rig.phase(), ArmPhase::BringingUp);
        if matches!(reason, StopReason::OverSpeed) || rig.arm.0.borrow().report.link != Link::BringingUp {
            continue;
        }
        cause(&mut rig);
        if rig.arm.0.borrow().report.silent_ns > 0 {
            // Switching motors on takes the arm longer than this without a word.
            continue;
        }
        rig.assert_stopped(reason);
        repair(&mut rig);
        rig.assert_arms();
    }
}

#[test]
fn a_stop_that_the_arm_cannot_hear_is_not_confirmed() {
    let mut rig = Rig::moving();
    assert_eq!(rig.controller.order_stop(rig.now_ns), StopAnswer::Stopped);
    rig.arm.0.borrow_mut().report.silent_ns = 301 * MS;
    assert_eq!(rig.controller.order_stop(rig.now_ns), StopAnswer::ArmSilent);
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    assert_eq!(rig.controller.order_stop(rig.now_ns), StopAnswer::NotConnected);
    for answer in [StopAnswer::ArmSilent, StopAnswer::NotConnected] {
        assert!(
            answer.text().starts_with("not confirmed") && answer.text().contains("emergency stop button")
        );
    }
}

#[test]
fn while_stopped_the_first_reason_stays_but_for_an_error_of_the_arm_and_nothing_moves() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::moving();
        rig.controller.order_stop(rig.now_ns);
        rig.pass(300);
        cause(&mut rig);
        rig.pass(100);
        assert_eq!(rig.permission(), Permission::Stopped);
        let shown = if reason == StopReason::ArmFault { reason } else { StopReason::Ordered };
        assert_eq!(rig.reason(), Some(shown), "{reason:?}");
    }
}
