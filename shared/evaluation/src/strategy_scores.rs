//! How well a strategy does: as JSON with stable keys, and as a table.

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;

use crate::evaluation::Spread;

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
    /// Of those taken for a movement, the share taken for the right one, in percent; `null` of rest, and where none was.
    pub correct_of_moving_percent: Option<f64>,
}

impl GestureWindows {
    pub(crate) fn add(&mut self, truth: Gesture, recognised: Gesture) {
        self.windows += 1;
        self.moving += u64::from(recognised != Gesture::REST);
        self.correct += u64::from(recognised == truth);
        let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole as f64;
        self.moving_percent = percent(self.moving, self.windows);
        self.correct_percent = percent(self.correct, self.windows);
        self.correct_of_moving_percent =
            (truth != Gesture::REST && self.moving > 0).then(|| percent(self.correct, self.moving));
    }
}

/// Shares of correctly recognised windows in one repetition, in percent, by gesture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RepetitionScores {
    /// Who it is.
    pub person: PersonId,
    /// `train`, `test`, or whatever the recording's layout calls it.
    pub session: String,
    /// Repetition within the session.
    pub repetition: u32,
    /// By gesture, in percent.
    pub correct_percent: BTreeMap<String, f64>,
}

/// Times in ms. All but the count are `null` of none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// How many.
    pub count: u64,
    /// Mean.
    pub mean: Option<f64>,
    /// Standard deviation (of the sample); 0 of one.
    pub sd: Option<f64>,
    /// Shortest.
    pub min: Option<f64>,
    /// Longest.
    pub max: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Nine of ten are no longer. Between two values it is interpolated, as NumPy does.
    pub p90: Option<f64>,
}

impl Times {
    pub(crate) fn of(mut times_ms: Vec<f64>) -> Times {
        let count = times_ms.len();
        if count == 0 {
            return Times::default();
        }
        times_ms.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let place = share * (count - 1) as f64;
            let below = place.floor() as usize;
            let above = (below + 1).min(count - 1);
            times_ms[below] + (place - below as f64) * (times_ms[above] - times_ms[below])
        };
        let Spread { mean, sd, min, max } = Spread::of(&times_ms);
        Times {
            count: count as u64,
            mean: Some(mean),
            sd: Some(sd),
            min: Some(min),
            max: Some(max),
            median: Some(quantile(0.5)),
            p90: Some(quantile(0.9)),
        }
    }
}

/// How well a strategy does. What the recordings do not show is `null`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StrategyScores {
    /// Recordings.
    pub repetitions: u64,
    /// Signal that was scored: in which a gesture was asked for, and rest after movements, s.
    pub scored_s: f64,
    /// Rest that was scored, s.
    pub rest_scored_s: f64,
    /// By gesture: windows as they are recognised, before the vote.
    pub per_gesture: BTreeMap<String, GestureWindows>,
    /// Mean over the gestures of the share of correct windows, in percent.
    pub mean_correct_percent: Option<f64>,
    /// Each repetition.
    pub per_repetition: Vec<RepetitionScores>,
    /// How often each true gesture (first key) was taken for another (second key), in windows.
    pub mistaken: BTreeMap<String, BTreeMap<String, u64>>,
    /// Of all windows after an onset, the share in which the arm was told the right gesture.
    pub correct_share: Option<f64>,
    /// Of all windows after an onset, the share in which it was told another gesture, a grip included.
    pub wrong_gesture_share: Option<f64>,
    /// Of all windows after an onset, the share in which another gesture moved it.
    pub wrong_direction_share: Option<f64>,
    /// Of all windows of rest, the share in which it was told a gesture.
    pub rest_taken_for_movement_share: Option<f64>,
    /// Times it was told a gesture after rest, in a minute of rest.
    pub rest_false_activations_per_min: Option<f64>,
    /// How far it was told to move by wrong gestures and at rest, mm in a minute after onsets or of rest.
    pub wrong_motion_mm_per_min: Option<f64>,
    /// Times the gripper moved though no grip was asked for, in a minute without grip.
    pub gripper_false_activations_per_min: Option<f64>,
    /// Grips asked for in which the gripper moved, in percent.
    pub grips_answered_percent: Option<f64>,
    /// Times the arm was sent from one direction into another while one thing was asked for, in a minute.
    pub direction_changes_per_min: Option<f64>,
    /// From the onset of a movement to the first command of the right gesture.
    pub onset_to_first_correct_command_ms: Times,
    /// Movements with an onset that no command answered; `null` without onsets.
    pub never_answered: Option<u64>,
    /// Movements in which no onset was found. Their answers are not scored.
    pub movements_without_onset: u64,
    /// From a window's first sample to its command: the window's length and the computing.
    pub window_start_to_command_ms: Times,
}

/// A number with some digits, or a dash for what was not scored.
pub fn in_words(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.digits$}"))
}

impl Display for StrategyScores {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_gestures(out)?;
        let percent = |share: Option<f64>| in_words(share.map(|share| 100.0 * share), 2);
        writeln!(
            out,
            "after an onset: {} % of the windows correct, {} % another gesture, {} % a wrong direction",
            percent(self.correct_share),
            percent(self.wrong_gesture_share),
            percent(self.wrong_direction_share)
        )?;
        let answered = &self.onset_to_first_correct_command_ms;
        writeln!(
            out,
            "onset to first correct command: median {} ms, mean {} ms (sd {}), 90 % within {} ms, in {} movements; \
             {} never answered, {} without an onset",
            in_words(answered.median, 0),
            in_words(answered.mean, 0),
            in_words(answered.sd, 0),
            in_words(answered.p90, 0),
            answered.count,
            self.never_answered.map_or("–".to_owned(), |count| count.to_string()),
            self.movements_without_onset
        )?;
        if self.rest_scored_s > 0.0 {
            writeln!(
                out,
                "{:.0} s of rest: {} % taken for movement, {} false activations a minute",
                self.rest_scored_s,
                percent(self.rest_taken_for_movement_share),
                in_words(self.rest_false_activations_per_min, 2)
            )?;
        } else {
            writeln!(out, "rest: not scored, there is none that did not calibrate")?;
        }
        writeln!(
            out,
            "a minute: {} mm of wrong motion, {} changes of direction, {} false activations of the gripper; {} % of \
             the grips answered",
            in_words(self.wrong_motion_mm_per_min, 0),
            in_words(self.direction_changes_per_min, 2),
            in_words(self.gripper_false_activations_per_min, 2),
            in_words(self.grips_answered_percent, 0)
        )?;
        let start = &self.window_start_to_command_ms;
        writeln!(
            out,
            "window start to command: mean {} ms, sd {}, {} to {}",
            in_words(start.mean, 2),
            in_words(start.sd, 2),
            in_words(start.min, 2),
            in_words(start.max, 2)
        )
    }
}

impl StrategyScores {
    fn write_gestures(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{:<12}{:>9}{:>18}{:>12}{:>23}",
            "gesture", "windows", "taken for move %", "correct %", "correct of moving %"
        )?;
        for (gesture, windows) in &self.per_gesture {
            let GestureWindows {
                windows,
                moving_percent,
                correct_percent,
                correct_of_moving_percent: of_moving,
                ..
            } = windows;
            let of_moving = in_words(*of_moving, 2);
            writeln!(
                out,
                "{gesture:<12}{windows:>9}{moving_percent:>18.2}{correct_percent:>12.2}{of_moving:>23}"
            )?;
        }
        writeln!(
            out,
            "mean of the gestures: {} % correct, in {} repetitions, {:.0} s of signal",
            in_words(self.mean_correct_percent, 2),
            self.repetitions,
            self.scored_s
        )
    }
}
