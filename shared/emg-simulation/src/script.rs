//! Gesture scripts: which gesture is made for how long, one after the other.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_gesture::{Gesture, GestureSet, UnknownGesture};

/// Every gesture once. Rest comes first and is long enough for the five seconds on which the threshold
/// strategy calibrates.
pub const DEFAULT_SCRIPT: &str = "rest 6s, extension 2s, rest 1s, flexion 2s, rest 1s, ulnar 2s, rest 1s, \
                                  radial 2s, rest 1s, grip 2s, rest 1s";

/// One gesture, held for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The gesture made.
    pub gesture: Gesture,
    /// Its share of the amplitude of a full contraction, above 0 and at most 1.
    pub effort: f32,
    /// Duration, greater than zero.
    pub duration: Duration,
}

/// A sequence of gestures, at least one. Its text form is `rest 6s, extension 1500ms, grip@0.5 2s`: the grip at half the
/// effort.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    steps: Vec<Step>,
}

/// What is wrong with the text of a script, and where. Columns count characters from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScriptError {
    /// Nothing between two commas, or no text at all.
    #[error("script, column {column}: expected a step such as `rest 6s`, found nothing")]
    MissingStep {
        /// Where the step should begin.
        column: usize,
    },
    /// A word that cannot be the name of a gesture.
    #[error("script, column {column}: {unknown}")]
    Gesture {
        /// Where the word begins.
        column: usize,
        /// The word.
        unknown: tendon_gesture::NoGestureName,
    },
    /// An effort that is none.
    #[error(
        "script, column {column}: `{found}` is no effort: expected a number above 0 and at most 1, such as `grip@0.5`"
    )]
    Effort {
        /// Where the effort begins.
        column: usize,
        /// What stands there.
        found: String,
    },
    /// A gesture without a duration.
    #[error("script, column {column}: expected a duration after `{gesture}`, such as `2s` or `1500ms`")]
    MissingDuration {
        /// Where the duration should begin.
        column: usize,
        /// The gesture before it.
        gesture: Gesture,
    },
    /// A duration that is not a positive number of `s` or `ms`.
    #[error(
        "script, column {column}: `{found}` is no duration: expected a number from 0.001 s to 86400 s with its unit, \
         such as `2s` or `1500ms`"
    )]
    Duration {
        /// Where the duration begins.
        column: usize,
        /// What stands there.
        found: String,
    },
    /// Something after the duration.
    #[error("script, column {column}: expected a comma before `{found}`")]
    MissingComma {
        /// Where the unexpected word begins.
        column: usize,
        /// What stands there.
        found: String,
    },
}

impl Step {
    /// A full contraction.
    fn full(gesture: Gesture, duration: Duration) -> Step {
        Step { gesture, effort: 1.0, duration }
    }
}

impl Script {
    /// A random sequence of `gestures` that depends on `seed` alone: 6 s of rest, then `count` times an active gesture
    /// of 1 to 3 s followed by 1 to 2 s of rest.
    pub fn random(gestures: &GestureSet, seed: u64, count: usize) -> Script {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut steps = vec![Step::full(Gesture::REST, Duration::from_secs(6))];
        for _ in 0..count {
            let number = rng.random_range(1..gestures.len()) as u8;
            let gesture = gestures.get(number).expect("the number is below their count");
            steps.push(Step::full(gesture, Duration::from_millis(rng.random_range(1000..=3000))));
            steps.push(Step::full(Gesture::REST, Duration::from_millis(rng.random_range(1000..=2000))));
        }
        Script { steps }
    }

    /// The steps in their order; never empty.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Checks that every gesture of the script is one of these.
    ///
    /// # Errors
    /// The first that is not, and those that are known.
    pub fn check(&self, gestures: &GestureSet) -> Result<(), UnknownGesture> {
        self.steps.iter().try_for_each(|step| gestures.find(step.gesture.name()).map(drop))
    }

    /// The sum of all steps.
    pub fn duration(&self) -> Duration {
        self.steps.iter().map(|step| step.duration).sum()
    }
}

impl FromStr for Script {
    type Err = ScriptError;

    fn from_str(text: &str) -> Result<Script, ScriptError> {
        let mut steps = Vec::new();
        let mut column = 1;
        for part in text.split(',') {
            steps.push(parse_step(part, column)?);
            column += part.chars().count() + 1;
        }
        Ok(Script { steps })
    }
}

impl fmt::Display for Script {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, Step { gesture, effort, duration }) in self.steps.iter().enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            let effort = if *effort == 1.0 { String::new() } else { format!("@{effort}") };
            write!(formatter, "{separator}{gesture}{effort} {}ms", duration.as_millis())?;
        }
        Ok(())
    }
}

/// Parses the text between two commas, which begins at `column` of the script.
fn parse_step(part: &str, column: usize) -> Result<Step, ScriptError> {
    let mut words = part.split_whitespace().map(|word| {
        // A word is a slice of its part, so the distance between their starts is the position of the word.
        let bytes_before = word.as_ptr() as usize - part.as_ptr() as usize;
        (word, column + part[..bytes_before].chars().count())
    });
    let (name, name_column) = words.next().ok_or(ScriptError::MissingStep { column })?;
    let (name, effort) = name.split_once('@').map_or((name, None), |(name, effort)| (name, Some(effort)));
    let gesture: Gesture =
        name.parse().map_err(|unknown| ScriptError::Gesture { column: name_column, unknown })?;
    let effort = effort.map_or(Ok(1.0), |text| {
        let effort = text.parse().ok().filter(|effort| *effort > 0.0 && *effort <= 1.0);
        let column = name_column + name.chars().count() + 1;
        effort.ok_or_else(|| ScriptError::Effort { column, found: text.to_owned() })
    })?;
    let (text, text_column) = words.next().ok_or_else(|| ScriptError::MissingDuration {
        column: column + part.trim_end().chars().count(),
        gesture,
    })?;
    let duration = parse_duration(text)
        .ok_or_else(|| ScriptError::Duration { column: text_column, found: text.to_owned() })?;
    match words.next() {
        None => Ok(Step { gesture, effort, duration }),
        Some((found, column)) => Err(ScriptError::MissingComma { column, found: found.to_owned() }),
    }
}

/// `2s`, `0.5s`, `1500ms`: whole milliseconds from 1 ms to a day.
fn parse_duration(text: &str) -> Option<Duration> {
    let (number, milliseconds_per_unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 1.0),
        None => (text.strip_suffix('s')?, 1000.0),
    };
    let milliseconds = (number.parse::<f64>().ok()? * milliseconds_per_unit).round();
    (1.0..=86_400_000.0).contains(&milliseconds).then(|| Duration::from_millis(milliseconds as u64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn random(seed: u64, count: usize) -> Script {
        Script::random(&GestureSet::default(), seed, count)
    }

    #[test]
    fn the_default_script_makes_every_gesture_after_six_seconds_of_rest() {
        let script: Script = DEFAULT_SCRIPT.parse().unwrap();
        assert_eq!(script.steps()[0], Step::full(Gesture::REST, Duration::from_secs(6)));
        for gesture in Gesture::PAPER {
            assert!(script.steps().iter().any(|step| step.gesture == gesture), "{gesture} is missing");
        }
        assert_eq!(script.duration(), Duration::from_secs(21));
    }

    #[test]
    fn errors_name_the_column_and_what_was_expected() {
        let message = |text: &str| text.parse::<Script>().unwrap_err().to_string();
        assert_eq!(message(""), "script, column 1: expected a step such as `rest 6s`, found nothing");
        assert_eq!(message("rest 6s,"), "script, column 9: expected a step such as `rest 6s`, found nothing");
        assert_eq!(
            message("rest 6s, Fist 2s"),
            "script, column 10: `Fist` cannot be the name of a gesture: take 1 to 23 characters of a-z, 0-9, - and _"
        );
        assert_eq!(
            message("rest 6s,  grip"),
            "script, column 15: expected a duration after `grip`, such as `2s` or `1500ms`"
        );
        for effort in ["", "0", "-1", "1.1", "half", "NaN", "0.5@1"] {
            let refused = message(&format!("rest 6s, grip@{effort} 2s"));
            assert!(refused.starts_with(&format!("script, column 15: `{effort}` is no effort")), "{refused}");
        }
        assert!(message("grip 2 s").starts_with("script, column 6: `2` is no duration"));
        assert!(message("grip -2s").starts_with("script, column 6: `-2s` is no duration"));
        assert!(message("grip NaNs").starts_with("script, column 6: `NaNs` is no duration"));
        assert_eq!(message("grip 2s rest 1s"), "script, column 9: expected a comma before `rest`");
    }

    #[test]
    fn gestures_that_nobody_can_make_are_named() {
        let script: Script = "rest 6s, fist 2s".parse().unwrap();
        let error = script.check(&GestureSet::default()).unwrap_err();
        assert_eq!(error.name, "fist");
    }

    #[test]
    fn a_random_script_depends_on_its_seed_alone() {
        assert_eq!(random(7, 20), random(7, 20));
        assert_ne!(random(7, 20), random(8, 20));
        assert_eq!(random(7, 20).steps().len(), 41);
    }

    proptest! {
        #[test]
        fn what_is_printed_is_read_back(seed: u64, gestures in 0_usize..30, effort in 0.001_f32..=1.0) {
            let mut script = random(seed, gestures);
            script.steps[0].effort = effort;
            prop_assert_eq!(script.to_string().parse::<Script>(), Ok(script));
        }

        #[test]
        fn no_text_makes_the_parser_panic(text in "\\PC{0,40}") {
            let _ = text.parse::<Script>();
        }
    }
}
