//! Stages that make no progress though there is something to do.
//!
//! ```text
//! upstream has published 812 ──▶ this stage has taken 790, as a second ago ──▶ Notice::Stuck("inference", 22)
//! ```
//!
//! A stage that waits for a wake-up that was lost, or that somebody stopped, shows no other sign of it: it loses nothing
//! and says nothing.

use std::fmt::{self, Display};
use std::time::{Duration, Instant};

use tendon_messages::{STAGE_COUNT, Stage};

/// A stage whose count has stood still for so long, though messages wait for it, is stuck.
const STUCK_AFTER: Duration = Duration::from_secs(1);

/// What to tell the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The stage takes nothing though so many messages wait for it.
    Stuck(Stage, u64),
    /// It takes messages again.
    GoesOn(Stage),
}

impl Display for Notice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Notice::Stuck(stage, waiting) => write!(
                formatter,
                "{} makes no progress: it has taken nothing for {} s, and {waiting} messages of {} wait for it",
                stage.name(),
                STUCK_AFTER.as_secs(),
                stage.upstream().map_or("nobody", Stage::name)
            ),
            Notice::GoesOn(stage) => write!(formatter, "{} makes progress again", stage.name()),
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    taken: u64,
    /// When `taken` last changed, or nothing was waiting.
    since: Instant,
    is_stuck: bool,
}

/// Watches the counts of all stages.
#[derive(Debug)]
pub struct ProgressWatch {
    seen: [Option<Seen>; STAGE_COUNT],
}

impl Default for ProgressWatch {
    fn default() -> ProgressWatch {
        ProgressWatch { seen: [None; STAGE_COUNT] }
    }
}

impl ProgressWatch {
    /// Looks at how many messages a stage has taken (those it lost included) of how many its upstream published.
    pub fn observe(&mut self, now: Instant, stage: Stage, taken: u64, published: u64) -> Option<Notice> {
        let seen = self.seen[stage.index()].get_or_insert(Seen { taken, since: now, is_stuck: false });
        let waiting = published.saturating_sub(taken);
        if taken != seen.taken || waiting == 0 {
            let was_stuck = seen.is_stuck;
            *seen = Seen { taken, since: now, is_stuck: false };
            return was_stuck.then_some(Notice::GoesOn(stage));
        }
        if seen.is_stuck || now.saturating_duration_since(seen.since) < STUCK_AFTER {
            return None;
        }
        seen.is_stuck = true;
        Some(Notice::Stuck(stage, waiting))
    }

    /// A stage that is started again begins anew.
    pub fn forget(&mut self, stage: Stage) {
        self.seen[stage.index()] = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_takes_nothing_though_its_input_grows_is_told_once_and_so_is_its_going_on() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let mut watch = ProgressWatch::default();
        // Nothing waits for it: a source that is slow is no stage that is stuck.
        assert!((0..50).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, 10).is_none()));
        assert!((50..59).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, 10 + tick).is_none()));
        let told = watch.observe(at(6000), Stage::Dsp, 10, 80);
        assert_eq!(told, Some(Notice::Stuck(Stage::Dsp, 70)));
        assert!(Notice::Stuck(Stage::Dsp, 70).to_string().starts_with("dsp makes no progress"));
        // A lossless publisher waits then, and its count stands still, too.
        assert!((61..99).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, 80).is_none()));
        assert_eq!(watch.observe(at(9900), Stage::Dsp, 11, 80), Some(Notice::GoesOn(Stage::Dsp)));
        // One that is slow makes progress all the same.
        assert!((100..200).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, tick / 9, 9000).is_none()));
    }
}
