//! Stops of the arm, for the live line and for what the report keeps.

use tendon_messages::{Permission, StateHeader, StopReason};
use tendon_xarm::{Fault, Source};

/// Why the arm may not move and what to do, in words; `None` where there is nothing to say.
pub fn stop_words(header: &StateHeader) -> Option<String> {
    let fault = Fault::new(Source::Controller, header.fault_code).map(|fault| fault.to_string());
    fault.or_else(|| match StopReason::from_number(header.stop_reason)? {
        StopReason::StartIsFar => Some(format!(
            "the start position is {:.0} mm away: look around, then `tendon arm` or key a sends the arm there",
            header.start_distance_mm
        )),
        reason => Some(reason.to_string()),
    })
}

/// Whether the arm may not move because of how it was found at the start.
pub fn is_found_waiting(header: &StateHeader) -> bool {
    header.fault_code == 0
        && StopReason::from_number(header.stop_reason).is_some_and(StopReason::is_how_found)
}

/// Notices each stop of the arm, in its states one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ArmStops {
    /// Reason and error code, while the arm is stopped.
    seen: Option<(u8, u8)>,
}

impl ArmStops {
    /// A stop in words, if this state is the first that shows it. That the end of a stage stopped the arm, the note on
    /// that stage says.
    pub fn look(&mut self, header: &StateHeader) -> Option<String> {
        let is_stopped = Permission::from_number(header.permission) == Permission::Stopped;
        let now = is_stopped.then_some((header.stop_reason, header.fault_code));
        let before = std::mem::replace(&mut self.seen, now);
        if now.is_none() || now == before || header.stop_reason == StopReason::StageEnded.number() {
            return None;
        }
        let words = stop_words(header)?;
        let verb = if is_found_waiting(header) { "waits" } else { "is stopped" };
        Some(format!("the arm {verb}: {words}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stop_is_noticed_once_with_its_reason() {
        let mut stops = ArmStops::default();
        let mut look = |permission: Permission, stop_reason: u8, fault_code: u8| {
            let permission = permission.number();
            stops.look(&StateHeader { permission, stop_reason, fault_code, ..StateHeader::default() })
        };
        let [found, ordered, fault, ended] =
            [StopReason::UsedSince, StopReason::Ordered, StopReason::ArmFault, StopReason::StageEnded]
                .map(StopReason::number);
        assert!(look(Permission::Stopped, found, 0).unwrap().starts_with("the arm waits: another session"));
        assert_eq!(look(Permission::Stopped, found, 0), None);
        // It is brought up, and follows.
        assert_eq!(look(Permission::Stopped, 0, 0), None);
        assert_eq!(look(Permission::Granted, 0, 0), None);
        assert_eq!(look(Permission::Stopped, ordered, 0).unwrap(), "the arm is stopped: stopped by order");
        assert_eq!(look(Permission::Stopped, ordered, 0), None);
        assert!(
            look(Permission::Stopped, fault, 31).unwrap().starts_with("the arm is stopped: arm error 31")
        );
        assert_eq!(look(Permission::AwaitRest, 0, 0), None);
        assert!(look(Permission::Stopped, fault, 31).is_some(), "again");
        assert_eq!(look(Permission::AwaitRest, StopReason::NoCommands.number(), 0), None, "no stop");
        assert_eq!(look(Permission::Stopped, ended, 0), None);
        let stop_reason = StopReason::StartIsFar.number();
        let far = StateHeader { stop_reason, start_distance_mm: 199.7, ..StateHeader::default() };
        assert!(stop_words(&far).unwrap().starts_with("the start position is 200 mm away: look around"));
    }
}
