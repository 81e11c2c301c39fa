//! Whether commands reach the arm.
//!
//! ```text
//!                       windows that say rest
//! start ──▶ await rest ─────────────────────────▶ granted
//!              ▲    ▲ no commands, supervisor or arm silent, stall │
//!     arm order│    └──────────────────────────────────────────────┤
//!              │                                                   │ order, arm error, limit, end of a stage
//! start ──▶ stopped ◀──────────────────────────────────────────────┘
//! (not left in good order, or far from the start position)
//! ```
//!
//! Whatever interrupted a motion, the arm does not move again before the person has been at rest: the muscles may
//! still say what was meant before the interruption.

use tendon_messages::{Activity, CommandHeader, Permission, REST, StopReason};

use crate::arm::Stop;

/// The permission to move, and why there is none.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Latch {
    permission: Permission,
    stop: Option<Stop>,
    /// Windows in a row that said rest.
    rests: u32,
    /// How many of them are a rest. One alone may be a mistake of the classifier, or the first of a signal chain that began
    /// anew and does not know better yet.
    rest_windows: u32,
    /// Whether rest is known only once the activity detector is calibrated.
    needs_calibration: bool,
}

impl Latch {
    /// At the start nothing moves before the person has been at rest. `needs_calibration`: that is known only once the
    /// activity detector is calibrated.
    pub fn new(rest_windows: u32, needs_calibration: bool) -> Latch {
        Latch { permission: Permission::AwaitRest, stop: None, rests: 0, rest_windows, needs_calibration }
    }

    /// Whether the arm may follow the command of a window. What grants motion again is rest: intact windows that were
    /// recognised as such. What was voted would not do, as votes begin with rest.
    pub fn admits(&mut self, header: &CommandHeader) -> bool {
        let is_calibrating = Activity::from_number(header.context.activity) == Activity::Calibrating;
        // A window of which nobody knows what it shows, such as that of a loose electrode, may hide a contraction.
        let is_rest = header.gesture == REST
            && header.is_unsure == 0
            && header.context.replaced_samples == 0
            && !(self.needs_calibration && is_calibrating);
        self.rests = if is_rest { self.rests + 1 } else { 0 };
        if self.permission == Permission::AwaitRest && self.rests >= self.rest_windows {
            *self = Latch { permission: Permission::Granted, stop: None, ..*self };
        }
        self.permission == Permission::Granted
    }

    /// Windows are missing: those before say nothing about now, and the count of rests begins anew.
    pub fn break_row(&mut self) {
        self.rests = 0;
    }

    /// Nothing moves before [`Latch::arm`]. The first reason stays, unless what follows says more.
    pub fn stop(&mut self, stop: Stop) {
        let says_more = self.stop.is_none_or(|before| says_more(stop.reason, before.reason));
        if self.permission != Permission::Stopped || says_more {
            *self = Latch { permission: Permission::Stopped, stop: Some(stop), rests: 0, ..*self };
        }
    }

    /// Nothing moves before the person has been at rest.
    pub fn interrupt(&mut self, reason: StopReason) {
        self.rests = 0;
        if self.permission == Permission::Granted {
            *self = Latch { stop: Some(Stop::because(reason)), ..self.anew() };
        }
    }

    /// Motion is wanted again; it is not to be had before the arm is up.
    pub fn forget_reason(&mut self) {
        self.stop = None;
    }

    /// The arm is up again: it moves with the next rest.
    pub fn arm(&mut self) {
        *self = self.anew();
    }

    fn anew(&self) -> Latch {
        Latch::new(self.rest_windows, self.needs_calibration)
    }

    pub fn permission(&self) -> Permission {
        self.permission
    }

    pub fn reason(&self) -> Option<Stop> {
        self.stop
    }
}

/// Whether a reason to stop tells a person more than the one before. An error of the arm always does: nobody may
/// acknowledge what was not shown.
fn says_more(reason: StopReason, before: StopReason) -> bool {
    use StopReason::{
        ArmFault, ConnectionBroke, NeverConnected, NotReady, StageEnded, TakenOver, VelocityRefused,
    };
    match reason {
        ArmFault => before != ArmFault,
        ConnectionBroke | NeverConnected => {
            before.is_how_found() || matches!(before, NotReady | StageEnded | TakenOver | VelocityRefused)
        }
        _ => before.is_how_found() && !reason.is_how_found(),
    }
}

#[cfg(test)]
mod tests {
    use tendon_messages::WindowContext;

    use tendon_gesture::Gesture;

    use super::*;

    const REST_WINDOWS: u32 = 3;

    fn window(gesture: Gesture) -> CommandHeader {
        CommandHeader { gesture: gesture.paper_number().unwrap(), voted: REST, ..CommandHeader::default() }
    }

    fn rested(mut latch: Latch) -> Latch {
        (0..REST_WINDOWS).for_each(|_| _ = latch.admits(&window(Gesture::REST)));
        latch
    }

    #[test]
    fn nothing_moves_at_the_start_before_a_rest() {
        let mut latch = Latch::new(REST_WINDOWS, false);
        let damaged = WindowContext { replaced_samples: 1, ..WindowContext::default() };
        for _ in 0..10 {
            assert!(!latch.admits(&window(Gesture::FLEXION)));
            assert!(!latch.admits(&CommandHeader { context: damaged, ..window(Gesture::REST) }));
            assert!(!latch.admits(&CommandHeader { gesture: 77, ..window(Gesture::REST) }));
            assert!(!latch.admits(&CommandHeader { is_unsure: 1, ..window(Gesture::REST) }));
            assert!(!latch.admits(&window(Gesture::REST)), "one window alone is no rest");
        }
        let mut latch = rested(latch);
        assert!(latch.admits(&window(Gesture::FLEXION)));
    }

    #[test]
    fn what_is_seen_before_the_calibration_is_over_is_no_rest() {
        let seen = |activity: Activity| CommandHeader {
            context: WindowContext { activity: activity as u8, ..WindowContext::default() },
            ..window(Gesture::REST)
        };
        let mut latch = Latch::new(REST_WINDOWS, true);
        assert!((0..10).all(|_| !latch.admits(&seen(Activity::Calibrating))));
        assert_eq!(
            (0..3).map(|_| latch.admits(&seen(Activity::Rest))).collect::<Vec<_>>(),
            [false, false, true]
        );
        latch.arm();
        assert!((0..10).all(|_| !latch.admits(&seen(Activity::Calibrating))), "it is calibrated anew");
    }

    #[test]
    fn an_interruption_ends_with_a_rest() {
        let mut latch = rested(Latch::new(REST_WINDOWS, false));
        latch.interrupt(StopReason::NoCommands);
        assert_eq!(latch.reason(), Some(Stop::because(StopReason::NoCommands)));
        assert!(!latch.admits(&window(Gesture::FLEXION)));
        let mut latch = rested(latch);
        assert!(latch.admits(&window(Gesture::FLEXION)));
        assert_eq!(latch.reason(), None);
    }

    #[test]
    fn a_stop_ends_with_an_arm_order_and_a_rest_only() {
        let mut latch = rested(Latch::new(REST_WINDOWS, false));
        latch.stop(Stop::because(StopReason::NotReady));
        let fault = Stop::by_fault(31);
        latch.stop(fault);
        latch.stop(Stop::because(StopReason::Ordered));
        latch.interrupt(StopReason::NoCommands);
        assert_eq!(latch.reason(), Some(fault), "the first reason that says what is wrong stays");
        let mut latch = rested(latch);
        assert!(!latch.admits(&window(Gesture::REST)) && !latch.admits(&window(Gesture::FLEXION)));
        latch.arm();
        assert!(!latch.admits(&window(Gesture::FLEXION)));
        assert!(rested(latch).admits(&window(Gesture::FLEXION)));
    }
}
