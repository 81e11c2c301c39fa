//! Evidence summed over windows, for a recogniser that is calibrated to a person.
//!
//! ```text
//! held     rest ──────▶ gesture ──────▶ another gesture        what is believed; it outlives moments of doubt
//!               enter           swap         │
//!            ◀───────────── best is rest ────┘
//!
//! output   what is held, if it is clear (stay) and like the calibration; else unsure, which holds the arm still
//! ```
//!
//! Evidence is the mean of the logarithms of the posteriors, in which older windows count less and less. A vote takes
//! several windows to change its mind; here, one clear window outweighs several unclear ones. The lead of a gesture is its
//! evidence less that of the best other one. The rule and its numbers are in docs/decisions/evidence.md.

use serde::{Deserialize, Serialize};

use crate::settings::InvalidDecisionSetting;
use crate::{Evidence, Gesture, GestureSet};

/// Smallest probability that counts: a single window must not rule out a gesture for long.
const SMALLEST_PROBABILITY: f64 = 1e-4;
/// No gesture begins with less effort than this: it is rest that looks like a gesture.
const SMALLEST_EFFORT: f32 = 0.05;

/// When a gesture is clear enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceSettings {
    /// A window counts 1/e times as much after so long, ms.
    pub memory_ms: f64,
    /// Lead with which a gesture begins from rest: 0.6 is odds of 1.8 to 1.
    pub enter_lead: f64,
    /// Lead with which it takes the place of another gesture: 1.0 is odds of 2.7 to 1.
    pub swap_lead: f64,
    /// Lead below which it is not clear, and the arm holds still: 0.25 is odds of 1.3 to 1.
    pub stay_lead: f64,
    /// A gesture of the gripper or the mode acts once it has been made so long, ms.
    pub hold_ms: f64,
    /// It acts again once rest or another gesture was made so long, ms.
    pub release_ms: f64,
}

impl Default for EvidenceSettings {
    fn default() -> EvidenceSettings {
        EvidenceSettings {
            memory_ms: 15.0,
            enter_lead: 0.6,
            swap_lead: 1.0,
            stay_lead: 0.25,
            hold_ms: 300.0,
            release_ms: 200.0,
        }
    }
}

impl EvidenceSettings {
    pub(crate) fn check(&self) -> Result<(), InvalidDecisionSetting> {
        let EvidenceSettings { memory_ms, enter_lead, swap_lead, stay_lead, hold_ms, release_ms } = *self;
        let is_lead = |lead: f64| (0.0..=9.0).contains(&lead);
        let is_duration = |ms: f64| (0.0..=10_000.0).contains(&ms);
        let fields = [
            ("evidence.memory_ms", memory_ms, (1.0..=10_000.0).contains(&memory_ms), "take 1 to 10000 ms"),
            ("evidence.enter_lead", enter_lead, is_lead(enter_lead), "take 0 to 9"),
            ("evidence.swap_lead", swap_lead, is_lead(swap_lead), "take 0 to 9"),
            (
                "evidence.stay_lead",
                stay_lead,
                (0.0..=enter_lead.min(swap_lead)).contains(&stay_lead),
                "take 0 to enter_lead and swap_lead: a gesture is kept more easily than it is begun",
            ),
            ("evidence.hold_ms", hold_ms, is_duration(hold_ms), "take 0 to 10000 ms"),
            ("evidence.release_ms", release_ms, is_duration(release_ms), "take 0 to 10000 ms"),
        ];
        match fields.into_iter().find(|(_, _, fits, _)| !fits) {
            Some((setting, value, _, remedy)) => {
                Err(InvalidDecisionSetting::Number { setting, value, remedy })
            }
            None => Ok(()),
        }
    }
}

/// What is made, as far as it is clear.
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
    held: Gesture,
}

impl Believer {
    /// At rest, without evidence.
    pub(crate) fn new(settings: EvidenceSettings) -> Believer {
        Believer { settings, evidence: [0.0; GestureSet::MAXIMUM], before_ns: None, held: Gesture::REST }
    }

    /// Takes a window whose probabilities are all finite.
    pub(crate) fn take(&mut self, gestures: &GestureSet, window: &Evidence<'_>) -> Belief {
        let Evidence { probabilities, efforts, novelty, captured_ns, .. } = *window;
        self.add(probabilities, captured_ns);
        let EvidenceSettings { enter_lead, swap_lead, stay_lead, .. } = self.settings;
        let count = probabilities.len().min(gestures.len());
        let number = (0..count).max_by(|a, b| self.evidence[*a].total_cmp(&self.evidence[*b])).unwrap_or(0);
        let best = gestures.get(number as u8).unwrap_or(Gesture::REST);
        // NaN, too, is unlike the calibration.
        let is_known = novelty <= 1.0;
        let has_effort = efforts.get(number).is_some_and(|effort| *effort >= SMALLEST_EFFORT);
        let needed = if self.held == Gesture::REST { enter_lead } else { swap_lead };
        if best == Gesture::REST || (is_known && has_effort && self.lead(gestures, best) >= needed) {
            self.held = best;
        }
        let is_clear = match self.held {
            // What is no rest of the calibration, such as a loose electrode, may hide a contraction.
            Gesture::REST => is_known && best == Gesture::REST,
            held => is_known && self.lead(gestures, held) >= stay_lead,
        };
        if is_clear { Belief::Clear(self.held) } else { Belief::Unsure }
    }

    fn add(&mut self, probabilities: &[f32], captured_ns: u64) {
        let before_ns = self.before_ns.replace(captured_ns);
        let elapsed_ns = before_ns.map(|before_ns| captured_ns.saturating_sub(before_ns));
        let kept =
            elapsed_ns.map_or(0.0, |elapsed_ns| (elapsed_ns as f64 * -1e-6 / self.settings.memory_ms).exp());
        for (evidence, probability) in self.evidence.iter_mut().zip(probabilities) {
            let new = f64::from(*probability).max(SMALLEST_PROBABILITY).ln();
            *evidence = kept * *evidence + (1.0 - kept) * new;
        }
    }

    /// How clear a gesture is: its evidence less that of the best other one.
    pub(crate) fn lead(&self, gestures: &GestureSet, gesture: Gesture) -> f64 {
        let count = gestures.len();
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

    fn evidence(probabilities: &[f32; 6], novelty: f32, window: usize) -> Evidence<'_> {
        let captured_ns = window as u64 * INCREMENT_NS;
        Evidence { probabilities, efforts: &[1.0; 6], novelty, moving: false, intact: true, captured_ns }
    }

    /// What is believed after each of these windows.
    fn beliefs(believer: &mut Believer, windows: &[([f32; 6], f32)]) -> Vec<Belief> {
        let gestures = GestureSet::default();
        let take = |(window, (posterior, novelty)): (usize, &([f32; 6], f32))| {
            believer.take(&gestures, &evidence(posterior, *novelty, window))
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
        // Odds of 1.5 to 1: less than those of entering, more than those of staying.
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

    #[test]
    fn no_gesture_begins_without_effort_but_it_stays_through_a_weak_window() {
        let (gestures, grip) = (GestureSet::default(), posterior(Gesture::GRIP, 0.99));
        let mut believer = Believer::new(EvidenceSettings::default());
        let weak =
            |window| Evidence { efforts: &[0.0, 0.0, 0.0, 0.0, 0.0, 0.04], ..evidence(&grip, 0.5, window) };
        assert_eq!(believer.take(&gestures, &weak(0)), Belief::Unsure);
        assert_eq!(believer.take(&gestures, &evidence(&grip, 0.5, 1)), Belief::Clear(Gesture::GRIP));
        assert_eq!(believer.take(&gestures, &weak(2)), Belief::Clear(Gesture::GRIP));
    }

    #[test]
    fn a_gesture_outlives_doubt_and_another_needs_a_larger_lead() {
        let mut believer = Believer::new(EvidenceSettings::default());
        let mut doubtful = [0.0; 6];
        (doubtful[5], doubtful[3]) = (0.5, 0.5);
        let mut leading = [0.0; 6];
        // Odds of 2.3 to 1: they begin a gesture, but take no other's place.
        (leading[3], leading[5]) = (0.7, 0.3);
        let windows =
            [(posterior(Gesture::GRIP, 0.95), 0.5), (doubtful, 0.5), (doubtful, 0.5), (doubtful, 0.5)];
        let believed = beliefs(&mut believer, &windows);
        assert_eq!((believed[0], believed[3]), (Belief::Clear(Gesture::GRIP), Belief::Unsure));
        assert_eq!(beliefs(&mut believer, &[(leading, 0.5); 6])[5], Belief::Unsure);
        assert_eq!(
            beliefs(&mut Believer::new(EvidenceSettings::default()), &[(leading, 0.5)])[0],
            Belief::Clear(Gesture::ULNAR)
        );
        let back = beliefs(&mut believer, &[(posterior(Gesture::GRIP, 0.5), 0.5); 3]);
        assert_eq!(back[2], Belief::Clear(Gesture::GRIP));
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
                let before = believer.held;
                let belief = believer.take(&gestures, &evidence(&posterior, novelty, window));
                let Belief::Clear(gesture) = belief else { continue };
                let lead = believer.lead(&gestures, gesture);
                prop_assert!(novelty <= 1.0);
                let needed = match (gesture, before) {
                    (Gesture::REST, _) => 0.0,
                    (gesture, before) if gesture == before => settings.stay_lead,
                    (_, Gesture::REST) => settings.enter_lead,
                    (_, _) => settings.swap_lead,
                };
                prop_assert!(lead >= needed, "{gesture}: {lead}");
            }
        }
    }
}
