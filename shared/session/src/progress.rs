//! Stages that make no progress though there is something to do.
//!
//! ```text
//! upstream has published 812 ──▶ this stage has taken 790, as a second ago ──▶ Notice::Stuck(Inference, 22)
//! source has published 1000, as two seconds ago, and nobody makes it wait ──▶ Notice::Stuck(Acquisition, _)
//! ```
//!
//! A stage that waits for a wake-up that was lost, or that somebody stopped, shows no other sign of it: it loses nothing
//! and says nothing.

use std::fmt::{self, Display};
use std::time::{Duration, Instant};

use tendon_messages::{STAGE_COUNT, Stage};

/// A source that has published nothing for so long is named where the arm rests: it may be why.
const SOURCE_SILENT_AFTER: Duration = Duration::from_millis(500);
/// A stage whose count has stood still for so long, though messages wait for it, is stuck.
const STUCK_AFTER: Duration = Duration::from_secs(1);
/// The same for the source. Some devices take a while until their first sample.
const SOURCE_STUCK_AFTER: Duration = Duration::from_secs(2);

fn stuck_after(stage: Stage) -> Duration {
    if stage.upstream().is_some() { STUCK_AFTER } else { SOURCE_STUCK_AFTER }
}

/// What to tell the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The stage takes nothing though so many messages wait for it; the source publishes nothing.
    Stuck(Stage, u64),
    /// It does again.
    GoesOn(Stage),
}

impl Display for Notice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Notice::Stuck(stage, waiting) => {
                let (name, time_s) = (stage.name(), stuck_after(*stage).as_secs());
                match stage.upstream() {
                    Some(upstream) => write!(
                        formatter,
                        "{name} makes no progress: it has taken nothing for {time_s} s, and {waiting} messages of {} \
                         wait for it",
                        upstream.name()
                    ),
                    None => write!(
                        formatter,
                        "{name} has published no samples for {time_s} s: is the source connected and switched on, or \
                         does its process hang?"
                    ),
                }
            }
            Notice::GoesOn(stage) if stage.upstream().is_none() => {
                write!(formatter, "{} publishes samples again", stage.name())
            }
            Notice::GoesOn(stage) => write!(formatter, "{} makes progress again", stage.name()),
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    done: u64,
    /// When `done` last changed, or nothing was waiting.
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
    /// Looks at how much a stage has done and how much waits for it: messages that it has taken, those it lost
    /// included, and messages that its upstream has published besides. For the source: messages that it has published,
    /// and 1 if it owes another.
    pub fn observe(&mut self, now: Instant, stage: Stage, done: u64, waiting: u64) -> Option<Notice> {
        let seen = self.seen[stage.index()].get_or_insert(Seen { done, since: now, is_stuck: false });
        if done != seen.done || waiting == 0 {
            let was_stuck = seen.is_stuck;
            *seen = Seen { done, since: now, is_stuck: false };
            return was_stuck.then_some(Notice::GoesOn(stage));
        }
        if seen.is_stuck || now.saturating_duration_since(seen.since) < stuck_after(stage) {
            return None;
        }
        seen.is_stuck = true;
        Some(Notice::Stuck(stage, waiting))
    }

    /// The first stage on the path of a sample that is stuck, and since when, in words; `None` if none is.
    pub fn standstill(&self, now: Instant) -> Option<String> {
        let mut stuck = Stage::ALL.into_iter().filter_map(|stage| {
            let seen = self.seen[stage.index()]?;
            let time = now.saturating_duration_since(seen.since);
            let is_source = stage.upstream().is_none();
            (seen.is_stuck || (is_source && time >= SOURCE_SILENT_AFTER)).then_some((stage, time))
        });
        let (stage, time) = stuck.next()?;
        let time_s = time.as_secs_f64();
        Some(match stage.upstream() {
            Some(_) => format!("{}: no progress for {time_s:.0} s", stage.name()),
            None => format!("{}: no samples for {time_s:.1} s", stage.name()),
        })
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
        assert!((0..50).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, 0).is_none()));
        assert!((50..59).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, tick).is_none()));
        assert_eq!(watch.standstill(at(5900)), None);
        let told = watch.observe(at(6000), Stage::Dsp, 10, 70);
        assert_eq!(told, Some(Notice::Stuck(Stage::Dsp, 70)));
        assert!(Notice::Stuck(Stage::Dsp, 70).to_string().starts_with("dsp makes no progress"));
        // A lossless publisher waits then, and its count stands still, too.
        assert!((61..99).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, 10, 70).is_none()));
        assert_eq!(watch.standstill(at(9900)).unwrap(), "dsp: no progress for 5 s");
        assert_eq!(watch.observe(at(9900), Stage::Dsp, 11, 69), Some(Notice::GoesOn(Stage::Dsp)));
        assert_eq!(watch.standstill(at(9900)), None);
        // One that is slow makes progress all the same.
        assert!((100..200).all(|tick| watch.observe(at(100 * tick), Stage::Dsp, tick / 9, 9000).is_none()));
    }

    #[test]
    fn a_source_that_yields_nothing_is_told_unless_it_is_made_to_wait() {
        let begun = Instant::now();
        let at = |ms: u64| begun + Duration::from_millis(ms);
        let mut watch = ProgressWatch::default();
        assert!((0..50).all(|tick| watch.observe(at(100 * tick), Stage::Acquisition, 0, 0).is_none()));
        assert!((50..69).all(|tick| watch.observe(at(100 * tick), Stage::Acquisition, 0, 1).is_none()));
        // The line of a session names it long before, since the arm rests by then.
        assert_eq!(watch.standstill(at(5300)), None);
        assert_eq!(watch.standstill(at(5400)).unwrap(), "acquisition: no samples for 0.5 s");
        let told = watch.observe(at(7000), Stage::Acquisition, 0, 1).unwrap();
        assert!(told.to_string().starts_with("acquisition has published no samples for 2 s"), "{told}");
        assert_eq!(watch.standstill(at(8000)).unwrap(), "acquisition: no samples for 3.1 s");
        let told = watch.observe(at(8100), Stage::Acquisition, 1, 1);
        assert_eq!(told, Some(Notice::GoesOn(Stage::Acquisition)));
    }
}
