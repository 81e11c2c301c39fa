//! A performance: which gesture is made when, and how strongly each muscle pattern is present in the signal.
//!
//! ```text
//! commanded   rest │ extension  │ at half the effort │ rest
//! extension        ╱‾‾‾‾‾‾‾‾‾‾‾‾╲____________________
//! rest        ‾‾‾‾‾╲____________╱‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾╲╱‾‾‾
//! ```
//!
//! Every gesture, rest included, has a level from 0 to 1, its share of the amplitude. That of the commanded gesture goes
//! to its effort, that of rest to what is left of 1, and those of all others to 0.

use serde::{Deserialize, Serialize};
use tendon_gesture::{Gesture, GestureSet};

use crate::script::Script;
use crate::simulator::SimulationError;

/// How fast contractions come and go.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContractionSettings {
    /// From nothing to a full contraction, in milliseconds.
    pub rise_ms: f64,
    /// From a full contraction to nothing, in milliseconds.
    pub fall_ms: f64,
}

impl Default for ContractionSettings {
    fn default() -> ContractionSettings {
        ContractionSettings { rise_ms: 150.0, fall_ms: 150.0 }
    }
}

impl ContractionSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), SimulationError> {
        for (key, value) in [("rise_ms", self.rise_ms), ("fall_ms", self.fall_ms)] {
            if !(0.0..=10_000.0).contains(&value) {
                return Err(SimulationError::Setting { key, value, range: "from 0 to 10000" });
            }
        }
        Ok(())
    }
}

/// What follows the last step of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeat {
    /// The first step again.
    Forever,
    /// Rest.
    Once,
}

/// The gesture that is really being made, after the newest sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Truth {
    /// The commanded gesture, or rest.
    pub gesture: Gesture,
    /// The number of the first sample that belongs to this gesture alone. A gesture begins with its rise.
    /// What follows a gesture begins when the fall has ended, so during a fall this number is ahead of the
    /// newest sample. A window lies wholly inside the gesture if it starts at this sample or later.
    pub since_sample: u64,
}

/// Follows a script, or gestures given one by one, sample by sample.
#[derive(Clone, Debug)]
pub struct Performance {
    script: Option<Playback>,
    gestures: GestureSet,
    /// In the order of the class numbers.
    levels: Vec<f32>,
    rise_per_sample: f32,
    fall_per_sample: f32,
    fall_samples: u64,
    sample: u64,
    truth: Truth,
    /// Of the commanded gesture, from 0 to 1.
    effort: f32,
}

#[derive(Clone, Debug)]
struct Playback {
    script: Script,
    repeat: Repeat,
    sample_rate_hz: f64,
    step: usize,
    step_ends_at: u64,
}

impl Performance {
    /// Rest, until [`Performance::set_gesture`] says otherwise. `gestures` are those of the profile,
    /// [`Profile::gesture_set`](crate::Profile::gesture_set).
    ///
    /// # Panics
    /// If `sample_rate_hz` is not positive, or a duration in `contraction` is negative or not finite.
    pub fn at_rest(
        gestures: &GestureSet,
        contraction: ContractionSettings,
        sample_rate_hz: f64,
    ) -> Performance {
        assert!(sample_rate_hz > 0.0 && sample_rate_hz.is_finite(), "sample rate {sample_rate_hz} Hz");
        let samples = |milliseconds: f64| {
            assert!(
                milliseconds >= 0.0 && milliseconds.is_finite(),
                "a contraction changes in {milliseconds} ms"
            );
            (milliseconds * 1e-3 * sample_rate_hz).round().max(1.0)
        };
        let fall_samples = samples(contraction.fall_ms);
        let mut levels = vec![0.0; gestures.len()];
        levels[0] = 1.0;
        Performance {
            script: None,
            gestures: gestures.clone(),
            levels,
            rise_per_sample: (1.0 / samples(contraction.rise_ms)) as f32,
            fall_per_sample: (1.0 / fall_samples) as f32,
            fall_samples: fall_samples as u64,
            sample: 0,
            truth: Truth { gesture: Gesture::REST, since_sample: 0 },
            effort: 1.0,
        }
    }

    /// Follows `script` from its first step. Its gestures are among `gestures`: [`Script::check`]. One that is not is a rest.
    ///
    /// # Panics
    /// As [`Performance::at_rest`].
    pub fn of_script(
        gestures: &GestureSet,
        script: Script,
        repeat: Repeat,
        contraction: ContractionSettings,
        sample_rate_hz: f64,
    ) -> Performance {
        let mut performance = Performance::at_rest(gestures, contraction, sample_rate_hz);
        let first = script.steps()[0];
        let step_ends_at = duration_samples(first.duration, sample_rate_hz);
        performance.script = Some(Playback { script, repeat, sample_rate_hz, step: 0, step_ends_at });
        performance.command(first.gesture, first.effort);
        performance
    }

    /// Commands `gesture` from the next sample on, at an effort from 0 to 1, its share of the amplitude, and leaves the
    /// script if there was one. A gesture that the profile does not know, and one without effort, is a rest.
    pub fn set_gesture(&mut self, gesture: Gesture, effort: f32) {
        self.script = None;
        self.command(gesture, effort);
    }

    /// Whether a script that is played once has ended, or was left by [`Performance::set_gesture`].
    pub fn is_finished(&self) -> bool {
        self.script.is_none()
    }

    /// The truth after the newest sample.
    pub fn truth(&self) -> Truth {
        self.truth
    }

    /// Advances by one sample and returns how strongly each gesture is present in it, by class number.
    pub(crate) fn next_levels(&mut self) -> &[f32] {
        self.follow_script();
        let commanded = usize::from(self.gestures.number(self.truth.gesture).unwrap_or(0));
        for (index, level) in self.levels.iter_mut().enumerate() {
            let wanted = match index {
                _ if index == commanded => self.effort,
                0 => 1.0 - self.effort,
                _ => 0.0,
            };
            *level = if *level < wanted {
                (*level + self.rise_per_sample).min(wanted)
            } else {
                (*level - self.fall_per_sample).max(wanted)
            };
        }
        self.sample += 1;
        &self.levels
    }

    fn follow_script(&mut self) {
        let Some(playback) = &mut self.script else { return };
        if self.sample < playback.step_ends_at {
            return;
        }
        playback.step += 1;
        if playback.step == playback.script.steps().len() {
            playback.step = 0;
            if playback.repeat == Repeat::Once {
                self.set_gesture(Gesture::REST, 1.0);
                return;
            }
        }
        let step = playback.script.steps()[playback.step];
        playback.step_ends_at += duration_samples(step.duration, playback.sample_rate_hz);
        self.command(step.gesture, step.effort);
    }

    fn command(&mut self, gesture: Gesture, effort: f32) {
        let is_known = self.gestures.number(gesture).is_some();
        let gesture = if is_known && effort > 0.0 { gesture } else { Gesture::REST };
        self.effort = if gesture == Gesture::REST { 1.0 } else { effort.min(1.0) };
        if gesture == self.truth.gesture {
            return;
        }
        // Rest has no fall to wait for: it is the absence of a contraction. An earlier fall may still be
        // under way.
        let previous_ends = if self.truth.gesture == Gesture::REST {
            self.truth.since_sample.max(self.sample)
        } else {
            self.sample + self.fall_samples
        };
        self.truth = Truth { gesture, since_sample: previous_ends };
    }
}

/// Whole samples in `duration`, at least one, so that no step is skipped.
fn duration_samples(duration: std::time::Duration, sample_rate_hz: f64) -> u64 {
    (duration.as_secs_f64() * sample_rate_hz).round().max(1.0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 1000.0;

    fn play(text: &str, repeat: Repeat) -> Performance {
        let script = text.parse().unwrap();
        Performance::of_script(
            &GestureSet::default(),
            script,
            repeat,
            ContractionSettings::default(),
            RATE_HZ,
        )
    }

    /// Truth and levels after each of `count` samples.
    fn follow(performance: &mut Performance, count: usize) -> Vec<(Truth, Vec<f32>)> {
        (0..count)
            .map(|_| {
                let levels = performance.next_levels().to_vec();
                (performance.truth(), levels)
            })
            .collect()
    }

    #[test]
    fn a_gesture_begins_with_its_rise_and_rest_after_its_fall() {
        let mut performance = play("rest 1s, grip 1s, rest 1s", Repeat::Once);
        let played = follow(&mut performance, 3000);
        assert_eq!(played[999].0, Truth { gesture: Gesture::REST, since_sample: 0 });
        assert_eq!(played[1000].0, Truth { gesture: Gesture::GRIP, since_sample: 1000 });
        assert_eq!(played[1999].0, Truth { gesture: Gesture::GRIP, since_sample: 1000 });
        assert_eq!(played[2000].0, Truth { gesture: Gesture::REST, since_sample: 2150 });
        let grip = |sample: usize| played[sample].1[5];
        assert_eq!(grip(999), 0.0);
        assert!((grip(1074) - 0.5).abs() < 1e-3, "halfway up after half of the rise");
        assert!((grip(1150) - 1.0).abs() < 1e-5);
        assert!((grip(2074) - 0.5).abs() < 1e-3, "halfway down after half of the fall");
        assert!(grip(2150) < 1e-5);
        assert_eq!(grip(2151), 0.0);
    }

    #[test]
    fn a_script_repeats_or_ends_in_rest() {
        let mut forever = play("rest 1s, grip 1s", Repeat::Forever);
        let mut once = play("rest 1s, grip 1s", Repeat::Once);
        let forever_played = follow(&mut forever, 4000);
        let once_played = follow(&mut once, 4000);
        assert_eq!(forever_played[3500].0.gesture, Gesture::GRIP);
        assert!(!forever.is_finished());
        assert_eq!(once_played[3500].0, Truth { gesture: Gesture::REST, since_sample: 2150 });
        assert!(once.is_finished());
    }

    #[test]
    fn a_brief_gesture_does_not_hide_the_fall_before_it() {
        let mut performance = play("flexion 1s, rest 50ms, grip 1s", Repeat::Once);
        let played = follow(&mut performance, 1100);
        assert_eq!(played[1099].0, Truth { gesture: Gesture::GRIP, since_sample: 1150 });
    }

    #[test]
    fn a_gesture_set_from_outside_replaces_the_script() {
        let mut performance = play("rest 1s, grip 1s", Repeat::Forever);
        follow(&mut performance, 100);
        performance.set_gesture(Gesture::ULNAR, 1.0);
        let played = follow(&mut performance, 2000);
        assert!(
            played.iter().all(|(truth, _)| *truth == Truth { gesture: Gesture::ULNAR, since_sample: 100 })
        );
        assert_eq!(played[1999].1[3], 1.0);
        assert_eq!(played[1999].1[0], 0.0);
    }

    #[test]
    fn effort_shares_the_amplitude_between_a_gesture_and_rest() {
        let mut performance = play("rest 1s, grip@0.4 1s, grip 1s, grip@0.2 1s", Repeat::Once);
        let played = follow(&mut performance, 5000);
        for (sample, grip) in [(999, 0.0), (1999, 0.4), (2999, 1.0), (3999, 0.2), (4999, 0.0)] {
            let (truth, levels) = &played[sample];
            assert!((levels[5] - grip).abs() < 1e-6, "{} at {sample}", levels[5]);
            assert!((levels[0] - (1.0 - grip)).abs() < 1e-6, "rest {} at {sample}", levels[0]);
            assert_eq!(truth.gesture, if grip > 0.0 { Gesture::GRIP } else { Gesture::REST });
        }
        // It is one gesture, however hard: only its beginning and its end change the truth.
        assert_eq!(played[3999].0.since_sample, 1000);
        assert_eq!(played[4999].0.since_sample, 4150);
        performance.set_gesture(Gesture::ULNAR, 0.0);
        let (truth, levels) = follow(&mut performance, 1).remove(0);
        assert_eq!((truth.gesture, levels[3]), (Gesture::REST, 0.0));
    }
}
