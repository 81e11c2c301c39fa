//! Gathers what a strategy did on continuous recordings (paper section "Real-Time Muscle Activation Detection
//! Strategies"): every window in turn, rest and change-overs among them, against what the person was asked to do.
//!
//! ```text
//! cue       |········ rest ·········|··········· grip ···········|······ nothing ······|
//! gesture   .   ═══════════════════ .      ══════════════════════ .                    .  windows of the paper's table
//! response  .                       .       ═════════════════════ .                    .  windows after the onset
//! rest      .   ═══════════════════ .                             .<fall time>═════════.  windows of rest
//! ```
//! Windows of rest that calibrated something are counted nowhere.

use std::collections::BTreeMap;

use tendon_gesture::Gesture;
use tendon_identity::PersonId;

use crate::evaluation::Spread;
use crate::strategy_scores::{GestureWindows, RepetitionScores, StrategyScores, Times};

/// After a movement's cue has ended, the person needs this long to let go, ms. Only then rest begins.
pub const FALL_MS: f64 = 1200.0;

/// What a person was asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// To make one of the session's gestures, or to rest.
    Gesture(Gesture),
    /// To make another movement. Nothing there is scored.
    OtherMovement,
    /// Nothing: the time between two cues, or after the last.
    Nothing,
}

impl Asked {
    fn is_movement(self) -> bool {
        match self {
            Asked::Gesture(gesture) => gesture != Gesture::REST,
            Asked::OtherMovement => true,
            Asked::Nothing => false,
        }
    }
}

/// A part of a recording in which the person was asked for one thing. Samples are counted from the recording's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CuePart {
    /// What was asked for.
    pub asked: Asked,
    /// Whether it is scored; a part that calibrated a recogniser is not.
    pub is_scored: bool,
    /// First sample of the cue.
    pub start: u64,
    /// From here on windows show the gesture; `None` if unknown.
    pub begun: Option<u64>,
    /// Where the movement begins, if an onset was found.
    pub onset: Option<u64>,
    /// End of the cue, exclusive.
    pub end: u64,
}

impl CuePart {
    /// The gesture, where it is one that is scored.
    fn gesture(&self) -> Option<Gesture> {
        match self.asked {
            Asked::Gesture(gesture) if self.is_scored => Some(gesture),
            _ => None,
        }
    }

    /// Whether the window's newest sample lies in it.
    fn has_newest_of(&self, step: &Step) -> bool {
        (self.start + 1..=self.end).contains(&step.end_sample)
    }
}

/// What a strategy made of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The window's first sample.
    pub first_sample: u64,
    /// Its end, exclusive.
    pub end_sample: u64,
    /// Whether a part of it calibrated the activity detector.
    pub calibrates: bool,
    /// The gesture recognised, before the vote.
    pub gesture: Gesture,
    /// The gesture acted on: what the arm was told. Rest where the strategy was unsure.
    pub told: Gesture,
    /// Whether the arm was told to move or turn.
    pub moves: bool,
    /// How fast it was told to move, mm/s.
    pub speed_mm_per_s: f64,
    /// Whether the gripper was told to open or close.
    pub toggles_gripper: bool,
    /// Time from the window's newest sample to the command, as far as it was computing, ns.
    pub work_ns: u64,
}

/// Gathers what a strategy did, recording by recording.
#[derive(Clone, Debug)]
pub struct StrategyTally {
    sample_rate_hz: f64,
    increment_samples: usize,
    gripper_gestures: Vec<Gesture>,
    per_gesture: BTreeMap<Gesture, GestureWindows>,
    per_repetition: Vec<RepetitionScores>,
    mistaken: BTreeMap<Gesture, BTreeMap<Gesture, u64>>,
    /// Windows whose newest sample lies in a scored cue.
    windows: u64,
    /// Those in which the gripper must not move.
    windows_without_grip: u64,
    false_activations: u64,
    grips: u64,
    grips_answered: u64,
    direction_changes: u64,
    answered_ms: Vec<f64>,
    never_answered: u64,
    without_onset: u64,
    response: Response,
    rest: Rest,
    wrong_motion_mm: f64,
    window_start_to_command_ms: Vec<f64>,
}

/// Windows after the onsets of movements.
#[derive(Clone, Copy, Debug, Default)]
struct Response {
    windows: u64,
    correct: u64,
    wrong_gesture: u64,
    wrong_direction: u64,
}

/// Windows of rest.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    windows: u64,
    taken_for_movement: u64,
    /// Times a movement was told after a window in which none was.
    activations: u64,
}

impl StrategyTally {
    /// Nothing yet. Samples are at this rate, a window begins this many samples after the one before it, and these
    /// gestures open and close the gripper.
    pub fn new(
        sample_rate_hz: f64,
        increment_samples: usize,
        gripper_gestures: Vec<Gesture>,
    ) -> StrategyTally {
        StrategyTally {
            sample_rate_hz,
            increment_samples,
            gripper_gestures,
            per_gesture: BTreeMap::new(),
            per_repetition: Vec::new(),
            mistaken: BTreeMap::new(),
            windows: 0,
            windows_without_grip: 0,
            false_activations: 0,
            grips: 0,
            grips_answered: 0,
            direction_changes: 0,
            answered_ms: Vec::new(),
            never_answered: 0,
            without_onset: 0,
            response: Response::default(),
            rest: Rest::default(),
            wrong_motion_mm: 0.0,
            window_start_to_command_ms: Vec::new(),
        }
    }

    /// Takes a recording: its cues and what the strategy made of every window, both in their order.
    pub fn add(
        &mut self,
        person: PersonId,
        session: &str,
        repetition: u32,
        cues: &[CuePart],
        steps: &[Step],
    ) {
        for step in steps {
            let samples = step.end_sample - step.first_sample;
            self.window_start_to_command_ms.push(self.ms(samples) + step.work_ns as f64 * 1e-6);
        }
        let mut here: BTreeMap<Gesture, GestureWindows> = BTreeMap::new();
        for (index, cue) in cues.iter().enumerate() {
            self.add_rest(&cues[..=index], steps, &mut here);
            let Some(gesture) = cue.gesture() else { continue };
            self.add_gripper(cue, gesture, cues, steps);
            if gesture != Gesture::REST {
                self.add_response(cue, gesture, steps);
                self.add_windows(cue, gesture, steps, &mut here);
            }
        }
        self.per_repetition.push(RepetitionScores {
            person,
            session: session.to_owned(),
            repetition,
            correct_percent: here
                .into_iter()
                .map(|(gesture, windows)| (gesture.name().to_owned(), windows.correct_percent))
                .collect(),
        });
    }

    /// Whether the gripper moved where it should, and where it should not.
    fn add_gripper(&mut self, cue: &CuePart, gesture: Gesture, cues: &[CuePart], steps: &[Step]) {
        let inside = steps.iter().filter(|step| cue.has_newest_of(step) && !step.calibrates);
        let windows = inside.clone().count() as u64;
        self.windows += windows;
        if self.gripper_gestures.contains(&gesture) {
            self.grips += 1;
            self.grips_answered += u64::from(inside.clone().any(|step| step.toggles_gripper));
        } else {
            self.windows_without_grip += windows;
            self.false_activations += inside.filter(|step| self.is_false_toggle(step, cues)).count() as u64;
        }
    }

    /// How a movement was answered from its onset on.
    fn add_response(&mut self, cue: &CuePart, gesture: Gesture, steps: &[Step]) {
        let Some(onset) = cue.onset else {
            self.without_onset += 1;
            return;
        };
        let after_onset = |step: &&Step| step.end_sample > onset && step.end_sample <= cue.end;
        let mut answer = None;
        for step in steps.iter().filter(after_onset) {
            let is_correct = step.told == gesture;
            let is_wrong_gesture = !is_correct && step.told != Gesture::REST;
            self.response.windows += 1;
            self.response.correct += u64::from(is_correct);
            self.response.wrong_gesture += u64::from(is_wrong_gesture);
            if is_wrong_gesture && step.moves {
                self.response.wrong_direction += 1;
                self.wrong_motion_mm += step.speed_mm_per_s * self.increment_s();
            }
            if is_correct && answer.is_none() {
                answer = Some(self.ms(step.end_sample - onset) + step.work_ns as f64 * 1e-6);
            }
        }
        match answer {
            Some(answer_ms) => self.answered_ms.push(answer_ms),
            None => self.never_answered += 1,
        }
    }

    /// Scores the windows of a movement that show its gesture; `here` counts those of the recording.
    fn add_windows(
        &mut self,
        cue: &CuePart,
        gesture: Gesture,
        steps: &[Step],
        here: &mut BTreeMap<Gesture, GestureWindows>,
    ) {
        let Some(begun) = cue.begun else { return };
        let inside = |step: &&Step| step.first_sample >= begun && step.end_sample <= cue.end;
        let mut direction = Direction::default();
        for step in steps.iter().filter(inside) {
            self.add_window(gesture, step, here);
            self.direction_changes += u64::from(direction.changes_with(step));
        }
    }

    /// Scores the windows of rest in the last of `cues`, if there is rest.
    fn add_rest(&mut self, cues: &[CuePart], steps: &[Step], here: &mut BTreeMap<Gesture, GestureWindows>) {
        let Some((start, end)) = self.rest_in_last(cues) else { return };
        let mut direction = Direction::default();
        let mut told_before = None;
        for step in steps {
            let is_inside = step.first_sample >= start && step.end_sample <= end && !step.calibrates;
            let is_movement = step.told != Gesture::REST;
            let begins = is_movement && told_before == Some(Gesture::REST);
            told_before = Some(step.told);
            if !is_inside {
                continue;
            }
            self.rest.windows += 1;
            self.rest.taken_for_movement += u64::from(is_movement);
            self.rest.activations += u64::from(begins);
            self.wrong_motion_mm += step.speed_mm_per_s * self.increment_s();
            self.add_window(Gesture::REST, step, here);
            if cues.last().is_some_and(|cue| cue.asked == Asked::Nothing) {
                self.windows += 1;
                self.windows_without_grip += 1;
                self.false_activations += u64::from(self.is_false_toggle(step, cues));
            }
            self.direction_changes += u64::from(direction.changes_with(step));
        }
    }

    /// First sample and end of the rest in the last of `cues`: a cue to rest, or nothing asked after a movement.
    fn rest_in_last(&self, cues: &[CuePart]) -> Option<(u64, u64)> {
        let (last, before) = cues.split_last()?;
        let fall_samples = (FALL_MS * 1e-3 * self.sample_rate_hz).round() as u64;
        let let_go = before.last().filter(|cue| cue.asked.is_movement()).map(|cue| cue.end + fall_samples);
        let start = match last.asked {
            Asked::Gesture(Gesture::REST) => last.begun?.max(let_go.unwrap_or(0)),
            Asked::Nothing => let_go?,
            _ => return None,
        };
        last.is_scored.then_some((start, last.end))
    }

    /// Counts a window for the paper's table.
    fn add_window(&mut self, truth: Gesture, step: &Step, here: &mut BTreeMap<Gesture, GestureWindows>) {
        for scores in [&mut self.per_gesture, here] {
            scores.entry(truth).or_default().add(truth, step.gesture);
        }
        if step.gesture != truth {
            *self.mistaken.entry(truth).or_default().entry(step.gesture).or_default() += 1;
        }
    }

    /// The scores so far.
    pub fn scores(&self) -> StrategyScores {
        let minutes = |windows: u64| windows as f64 * self.increment_s() / 60.0;
        let per_minute = |count: f64, windows: u64| (windows > 0).then(|| count / minutes(windows));
        let share = |part: u64, whole: u64| (whole > 0).then(|| part as f64 / whole as f64);
        let by_name = |gesture: &Gesture| gesture.name().to_owned();
        let shares: Vec<f64> = self.per_gesture.values().map(|windows| windows.correct_percent).collect();
        let Response { windows: responding, correct, wrong_gesture, wrong_direction } = self.response;
        let Rest { windows: resting, taken_for_movement, activations } = self.rest;
        let is_answered_scored = !self.answered_ms.is_empty() || self.never_answered > 0;
        StrategyScores {
            repetitions: self.per_repetition.len() as u64,
            scored_s: self.windows as f64 * self.increment_s(),
            rest_scored_s: resting as f64 * self.increment_s(),
            per_gesture: self
                .per_gesture
                .iter()
                .map(|(gesture, windows)| (by_name(gesture), *windows))
                .collect(),
            mean_correct_percent: (!shares.is_empty()).then(|| Spread::of(&shares).mean),
            per_repetition: self.per_repetition.clone(),
            mistaken: self
                .mistaken
                .iter()
                .map(|(truth, taken)| {
                    (by_name(truth), taken.iter().map(|(taken, count)| (by_name(taken), *count)).collect())
                })
                .collect(),
            correct_share: share(correct, responding),
            wrong_gesture_share: share(wrong_gesture, responding),
            wrong_direction_share: share(wrong_direction, responding),
            rest_taken_for_movement_share: share(taken_for_movement, resting),
            rest_false_activations_per_min: per_minute(activations as f64, resting),
            wrong_motion_mm_per_min: per_minute(self.wrong_motion_mm, responding + resting),
            gripper_false_activations_per_min: per_minute(
                self.false_activations as f64,
                self.windows_without_grip,
            ),
            grips_answered_percent: share(self.grips_answered, self.grips).map(|share| 100.0 * share),
            direction_changes_per_min: per_minute(self.direction_changes as f64, self.windows),
            onset_to_first_correct_command_ms: Times::of(self.answered_ms.clone()),
            never_answered: is_answered_scored.then_some(self.never_answered),
            movements_without_onset: self.without_onset,
            window_start_to_command_ms: Times::of(self.window_start_to_command_ms.clone()),
        }
    }

    /// Whether the gripper moves though the window shows no gesture of the gripper that was asked for.
    fn is_false_toggle(&self, step: &Step, cues: &[CuePart]) -> bool {
        let is_shown = |cue: &CuePart| step.first_sample < cue.end && step.end_sample > cue.start;
        let is_asked = |cue: &CuePart| match cue.asked {
            Asked::Gesture(gesture) => self.gripper_gestures.contains(&gesture),
            _ => false,
        };
        step.toggles_gripper && !cues.iter().any(|cue| is_asked(cue) && is_shown(cue))
    }

    fn ms(&self, samples: u64) -> f64 {
        samples as f64 * 1e3 / self.sample_rate_hz
    }

    /// Time from one window to the next, s.
    fn increment_s(&self) -> f64 {
        self.increment_samples as f64 / self.sample_rate_hz
    }
}

/// Where the arm was last sent, while one thing is asked for.
#[derive(Default)]
struct Direction(Option<Gesture>);

impl Direction {
    /// Whether this command sends the arm from one direction into another.
    fn changes_with(&mut self, step: &Step) -> bool {
        let now = step.moves.then_some(step.told);
        let before = std::mem::replace(&mut self.0, now);
        before.is_some() && now.is_some() && before != now
    }
}

#[cfg(test)]
mod tests;
