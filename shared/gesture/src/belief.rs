//! Evidence summed over windows, for a recogniser that is calibrated to a person.
//!
//! ```text
//!            is a gesture clear?                  lead: evidence of the best gesture less that of the next
//! rest ◀──▶ unsure ◀──▶ gesture ──▶ another       a gesture is entered with a larger lead than it is held with
//!  └───────────────────────▲
//! ```
//!
//! Evidence is the mean of the logarithms of the posteriors, in which older windows count less and less. A vote would take
//! several windows to change its mind; a clear window outweighs unclear ones here. A gesture is never left for another
//! without a clear lead of that one. Whatever is not clear holds the arm still.

use serde::{Deserialize, Serialize};

use crate::settings::InvalidDecisionSetting;
use crate::{Gesture, GestureSet};

/// Smallest probability that counts: a single window must not rule out a gesture for long.
const SMALLEST_PROBABILITY: f64 = 1e-4;

/// When a gesture is clear enough. Found on continuous recordings of fifteen people: docs/decisions/evidence.md.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceSettings {
    /// A window counts 1/e times as much after so long, ms.
    pub memory_ms: f64,
    /// Lead with which a gesture begins: 0.7 is odds of 2 to 1.
    pub enter_lead: f64,
    /// Lead below which it is no longer clear, and the arm holds still.
    pub stay_lead: f64,
    /// A gesture of the gripper or the mode acts once it has been held so long, and again once it was let go for as long, ms.
    pub hold_ms: f64,
}

impl Default for EvidenceSettings {
    fn default() -> EvidenceSettings {
        EvidenceSettings { memory_ms: 36.0, enter_lead: 0.7, stay_lead: 0.2, hold_ms: 300.0 }
    }
}

impl EvidenceSettings {
    pub(crate) fn check(&self) -> Result<(), InvalidDecisionSetting> {
        let EvidenceSettings { memory_ms, enter_lead, stay_lead, hold_ms } = *self;
        let fields = [
            ("evidence.memory_ms", memory_ms, (1.0..=10_000.0).contains(&memory_ms), "take 1 to 10000 ms"),
            ("evidence.enter_lead", enter_lead, (0.0..=9.0).contains(&enter_lead), "take 0 to 9"),
            (
                "evidence.stay_lead",
                stay_lead,
                (0.0..=enter_lead).contains(&stay_lead),
                "take 0 to enter_lead: staying in a gesture is no harder than entering it",
            ),
            ("evidence.hold_ms", hold_ms, (0.0..=10_000.0).contains(&hold_ms), "take 0 to 10000 ms"),
        ];
        match fields.into_iter().find(|(_, _, fits, _)| !fits) {
            Some((setting, value, _, remedy)) => {
                Err(InvalidDecisionSetting::Number { setting, value, remedy })
            }
            None => Ok(()),
        }
    }
}

/// What is believed to be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Belief {
    /// This gesture, or rest.
    Clear(Gesture),
    /// It is not clear.
    Unsure,
}

/// Sums evidence from window to window. Allocates nothing.
#[derive(Clone, Debug)]
pub(crate) struct Believer {
    settings: EvidenceSettings,
    /// By class number; of the first gestures, as many as the session has.
    evidence: [f64; GestureSet::MAXIMUM],
    /// When the last window was captured; `None` before the first.
    before_ns: Option<u64>,
    belief: Belief,
}

impl Believer {
    /// At rest, without evidence.
    pub(crate) fn new(settings: EvidenceSettings) -> Believer {
        Believer {
            settings,
            evidence: [0.0; GestureSet::MAXIMUM],
            before_ns: None,
            belief: Belief::Clear(Gesture::REST),
        }
    }

    /// Takes the posterior of a window, by class number, all finite. `novelty` above 1 is no gesture of the calibration.
    pub(crate) fn take(
        &mut self,
        gestures: &GestureSet,
        probabilities: &[f32],
        novelty: f32,
        captured_ns: u64,
    ) -> Belief {
        let elapsed_ns = self.before_ns.replace(captured_ns).map(|before| captured_ns.saturating_sub(before));
        let kept = elapsed_ns
            .map_or(0.0, |elapsed_ns| (-(elapsed_ns as f64) * 1e-6 / self.settings.memory_ms).exp());
        for (evidence, probability) in self.evidence.iter_mut().zip(probabilities) {
            let new = f64::from(*probability).max(SMALLEST_PROBABILITY).ln();
            *evidence = kept * *evidence + (1.0 - kept) * new;
        }
        let count = probabilities.len().min(gestures.len());
        let best = (0..count).max_by(|a, b| self.evidence[*a].total_cmp(&self.evidence[*b])).unwrap_or(0);
        let best = gestures.get(best as u8).unwrap_or(Gesture::REST);
        let is_known = novelty <= 1.0;
        if let Belief::Clear(gesture) = self.belief {
            let is_clear = is_known && self.lead(gestures, count, gesture) >= self.settings.stay_lead;
            if gesture != Gesture::REST && !is_clear {
                self.belief = Belief::Unsure;
            }
        }
        let is_entered = is_known && self.lead(gestures, count, best) >= self.settings.enter_lead;
        self.belief = match self.belief {
            Belief::Clear(gesture) if gesture == best => self.belief,
            _ if best != Gesture::REST && is_entered => Belief::Clear(best),
            Belief::Clear(gesture) if gesture != Gesture::REST => self.belief,
            _ if best == Gesture::REST => Belief::Clear(Gesture::REST),
            _ => Belief::Unsure,
        };
        self.belief
    }

    /// Evidence of a gesture less that of the best other one.
    fn lead(&self, gestures: &GestureSet, count: usize, gesture: Gesture) -> f64 {
        let number = gestures.number(gesture).map_or(0, usize::from);
        let others = self.evidence[..count].iter().enumerate().filter(|(other, _)| *other != number);
        let best_other = others.map(|(_, evidence)| *evidence).fold(f64::NEG_INFINITY, f64::max);
        self.evidence[number] - best_other
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::{prop, prop_assert, proptest};

    use super::*;

    const INCREMENT_NS: u64 = 25_000_000;

    /// The rest of the probability is shared among the others.
    fn posterior(gesture: Gesture, probability: f32) -> [f32; 6] {
        let mut posterior = [(1.0 - probability) / 5.0; 6];
        posterior[usize::from(gesture.paper_number().unwrap())] = probability;
        posterior
    }

    /// What is believed after each of these windows.
    fn beliefs(believer: &mut Believer, windows: &[([f32; 6], f32)]) -> Vec<Belief> {
        let gestures = GestureSet::default();
        let take = |(window, (posterior, novelty)): (usize, &([f32; 6], f32))| {
            believer.take(&gestures, posterior, *novelty, window as u64 * INCREMENT_NS)
        };
        windows.iter().enumerate().map(take).collect()
    }

    #[test]
    fn a_clear_window_is_believed_at_once_and_so_is_the_rest_after_it() {
        let mut believer = Believer::new(EvidenceSettings::default());
        let windows =
            [Gesture::REST, Gesture::GRIP, Gesture::GRIP, Gesture::REST, Gesture::REST, Gesture::REST];
        let believed = beliefs(&mut believer, &windows.map(|gesture| (posterior(gesture, 0.95), 0.5)));
        assert_eq!(believed[0], Belief::Clear(Gesture::REST));
        assert_eq!(believed[2], Belief::Clear(Gesture::GRIP));
        assert_eq!(believed[5], Belief::Clear(Gesture::REST));
    }

    #[test]
    fn what_is_not_clear_enters_no_gesture_but_stays_in_one() {
        // Odds of 1.5 to 1: less than the 2 to 1 of entering, more than the 1.2 to 1 of staying.
        let mut unclear = [0.0; 6];
        (unclear[5], unclear[0]) = (0.6, 0.4);
        let mut believer = Believer::new(EvidenceSettings::default());
        let from_rest = beliefs(&mut believer, &[(unclear, 0.5); 8]);
        assert!(from_rest.iter().all(|belief| *belief == Belief::Unsure), "{from_rest:?}");
        let mut believer = Believer::new(EvidenceSettings::default());
        let mut windows = vec![(posterior(Gesture::GRIP, 0.95), 0.5); 2];
        windows.extend([(unclear, 0.5); 8]);
        assert!(
            beliefs(&mut believer, &windows).iter().all(|belief| *belief == Belief::Clear(Gesture::GRIP))
        );
    }

    #[test]
    fn what_is_unlike_the_calibration_moves_nothing() {
        let mut believer = Believer::new(EvidenceSettings::default());
        let grip = posterior(Gesture::GRIP, 0.99);
        let believed = beliefs(&mut believer, &[(grip, 1.1), (grip, 0.9), (grip, f32::NAN)]);
        assert_eq!(believed, [Belief::Unsure, Belief::Clear(Gesture::GRIP), Belief::Unsure]);
    }

    proptest! {
        #[test]
        fn only_what_leads_and_is_like_the_calibration_is_believed(
            windows in prop::collection::vec((prop::array::uniform6(0.0_f32..1.0), 0.0_f32..2.0), 1..60),
        ) {
            let settings = EvidenceSettings::default();
            let gestures = GestureSet::default();
            let mut believer = Believer::new(settings);
            for (window, (posterior, novelty)) in windows.into_iter().enumerate() {
                let before = believer.belief;
                let belief = believer.take(&gestures, &posterior, novelty, window as u64 * INCREMENT_NS);
                let Belief::Clear(gesture) = belief else { continue };
                let lead = believer.lead(&gestures, 6, gesture);
                prop_assert!(gesture == Gesture::REST || novelty <= 1.0);
                let needed = match (gesture, belief == before) {
                    (Gesture::REST, _) => 0.0,
                    (_, true) => settings.stay_lead,
                    (_, false) => settings.enter_lead,
                };
                prop_assert!(lead >= needed, "{gesture}: {lead}");
            }
        }
    }
}
