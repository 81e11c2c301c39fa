//! How well a strategy does on continuous recordings (paper section "Real-Time Muscle Activation Detection
//! Strategies"): every window in turn, rest and change-overs among them, against what the person was asked to do.
//!
//! ```text
//! cue      |········ rest ·········|··········· grip ···········|
//! begun    .   ─────────────────── .      ────────────────────── .   what is scored: from the onset (or, of rest,
//! windows  [──]  [──]  [──]  [──]  [──]  [──]  [──]  [──]            from where it has settled) to the end of the cue
//! ```

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;

use crate::evaluation::Spread;

/// A part of a recording in which the person was asked for one thing. Samples are counted from the recording's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CuePart {
    /// What was asked for; `None` if it is none of the six gestures: nothing there is scored.
    pub gesture: Option<Gesture>,
    /// First sample of the cue.
    pub start: u64,
    /// From here on windows show the gesture; `None` if unknown.
    pub begun: Option<u64>,
    /// Where the movement begins, if an onset was found.
    pub onset: Option<u64>,
    /// End of the cue, exclusive.
    pub end: u64,
}

/// What a strategy made of one window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The window's first sample.
    pub first_sample: u64,
    /// Its end, exclusive.
    pub end_sample: u64,
    /// The gesture recognised, before the vote.
    pub gesture: Gesture,
    /// The gesture acted on, after the vote.
    pub voted: Gesture,
    /// Whether the gripper was told to open or close.
    pub toggles_gripper: bool,
    /// Time from the window's newest sample to the command, as far as it was computing, ns.
    pub work_ns: u64,
}

/// Counts over all windows of one gesture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GestureWindows {
    /// Windows.
    pub windows: u64,
    /// Those taken for a movement of any kind.
    pub moving: u64,
    /// Those taken for what they are.
    pub correct: u64,
    /// Share taken for a movement, in percent: of rest, the false alarms.
    pub moving_percent: f64,
    /// Share taken for what they are, in percent.
    pub correct_percent: f64,
    /// Of those taken for a movement, the share taken for the right one, in percent.
    pub correct_of_moving_percent: f64,
}

impl GestureWindows {
    fn add(&mut self, truth: Gesture, recognised: Gesture) {
        self.windows += 1;
        self.moving += u64::from(recognised != Gesture::REST);
        self.correct += u64::from(recognised == truth);
        let percent =
            |part: u64, whole: u64| if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 };
        self.moving_percent = percent(self.moving, self.windows);
        self.correct_percent = percent(self.correct, self.windows);
        let correct_moving = if truth == Gesture::REST { 0 } else { self.correct };
        self.correct_of_moving_percent = percent(correct_moving, self.moving);
    }
}

/// Shares of correctly recognised windows in one repetition, in percent, by gesture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RepetitionScores {
    /// Number of the person.
    pub person: u16,
    /// `train`, `test`, or whatever the recording's layout calls it.
    pub session: String,
    /// Repetition within the session.
    pub repetition: u32,
    /// By gesture, in percent.
    pub correct_percent: BTreeMap<String, f64>,
}

/// Times in ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// How many.
    pub count: u64,
    /// Mean and standard deviation (of the sample), smallest and largest.
    #[serde(flatten)]
    pub spread: Spread,
    /// Median.
    pub median: f64,
}

impl Times {
    fn of(mut times_ms: Vec<f64>) -> Times {
        times_ms.sort_by(f64::total_cmp);
        let count = times_ms.len();
        let median = match count {
            0 => 0.0,
            _ if count % 2 == 1 => times_ms[count / 2],
            _ => (times_ms[count / 2 - 1] + times_ms[count / 2]) / 2.0,
        };
        Times { count: count as u64, spread: Spread::of(&times_ms), median }
    }
}

/// How well a strategy does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StrategyScores {
    /// Recordings.
    pub repetitions: u64,
    /// Signal in which one of the six gestures was asked for, s.
    pub scored_s: f64,
    /// By gesture.
    pub per_gesture: BTreeMap<String, GestureWindows>,
    /// Mean over the gestures of the share of correct windows, in percent.
    pub mean_correct_percent: f64,
    /// Each repetition.
    pub per_repetition: Vec<RepetitionScores>,
    /// How often each true gesture (first key) was taken for another (second key), in windows.
    pub mistaken: BTreeMap<String, BTreeMap<String, u64>>,
    /// Times the gripper moved though no grip was asked for, in a minute without grip.
    pub gripper_false_activations_per_min: f64,
    /// Grips asked for in which the gripper moved, in percent.
    pub grips_answered_percent: f64,
    /// Times the arm was sent from one direction into another while one thing was asked for, in a minute.
    pub direction_changes_per_min: f64,
    /// From the onset of a movement to the first command of the right gesture.
    pub onset_to_first_correct_command_ms: Times,
    /// Movements with an onset that no command answered.
    pub never_answered: u64,
    /// From a window's first sample to its command: the window's length and the computing.
    pub window_start_to_command_ms: Times,
}

/// Gathers what a strategy did, recording by recording.
#[derive(Clone, Debug)]
pub struct StrategyTally {
    sample_rate_hz: f64,
    per_gesture: BTreeMap<Gesture, GestureWindows>,
    per_repetition: Vec<RepetitionScores>,
    mistaken: BTreeMap<Gesture, BTreeMap<Gesture, u64>>,
    scored_samples: u64,
    grip_samples: u64,
    false_activations: u64,
    grips: u64,
    grips_answered: u64,
    direction_changes: u64,
    answered_ms: Vec<f64>,
    never_answered: u64,
    window_start_to_command_ms: Vec<f64>,
}

impl StrategyTally {
    /// Nothing yet; samples are at this rate.
    pub fn new(sample_rate_hz: f64) -> StrategyTally {
        StrategyTally {
            sample_rate_hz,
            per_gesture: BTreeMap::new(),
            per_repetition: Vec::new(),
            mistaken: BTreeMap::new(),
            scored_samples: 0,
            grip_samples: 0,
            false_activations: 0,
            grips: 0,
            grips_answered: 0,
            direction_changes: 0,
            answered_ms: Vec::new(),
            never_answered: 0,
            window_start_to_command_ms: Vec::new(),
        }
    }

    /// Takes a recording: its cues and what the strategy made of every window, both in their order.
    pub fn add(&mut self, person: u16, session: &str, repetition: u32, cues: &[CuePart], steps: &[Step]) {
        let mut here: BTreeMap<Gesture, GestureWindows> = BTreeMap::new();
        for step in steps {
            let samples = step.end_sample - step.first_sample;
            self.window_start_to_command_ms.push(self.ms(samples) + step.work_ns as f64 * 1e-6);
        }
        for cue in cues {
            let Some(gesture) = cue.gesture else { continue };
            let cue_samples = cue.end - cue.start;
            self.scored_samples += cue_samples;
            let newest_inside = |step: &&Step| (cue.start + 1..=cue.end).contains(&step.end_sample);
            let toggles = steps.iter().filter(newest_inside).filter(|step| step.toggles_gripper);
            if gesture == Gesture::GRIP {
                self.grip_samples += cue_samples;
                self.grips += 1;
                self.grips_answered += u64::from(toggles.count() > 0);
            } else {
                // A window that still shows the grip before this cue toggles rightly.
                let shows_grip = |step: &Step| {
                    let grips = cues.iter().filter(|other| other.gesture == Some(Gesture::GRIP));
                    grips.into_iter().any(|grip| step.first_sample < grip.end && step.end_sample > grip.start)
                };
                self.false_activations += toggles.filter(|step| !shows_grip(step)).count() as u64;
            }
            if let Some(onset) = cue.onset.filter(|_| gesture != Gesture::REST) {
                let after_onset = |step: &&Step| step.end_sample > onset && step.end_sample <= cue.end;
                match steps.iter().filter(after_onset).find(|step| step.voted == gesture) {
                    Some(step) => {
                        let work_ms = step.work_ns as f64 * 1e-6;
                        self.answered_ms.push(self.ms(step.end_sample - onset) + work_ms);
                    }
                    None => self.never_answered += 1,
                }
            }
            self.add_windows(cue, gesture, steps, &mut here);
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

    /// Scores the windows of a cue that show its gesture; `here` counts those of the recording.
    fn add_windows(
        &mut self,
        cue: &CuePart,
        gesture: Gesture,
        steps: &[Step],
        here: &mut BTreeMap<Gesture, GestureWindows>,
    ) {
        let Some(begun) = cue.begun else { return };
        let inside = |step: &&Step| step.first_sample >= begun && step.end_sample <= cue.end;
        let mut direction_before = None;
        for step in steps.iter().filter(inside) {
            for scores in [&mut self.per_gesture, &mut *here] {
                scores.entry(gesture).or_default().add(gesture, step.gesture);
            }
            if step.gesture != gesture {
                *self.mistaken.entry(gesture).or_default().entry(step.gesture).or_default() += 1;
            }
            let direction = Some(step.voted).filter(|voted| ![Gesture::REST, Gesture::GRIP].contains(voted));
            if let (Some(before), Some(now)) = (direction_before, direction) {
                self.direction_changes += u64::from(before != now);
            }
            direction_before = direction;
        }
    }

    /// The scores so far.
    pub fn scores(&self) -> StrategyScores {
        let minutes = |samples: u64| samples as f64 / self.sample_rate_hz / 60.0;
        let per_minute =
            |count: u64, samples| if samples == 0 { 0.0 } else { count as f64 / minutes(samples) };
        let by_name = |gesture: &Gesture| gesture.name().to_owned();
        let shares: Vec<f64> = self.per_gesture.values().map(|windows| windows.correct_percent).collect();
        StrategyScores {
            repetitions: self.per_repetition.len() as u64,
            scored_s: self.scored_samples as f64 / self.sample_rate_hz,
            per_gesture: self
                .per_gesture
                .iter()
                .map(|(gesture, windows)| (by_name(gesture), *windows))
                .collect(),
            mean_correct_percent: Spread::of(&shares).mean,
            per_repetition: self.per_repetition.clone(),
            mistaken: self
                .mistaken
                .iter()
                .map(|(truth, taken)| {
                    (by_name(truth), taken.iter().map(|(taken, count)| (by_name(taken), *count)).collect())
                })
                .collect(),
            gripper_false_activations_per_min: per_minute(
                self.false_activations,
                self.scored_samples - self.grip_samples,
            ),
            grips_answered_percent: if self.grips == 0 {
                0.0
            } else {
                100.0 * self.grips_answered as f64 / self.grips as f64
            },
            direction_changes_per_min: per_minute(self.direction_changes, self.scored_samples),
            onset_to_first_correct_command_ms: Times::of(self.answered_ms.clone()),
            never_answered: self.never_answered,
            window_start_to_command_ms: Times::of(self.window_start_to_command_ms.clone()),
        }
    }

    fn ms(&self, samples: u64) -> f64 {
        samples as f64 * 1e3 / self.sample_rate_hz
    }
}

impl Display for StrategyScores {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{:<12}{:>9}{:>18}{:>12}{:>23}",
            "gesture", "windows", "taken for move %", "correct %", "correct of moving %"
        )?;
        for (gesture, windows) in &self.per_gesture {
            let GestureWindows {
                windows, moving_percent, correct_percent, correct_of_moving_percent, ..
            } = windows;
            let of_moving = match gesture == Gesture::REST.name() {
                true => "-".to_owned(),
                false => format!("{correct_of_moving_percent:.2}"),
            };
            writeln!(
                out,
                "{gesture:<12}{windows:>9}{moving_percent:>18.2}{correct_percent:>12.2}{of_moving:>23}"
            )?;
        }
        writeln!(
            out,
            "mean of the gestures: {:.2} % correct, in {} repetitions, {:.0} s of signal",
            self.mean_correct_percent, self.repetitions, self.scored_s
        )?;
        writeln!(
            out,
            "gripper: {:.2} false activations a minute, {:.0} % of the grips answered; {:.2} changes of direction a \
             minute",
            self.gripper_false_activations_per_min,
            self.grips_answered_percent,
            self.direction_changes_per_min
        )?;
        let answered = &self.onset_to_first_correct_command_ms;
        writeln!(
            out,
            "onset to first correct command: median {:.0} ms, mean {:.0} ms (sd {:.0}) in {} movements; {} never \
             answered",
            answered.median, answered.spread.mean, answered.spread.sd, answered.count, self.never_answered
        )?;
        let start = &self.window_start_to_command_ms;
        writeln!(
            out,
            "window start to command: mean {:.2} ms, sd {:.2}, {:.2} to {:.2}",
            start.spread.mean, start.spread.sd, start.spread.min, start.spread.max
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 2000.0;

    /// Rest for 2 s, grip for 2 s with its onset after 0.5 s, ulnar likewise.
    fn cues() -> [CuePart; 3] {
        [Gesture::REST, Gesture::GRIP, Gesture::ULNAR].map(|gesture| {
            let start = [Gesture::REST, Gesture::GRIP, Gesture::ULNAR]
                .iter()
                .position(|other| *other == gesture)
                .unwrap() as u64
                * 4000;
            let onset = (gesture != Gesture::REST).then_some(start + 1000);
            let begun = Some(onset.map_or(start + 500, |onset| onset - 100));
            CuePart { gesture: Some(gesture), start, begun, onset, end: start + 4000 }
        })
    }

    /// A window every 150 samples, of 600, with what `decide` makes of its end.
    fn steps(decide: impl Fn(u64) -> (Gesture, Gesture, bool)) -> Vec<Step> {
        let step = |first_sample: u64| {
            let end_sample = first_sample + 600;
            let (gesture, voted, toggles_gripper) = decide(end_sample);
            Step { first_sample, end_sample, gesture, voted, toggles_gripper, work_ns: 500_000 }
        };
        (0..=11_400).step_by(150).map(step).collect()
    }

    fn scores(decide: impl Fn(u64) -> (Gesture, Gesture, bool)) -> StrategyScores {
        let mut tally = StrategyTally::new(RATE_HZ);
        tally.add(7, "train", 0, &cues(), &steps(decide));
        tally.scores()
    }

    #[test]
    fn a_strategy_that_is_always_right_is_said_to_be() {
        let scores = scores(|end| {
            let gesture = match end {
                0..=4000 => Gesture::REST,
                4001..=8000 => Gesture::GRIP,
                _ => Gesture::ULNAR,
            };
            (gesture, gesture, end == 6000)
        });
        assert_eq!(scores.mean_correct_percent, 100.0);
        assert_eq!(scores.per_gesture["rest"].moving_percent, 0.0);
        // Windows from sample 500 (first multiple of 150: 600) to 4000: starts 600 to 3300.
        assert_eq!(scores.per_gesture["rest"].windows, 19);
        assert_eq!(scores.per_repetition[0].correct_percent["ulnar"], 100.0);
        assert_eq!((scores.gripper_false_activations_per_min, scores.grips_answered_percent), (0.0, 100.0));
        assert_eq!((scores.direction_changes_per_min, scores.never_answered), (0.0, 0));
        // Onsets at 5000 and 9000; the first windows that end later end at 5100 and 9150.
        let answered = scores.onset_to_first_correct_command_ms;
        assert_eq!((answered.count, answered.spread.min), (2, 50.0 + 0.5));
        let latency = scores.window_start_to_command_ms;
        assert_eq!((latency.spread.mean, latency.median), (300.5, 300.5));
        assert!(scores.to_string().contains("100.00 % correct, in 1 repetitions, 6 s of signal"), "{scores}");
    }

    #[test]
    fn false_grips_changes_of_direction_and_unanswered_movements_are_counted() {
        // Ulnar and radial in turn during ulnar; the gripper moves once in rest, once late after the grip.
        let scores = scores(|end| {
            let voted = match end {
                8001.. if end / 150 % 2 == 0 => Gesture::RADIAL,
                8001.. => Gesture::EXTENSION,
                _ => Gesture::REST,
            };
            (voted, voted, end == 3000 || end == 8100)
        });
        // One false activation in 4 s without grip.
        assert_eq!(scores.gripper_false_activations_per_min, 15.0);
        assert_eq!(scores.grips_answered_percent, 0.0);
        // 6 s are scored; windows of ulnar start at 9000 to 11400: 17, so 16 changes.
        assert_eq!(scores.direction_changes_per_min, 160.0);
        assert_eq!((scores.never_answered, scores.onset_to_first_correct_command_ms.count), (2, 0));
        let ulnar = &scores.per_gesture["ulnar"];
        assert_eq!(
            (ulnar.moving_percent, ulnar.correct_percent, ulnar.correct_of_moving_percent),
            (100.0, 0.0, 0.0)
        );
        let mistaken = &scores.mistaken["ulnar"];
        assert_eq!(mistaken["radial"] + mistaken["extension"], ulnar.windows);
    }

    #[test]
    fn what_is_none_of_the_six_gestures_is_not_scored() {
        let mut tally = StrategyTally::new(RATE_HZ);
        let cues = cues().map(|cue| CuePart { gesture: None, ..cue });
        tally.add(7, "train", 0, &cues, &steps(|_| (Gesture::GRIP, Gesture::GRIP, true)));
        let scores = tally.scores();
        assert_eq!((scores.scored_s, scores.gripper_false_activations_per_min), (0.0, 0.0));
        assert!(scores.per_gesture.is_empty());
    }
}
