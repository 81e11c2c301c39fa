//! How a calibration is guided.

use tendon_gesture::Gesture;

/// Shortest time for which anything may be asked, s.
const SHORTEST_S: f64 = 1.0;
/// Longest, s.
const LONGEST_S: f64 = 120.0;
/// What messages call it.
const REST: &str = "rest at the beginning";
/// Most gestures besides rest.
const MOST_GESTURES: usize = 12;
/// Most repetitions of a gesture.
const MOST_REPETITIONS: u32 = 20;

/// What is asked, how often and for how long. One repetition of the paper's six gestures takes 50 s by default.
#[derive(Clone, Debug, PartialEq)]
pub struct GuideSettings {
    /// The gestures besides rest, in the order in which they are asked.
    pub gestures: Vec<Gesture>,
    /// How often each is asked.
    pub repetitions: u32,
    /// Rest at the beginning, s; 0 for none.
    pub rest_s: f64,
    /// How long a gesture is held, s.
    pub hold_s: f64,
    /// Rest before each gesture, s; its last three seconds are counted down.
    pub pause_s: f64,
}

impl Default for GuideSettings {
    fn default() -> GuideSettings {
        GuideSettings {
            gestures: Gesture::PAPER.into_iter().filter(|gesture| *gesture != Gesture::REST).collect(),
            repetitions: 1,
            rest_s: 5.0,
            hold_s: 5.0,
            pause_s: 4.0,
        }
    }
}

/// What cannot be asked of anybody.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidGuide {
    /// Too few gestures or too many.
    #[error("{0} gestures besides rest: name 1 to {MOST_GESTURES}")]
    GestureCount(usize),
    /// A gesture that is named twice.
    #[error("the gesture {0} is named twice: name each once")]
    GestureTwice(Gesture),
    /// Too few repetitions or too many.
    #[error("{0} repetitions: ask for 1 to {MOST_REPETITIONS}")]
    Repetitions(u32),
    /// A time that is too short or too long.
    #[error("{what} of {seconds} s: take {SHORTEST_S} to {LONGEST_S} s")]
    Seconds {
        /// Whose time.
        what: &'static str,
        /// How long it is.
        seconds: f64,
    },
}

impl GuideSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), InvalidGuide> {
        let GuideSettings { gestures, repetitions, .. } = self;
        if !(1..=MOST_GESTURES).contains(&gestures.len()) {
            return Err(InvalidGuide::GestureCount(gestures.len()));
        }
        for (place, gesture) in gestures.iter().enumerate() {
            if gestures[..place].contains(gesture) || *gesture == Gesture::REST {
                return Err(InvalidGuide::GestureTwice(*gesture));
            }
        }
        if !(1..=MOST_REPETITIONS).contains(repetitions) {
            return Err(InvalidGuide::Repetitions(*repetitions));
        }
        self.check_times()
    }

    /// Checks the ranges of settings that ask for rest and no gesture.
    ///
    /// # Errors
    ///
    /// The first setting that is out of its range.
    pub fn check_rest_alone(&self) -> Result<(), InvalidGuide> {
        if self.rest_s == 0.0 {
            return Err(InvalidGuide::Seconds { what: REST, seconds: 0.0 });
        }
        self.check_times()
    }

    fn check_times(&self) -> Result<(), InvalidGuide> {
        let GuideSettings { rest_s, hold_s, pause_s, .. } = self;
        let times = [(REST, *rest_s), ("a gesture", *hold_s), ("a pause", *pause_s)];
        let is_wrong = |(what, seconds): &(&str, f64)| {
            let is_left_out = *what == REST && *seconds == 0.0;
            !(is_left_out || (SHORTEST_S..=LONGEST_S).contains(seconds))
        };
        match times.into_iter().find(is_wrong) {
            Some((what, seconds)) => Err(InvalidGuide::Seconds { what, seconds }),
            None => Ok(()),
        }
    }

    /// How long all of it takes, s.
    pub fn duration_s(&self) -> f64 {
        let trials = self.gestures.len() as f64 * f64::from(self.repetitions);
        self.rest_s + trials * (self.pause_s + self.hold_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_repetition_of_the_papers_gestures_takes_less_than_a_minute() {
        let settings = GuideSettings::default();
        settings.check().unwrap();
        assert_eq!(settings.gestures.len(), 5);
        assert_eq!(settings.duration_s(), 50.0);
    }

    #[test]
    fn what_cannot_be_asked_is_named() {
        let fault = |settings: GuideSettings| settings.check().unwrap_err().to_string();
        let default = GuideSettings::default;
        assert!(fault(GuideSettings { gestures: vec![], ..default() }).starts_with("0 gestures"));
        let twice = vec![Gesture::GRIP, Gesture::ULNAR, Gesture::GRIP];
        assert!(fault(GuideSettings { gestures: twice, ..default() }).contains("grip is named twice"));
        let rest = vec![Gesture::REST];
        assert!(fault(GuideSettings { gestures: rest, ..default() }).contains("rest is named twice"));
        assert!(fault(GuideSettings { repetitions: 0, ..default() }).starts_with("0 repetitions"));
        for hold_s in [0.5, f64::NAN, 1000.0] {
            assert!(fault(GuideSettings { hold_s, ..default() }).starts_with("a gesture of "));
        }
        assert!(fault(GuideSettings { pause_s: 0.0, ..default() }).starts_with("a pause of 0 s"));
        GuideSettings { rest_s: 0.0, ..default() }.check().unwrap();
        let rest_alone = GuideSettings { gestures: vec![], ..default() };
        rest_alone.check_rest_alone().unwrap();
        let nothing = GuideSettings { rest_s: 0.0, ..rest_alone }.check_rest_alone().unwrap_err();
        assert!(nothing.to_string().starts_with("rest at the beginning of 0 s"), "{nothing}");
    }
}
