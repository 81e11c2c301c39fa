//! What time stamps say: how far one sample lies from the next, and what of that can be.
//!
//! ```text
//! 0.0  0.5  1.0  1.5 | 4.0  4.5   ms       exact: every step is a whole number of samples, and 2.5 ms are four lost ones
//! 0.0  0.5  1.0  1.5 | 902.0  902.5        none of our time has passed: it contradicts those before, until 0.2 s agree
//! ```
//!
//! A stamp that contradicts those before it (it lies before them, or after all time that has passed) says nothing about loss or
//! the sender's clock. Once the stamps agree with one another for a while, the clock has leapt and is measured anew.

/// How far from whole numbers of samples the steps of exact stamps lie.
const EXACT: f64 = 0.2;
/// So long without another step, stamps count as exact, s.
const EXACT_AFTER_S: f64 = 1.0;
/// Where stamps jitter, leaps from here on are lost samples, s.
const ROUGH_GAP_S: f64 = 0.05;
/// A stamp further ahead of us than this is none of LSL's clock, s.
const FUTURE_S: f64 = 0.05;
/// A leap of the stamps beyond the time that has passed here, s, is one of the sender's clock and no loss.
const CLOCK_LEAP_S: f64 = 0.5;
/// So long, stamps that contradict those before agree with one another until they are believed, s.
const SETTLED_S: f64 = 0.2;

/// What was odd about time stamps, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Oddities {
    /// Stamps that were that of the sample before.
    pub repeated: u64,
    /// Stamps before that of the sample before, by more than chunks overlap that are stamped when they are sent.
    pub backwards: u64,
    /// Leaps of the sender's clock.
    pub leaps: u64,
    /// Stamps that lay in the future, or were no numbers.
    pub impossible: u64,
}

/// When a frame came, and how its stamps are understood.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Whether it is the first one of another connection.
    pub is_new_connection: bool,
    /// Is added to the stamps to have them on our clock, s.
    pub correction_s: f64,
    /// CLOCK_MONOTONIC ns.
    pub received_ns: u64,
}

/// How a sample follows the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Step {
    /// How many samples are missing before it.
    pub lost: u64,
    /// Whether the sender's clock has leapt, and is to be measured anew.
    pub begins_clock: bool,
}

/// What the newest stamp says by our clock.
#[derive(Clone, Copy, Debug)]
pub struct Newest {
    /// How long before its arrival it was stamped, s.
    pub age_s: f64,
    /// Whether it lies in the future, where only the arrival is known.
    pub is_future: bool,
    /// When the sample was captured, as far as the stamp tells, CLOCK_MONOTONIC ns: not after its arrival.
    pub captured_ns: u64,
}

/// Follows the stamps of one stream.
#[derive(Clone, Debug)]
pub struct Stamps {
    sample_rate_hz: f64,
    last: Option<Last>,
    /// Steps since the last one that was not exact. Stamps count as exact until they show that they are not.
    exact_steps: f64,
    /// Samples in a row whose stamps contradict those before and agree with one another.
    contradicting: f64,
    oddities: Oddities,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    stamp_s: f64,
    /// What its stamp should be: the stamp itself, unless it contradicts those before.
    credible_s: f64,
    correction_s: f64,
    received_ns: u64,
}

impl Last {
    /// When it was captured by our clock, as far as it is known, s.
    fn credible_here_s(&self) -> f64 {
        self.credible_s + self.correction_s
    }
}

impl Stamps {
    /// For a stream of this nominal rate.
    pub fn new(sample_rate_hz: f64) -> Stamps {
        Stamps {
            sample_rate_hz,
            last: None,
            exact_steps: EXACT_AFTER_S * sample_rate_hz,
            contradicting: 0.0,
            oddities: Oddities::default(),
        }
    }

    /// What was odd so far.
    pub fn oddities(&self) -> Oddities {
        self.oddities
    }

    /// The stream was lost and is back, with this stamp: by our clock, so many samples are missing.
    pub fn reconnect(&mut self, first_s: Option<f64>, arrival: Arrival) -> u64 {
        let mut lost = 0;
        if let (Some(last), Some(first_s)) = (self.last, first_s) {
            let here_s = arrival.received_ns.saturating_sub(last.received_ns) as f64 * 1e-9;
            let away_s = first_s + arrival.correction_s - last.credible_here_s();
            let is_possible = (0.0..=here_s + CLOCK_LEAP_S).contains(&away_s);
            let samples = (if is_possible { away_s } else { here_s }) * self.sample_rate_hz;
            lost = (samples.round() as u64).saturating_sub(1);
        }
        self.last = None;
        self.exact_steps = EXACT_AFTER_S * self.sample_rate_hz;
        self.contradicting = 0.0;
        lost
    }

    /// Takes the stamp of the next sample.
    pub fn take(&mut self, stamp_s: f64, arrival: Arrival) -> Step {
        let Arrival { correction_s, received_ns, .. } = arrival;
        let period_s = 1.0 / self.sample_rate_hz;
        self.oddities.impossible += u64::from(!stamp_s.is_finite());
        let Some(last) = self.last else {
            let now_s = received_ns as f64 * 1e-9 - correction_s;
            let stamp_s = if stamp_s.is_finite() { stamp_s } else { now_s };
            self.last = Some(Last { stamp_s, credible_s: stamp_s, correction_s, received_ns });
            return Step::default();
        };
        let mut next = Last {
            stamp_s: if stamp_s.is_finite() { stamp_s } else { last.stamp_s + period_s },
            credible_s: last.credible_s + period_s,
            correction_s,
            received_ns,
        };
        let mut step = Step::default();
        if stamp_s.is_finite() {
            let longest_s = longest_step_s(&last, received_ns);
            let step_s = stamp_s - last.stamp_s;
            let was_exact = self.is_exact();
            self.count_oddities(step_s, longest_s);
            let is_whole = self.is_whole(step_s);
            self.exact_steps = if is_whole { self.exact_steps + 1.0 } else { 0.0 };
            let away_s = stamp_s - last.credible_s;
            if (-ROUGH_GAP_S..=longest_s).contains(&away_s) {
                self.contradicting = 0.0;
                next.credible_s = stamp_s;
                if (was_exact && self.is_whole(away_s)) || away_s > ROUGH_GAP_S {
                    step.lost = ((away_s * self.sample_rate_hz).round() as u64).saturating_sub(1);
                }
            } else {
                let agrees = step_s.abs() <= ROUGH_GAP_S;
                self.contradicting = if agrees { self.contradicting + 1.0 } else { 1.0 };
                if self.contradicting >= SETTLED_S * self.sample_rate_hz {
                    next.credible_s = stamp_s;
                    self.contradicting = 0.0;
                    step.begins_clock = true;
                }
            }
        }
        self.last = Some(next);
        step
    }

    fn count_oddities(&mut self, step_s: f64, longest_s: f64) {
        // Chunks that are stamped when they are sent overlap by less than their length.
        let chunk_s = if self.is_exact() { 0.0 } else { self.exact_steps / self.sample_rate_hz };
        if step_s == 0.0 {
            self.oddities.repeated += 1;
        } else if step_s < -0.5 / self.sample_rate_hz - chunk_s {
            self.oddities.backwards += 1;
        } else if step_s > longest_s {
            self.oddities.leaps += 1;
        }
    }

    /// Whether stamps have been exact for so long that they count as counted.
    pub fn is_exact(&self) -> bool {
        self.exact_steps >= EXACT_AFTER_S * self.sample_rate_hz
    }

    /// Whether a step is a whole number of samples.
    fn is_whole(&self, step_s: f64) -> bool {
        let step = step_s * self.sample_rate_hz;
        (step - step.round()).abs() <= EXACT && step.round() >= 1.0
    }

    /// Whether the newest stamp contradicts those before it.
    pub fn is_contradicting(&self) -> bool {
        self.contradicting > 0.0
    }

    /// What the newest stamp says, which came at `received_ns`.
    pub fn newest(&mut self, received_ns: u64) -> Newest {
        let stamp_s = self.last.map_or(0.0, |last| last.stamp_s + last.correction_s);
        let age_s = received_ns as f64 * 1e-9 - stamp_s;
        let is_future = age_s < -FUTURE_S;
        self.oddities.impossible += u64::from(is_future);
        // One before our clock began is as old as can be.
        let stamp_ns = if is_future { received_ns } else { (stamp_s.max(0.0) * 1e9) as u64 };
        Newest { age_s, is_future, captured_ns: stamp_ns.min(received_ns) }
    }
}

/// The longest step from the last sample that can be a loss, s: beyond it, the sender's clock has leapt.
fn longest_step_s(last: &Last, received_ns: u64) -> f64 {
    let here_s = received_ns.saturating_sub(last.received_ns) as f64 * 1e-9;
    let late_s = last.received_ns as f64 * 1e-9 - last.credible_here_s();
    here_s + late_s.clamp(0.0, CLOCK_LEAP_S) + FUTURE_S
}
