//! What is asked of a person, trial after trial.
//!
//! ```text
//! rest ───────│ pause      3 2 1│ extension: light ╱ firm ╲ light │ pause      3 2 1│ flexion …
//!  span: rest │   span: rest │ ── span: extension ────────────────┘
//! ```
//!
//! A span is what a trial leaves for the labels. That of a gesture begins shortly before its cue, so that the onset of the
//! movement can be found in it. A rest between gestures begins when the muscles are relaxed.

use std::collections::VecDeque;

use serde::Serialize;
use tendon_gesture::Gesture;

use crate::settings::GuideSettings;

/// So long after it was asked for, a rest is one, s; at most a quarter of its time.
const SETTLED_S: f64 = 0.5;
/// So long before its cue the span of a gesture begins, s.
const BEFORE_CUE_S: f64 = 0.5;
/// So long after a gesture the muscles are at rest, s.
const RELAXED_S: f64 = 1.2;
/// Shortest rest between gestures that is worth a label, s.
const SHORTEST_REST_S: f64 = 0.5;
/// Seconds that are counted down.
const COUNTDOWN_S: f64 = 3.0;
/// Share of a firm contraction with which a gesture begins and ends.
const LIGHT: f64 = 0.25;

/// A gesture, or the rest at the beginning, that is asked for once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Trial {
    /// What is asked.
    pub gesture: Gesture,
    /// For the how manieth time, from 0.
    pub repetition: u32,
}

/// Samples in which a gesture was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Which trial it is part of; of a rest between gestures, the repetition of the gesture that follows.
    pub trial: Trial,
    /// Whether it ends the trial: a rest between gestures does not.
    pub ends_trial: bool,
    /// Its first sample.
    pub start_sample: u64,
    /// The first sample after it.
    pub end_sample: u64,
}

/// What the person is asked to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ask {
    /// To wait for the key that lets it go on.
    Wait,
    /// To rest until the trial's gesture.
    Relax,
    /// To make the trial's gesture, rest included.
    Hold,
    /// Nothing any more.
    Nothing,
}

/// What is asked, and for how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cue {
    /// What is asked.
    pub ask: Ask,
    /// The trial that it is about.
    pub trial: Trial,
    /// Left of what is asked, s.
    pub left_s: f64,
    /// Left of everything, s.
    pub all_left_s: f64,
    /// Share of everything that is done, from 0 to 1.
    pub progress: f64,
}

impl Cue {
    /// Seconds to the gesture, if they are counted down now.
    pub fn countdown_s(&self) -> Option<u32> {
        (self.ask == Ask::Relax && self.left_s <= COUNTDOWN_S).then(|| (self.left_s.ceil() as u32).max(1))
    }
}

/// Follows the samples and says what to do.
#[derive(Clone, Debug)]
pub struct Guide {
    settings: GuideSettings,
    sample_rate_hz: f64,
    /// Trials to come, the one that is asked for now first.
    to_do: VecDeque<Trial>,
    phase: Phase,
    /// The newest trial that came to its end.
    last_done: Option<Trial>,
    newest_sample: u64,
    /// How long all trials take that were to do at first, s.
    all_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Waiting,
    Pause { start: u64, end: u64 },
    Hold { start: u64, end: u64 },
}

impl Guide {
    /// Waits for [`Guide::go_on`]. `settings` were checked.
    pub fn new(settings: GuideSettings, sample_rate_hz: f64) -> Guide {
        let rest = Trial { gesture: Gesture::REST, repetition: 0 };
        let mut to_do: VecDeque<Trial> = (settings.rest_s > 0.0).then_some(rest).into_iter().collect();
        for repetition in 0..settings.repetitions {
            to_do.extend(settings.gestures.iter().map(|&gesture| Trial { gesture, repetition }));
        }
        let phase = Phase::Waiting;
        Guide {
            settings,
            sample_rate_hz,
            to_do: VecDeque::new(),
            phase,
            last_done: None,
            newest_sample: 0,
            all_s: 0.0,
        }
        .only(to_do)
    }

    /// Asks for these trials only, in this order; those that were to come are left out.
    pub fn only(mut self, trials: impl IntoIterator<Item = Trial>) -> Guide {
        self.to_do = trials.into_iter().collect();
        self.all_s = self.to_do.iter().map(|&trial| self.trial_s(trial)).sum();
        self
    }

    /// The person is ready: the next trial begins after the newest sample.
    pub fn go_on(&mut self) {
        if self.phase == Phase::Waiting {
            self.begin(self.newest_sample);
        }
    }

    /// Nothing more is asked until [`Guide::go_on`].
    pub fn wait(&mut self) {
        self.phase = Phase::Waiting;
    }

    /// The trial that is asked for now, or ended last, is to be done once more; waits for [`Guide::go_on`]. Returns it;
    /// what was labelled of it does not count any more. `None` before there is one.
    pub fn redo(&mut self) -> Option<Trial> {
        let trial = match self.phase {
            Phase::Hold { .. } => self.to_do.front().copied(),
            Phase::Pause { .. } | Phase::Waiting => self.last_done.take(),
        }?;
        if self.to_do.front() != Some(&trial) {
            self.to_do.push_front(trial);
        }
        self.phase = Phase::Waiting;
        Some(trial)
    }

    /// Whether [`Guide::redo`] finds a trial.
    pub fn can_redo(&self) -> bool {
        matches!(self.phase, Phase::Hold { .. }) || self.last_done.is_some()
    }

    /// Whether nothing is left to do.
    pub fn is_over(&self) -> bool {
        self.to_do.is_empty()
    }

    /// The samples up to `newest_sample` are there. Call it until it gives `None`: each span has just come to its end.
    pub fn advance(&mut self, newest_sample: u64) -> Option<Span> {
        self.newest_sample = self.newest_sample.max(newest_sample);
        let trial = *self.to_do.front()?;
        match self.phase {
            Phase::Pause { start, end } if end <= self.newest_sample => {
                self.phase = Phase::Hold { start: end, end: end + self.samples(self.hold_s(trial)) };
                self.rest_between(trial, start, end).or_else(|| self.advance(newest_sample))
            }
            Phase::Hold { start, end } if end <= self.newest_sample => {
                self.to_do.pop_front();
                self.last_done = Some(trial);
                self.begin(end);
                let start_sample = if trial.gesture == Gesture::REST {
                    start + self.samples(SETTLED_S.min(0.25 * self.hold_s(trial)))
                } else {
                    start.saturating_sub(self.samples(BEFORE_CUE_S))
                };
                Some(Span { trial, ends_trial: true, start_sample, end_sample: end })
            }
            _ => None,
        }
    }

    /// What is asked after the newest sample.
    pub fn cue(&self) -> Cue {
        let Some(&trial) = self.to_do.front() else {
            let trial = self.last_done.unwrap_or(Trial { gesture: Gesture::REST, repetition: 0 });
            return Cue { ask: Ask::Nothing, trial, left_s: 0.0, all_left_s: 0.0, progress: 1.0 };
        };
        let to_s = |end: u64| end.saturating_sub(self.newest_sample) as f64 / self.sample_rate_hz;
        let hold_s = self.hold_s(trial);
        let (ask, left_s, trial_left_s) = match self.phase {
            Phase::Waiting => (Ask::Wait, 0.0, self.trial_s(trial)),
            Phase::Pause { end, .. } => (Ask::Relax, to_s(end), to_s(end) + hold_s),
            Phase::Hold { end, .. } => (Ask::Hold, to_s(end), to_s(end)),
        };
        let later_s: f64 = self.to_do.iter().skip(1).map(|&trial| self.trial_s(trial)).sum();
        let all_left_s = trial_left_s + later_s;
        Cue { ask, trial, left_s, all_left_s, progress: (1.0 - all_left_s / self.all_s).clamp(0.0, 1.0) }
    }

    /// The gesture to be made after the newest sample and its effort, a share of a firm contraction: from light to firm
    /// and back.
    pub fn effort(&self) -> (Gesture, f64) {
        match (self.phase, self.to_do.front()) {
            (Phase::Hold { start, end }, Some(trial)) if trial.gesture != Gesture::REST => {
                let done = self.newest_sample.saturating_sub(start) as f64 / (end - start) as f64;
                let firmness = 1.0 - (2.0 * done.clamp(0.0, 1.0) - 1.0).abs();
                (trial.gesture, LIGHT + (1.0 - LIGHT) * firmness)
            }
            _ => (Gesture::REST, 0.0),
        }
    }

    fn begin(&mut self, start: u64) {
        let pause_s = self.to_do.front().map(|&trial| (trial, self.pause_s(trial)));
        self.phase = match pause_s {
            None => Phase::Waiting,
            Some((trial, 0.0)) => Phase::Hold { start, end: start + self.samples(self.hold_s(trial)) },
            Some((_, pause_s)) => Phase::Pause { start, end: start + self.samples(pause_s) },
        };
    }

    /// The rest of a pause before `trial`, if it is long enough.
    fn rest_between(&self, trial: Trial, start: u64, end: u64) -> Option<Span> {
        let start_sample = start + self.samples(RELAXED_S);
        let end_sample = end.saturating_sub(self.samples(BEFORE_CUE_S));
        let trial = Trial { gesture: Gesture::REST, repetition: trial.repetition };
        (end_sample >= start_sample + self.samples(SHORTEST_REST_S)).then_some(Span {
            trial,
            ends_trial: false,
            start_sample,
            end_sample,
        })
    }

    fn hold_s(&self, trial: Trial) -> f64 {
        if trial.gesture == Gesture::REST { self.settings.rest_s } else { self.settings.hold_s }
    }

    fn pause_s(&self, trial: Trial) -> f64 {
        if trial.gesture == Gesture::REST { 0.0 } else { self.settings.pause_s }
    }

    fn trial_s(&self, trial: Trial) -> f64 {
        self.pause_s(trial) + self.hold_s(trial)
    }

    fn samples(&self, seconds: f64) -> u64 {
        (seconds * self.sample_rate_hz).round() as u64
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const RATE_HZ: f64 = 1000.0;

    fn settings() -> GuideSettings {
        GuideSettings { gestures: vec![Gesture::GRIP, Gesture::ULNAR], repetitions: 2, ..Default::default() }
    }

    /// Follows the guide to its end in steps of `step` samples, and gives all spans.
    fn follow(guide: &mut Guide, mut sample: u64, step: u64) -> (Vec<Span>, u64) {
        let mut spans = Vec::new();
        guide.go_on();
        while !guide.is_over() {
            sample += step;
            while let Some(span) = guide.advance(sample) {
                spans.push(span);
            }
        }
        (spans, sample)
    }

    #[test]
    fn every_gesture_is_asked_for_as_often_as_wanted_with_rest_between() {
        let mut guide = Guide::new(settings(), RATE_HZ);
        let (spans, end) = follow(&mut guide, 0, 10);
        assert_eq!(end, 1000 * 41, "5 s of rest and four times 4 + 5 s");
        let trials: Vec<(Gesture, u32)> = spans
            .iter()
            .filter(|span| span.ends_trial)
            .map(|span| (span.trial.gesture, span.trial.repetition))
            .collect();
        let (rest, grip, ulnar) = (Gesture::REST, Gesture::GRIP, Gesture::ULNAR);
        assert_eq!(trials, [(rest, 0), (grip, 0), (ulnar, 0), (grip, 1), (ulnar, 1)]);
        let span = |number: usize| (spans[number].start_sample, spans[number].end_sample);
        assert_eq!(span(0), (500, 5000));
        assert_eq!((spans[1].trial.gesture, span(1)), (rest, (6200, 8500)));
        assert_eq!((spans[2].trial.gesture, span(2)), (grip, (8500, 14_000)));
    }

    #[test]
    fn cues_count_down_and_say_how_much_is_left() {
        let mut guide = Guide::new(settings(), RATE_HZ);
        assert_eq!(guide.cue().ask, Ask::Wait);
        assert_eq!(guide.cue().all_left_s, 41.0);
        guide.go_on();
        assert_eq!(guide.cue().ask, Ask::Hold);
        assert!(guide.advance(5000).is_some());
        let at = |guide: &mut Guide, sample: u64| {
            while guide.advance(sample).is_some() {}
            guide.cue()
        };
        assert_eq!(at(&mut guide, 5500).countdown_s(), None);
        for (sample, count) in [(6000, 3), (7100, 2), (8999, 1)] {
            assert_eq!(at(&mut guide, sample).countdown_s(), Some(count));
        }
        let cue = at(&mut guide, 11_000);
        assert_eq!((cue.ask, cue.trial.gesture, cue.left_s), (Ask::Hold, Gesture::GRIP, 3.0));
        assert_eq!((cue.all_left_s, cue.countdown_s()), (30.0, None));
        assert!((cue.progress - 11.0 / 41.0).abs() < 1e-12);
        assert_eq!(at(&mut guide, 41_000).ask, Ask::Nothing);
        assert_eq!(guide.cue().progress, 1.0);
    }

    #[test]
    fn effort_goes_from_light_to_firm_and_back() {
        let mut guide = Guide::new(settings(), RATE_HZ);
        guide.go_on();
        assert_eq!(guide.effort(), (Gesture::REST, 0.0));
        let efforts = [7000, 9000, 11_500, 13_999].map(|sample| {
            while guide.advance(sample).is_some() {}
            guide.effort()
        });
        assert_eq!(efforts[0], (Gesture::REST, 0.0));
        assert_eq!(efforts[1], (Gesture::GRIP, 0.25));
        assert_eq!(efforts[2], (Gesture::GRIP, 1.0));
        assert!((efforts[3].1 - 0.25).abs() < 0.001);
    }

    #[test]
    fn a_trial_can_be_done_again_while_it_lasts_and_after_it() {
        let mut guide = Guide::new(settings(), RATE_HZ);
        assert!(!guide.can_redo());
        assert_eq!(guide.redo(), None, "there is nothing to redo yet");
        guide.go_on();
        for sample in [5000, 9000, 10_000] {
            while guide.advance(sample).is_some() {}
        }
        let grip = Trial { gesture: Gesture::GRIP, repetition: 0 };
        assert!(guide.can_redo());
        assert_eq!(guide.redo(), Some(grip), "in the middle of it");
        assert_eq!(guide.advance(60_000), None, "it waits");
        assert_eq!(guide.cue().ask, Ask::Wait);
        guide.go_on();
        while guide.advance(69_000).is_some() {}
        assert_eq!(guide.cue().trial.gesture, Gesture::ULNAR);
        assert_eq!(guide.redo(), Some(grip), "in the pause after it");
        let (spans, _) = follow(&mut guide, 70_000, 10);
        assert_eq!(spans.iter().filter(|span| span.ends_trial).count(), 4);
        assert!(guide.is_over());
        assert_eq!(guide.redo().map(|trial| trial.repetition), Some(1), "the very last one, too");
        assert!(!guide.is_over());
    }

    proptest! {
        #[test]
        fn spans_follow_one_another_however_the_samples_come(step in 1_u64..9000) {
            let mut guide = Guide::new(settings(), RATE_HZ);
            let (spans, _) = follow(&mut guide, 0, step);
            let mut exact = Guide::new(settings(), RATE_HZ);
            prop_assert_eq!(&spans, &follow(&mut exact, 0, 1).0);
            for pair in spans.windows(2) {
                prop_assert!(pair[0].end_sample <= pair[1].start_sample);
            }
        }
    }
}
