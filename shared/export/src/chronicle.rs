//! What happened in a session, on the axis of its samples: cues, trials, stops and their reasons, notes.
//!
//! ```text
//! cue ── waits for its block, as there may be a gap between ──▶ cue event; the trial before has ended
//! state ── permission or reason is another than before ───────▶ arm event
//! event ──────────────────────────────────────────────────────▶ session, note or recording event
//! ```

use tendon_messages::{PermissionChanges, Stage};
use tendon_session_file::{Block, Cue, Event, EventKind, StateRecord};

use crate::{Placed, Survey, Timeline};

/// What is said of a cue after which nothing is asked for. No gesture has such a name, as it has a space.
const IS_OVER: &str = "is over";

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Happening {
    /// When, s.
    pub(crate) at_s: f64,
    /// `session`, `note`, `recording`, `cue` or `arm`.
    pub(crate) kind: &'static str,
    /// What was said; of a cue, the gesture, or [`IS_OVER`].
    pub(crate) text: String,
}

/// A gesture that was asked for, and until when.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Trial {
    pub(crate) start_s: f64,
    pub(crate) end_s: f64,
    pub(crate) gesture: String,
    /// Its first sample and that after its last, counted over the recorded ones.
    pub(crate) start_row: u64,
    pub(crate) end_row: u64,
}

/// What a block brought.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Taken {
    pub(crate) placed: Placed,
    pub(crate) cue: Option<Happening>,
    /// The trial that ended.
    pub(crate) ended: Option<Trial>,
}

/// Follows a session from its first message on.
#[derive(Debug)]
pub(crate) struct Chronicle {
    pub(crate) timeline: Timeline,
    sample_rate_hz: f64,
    /// A cue whose block has not come yet.
    cue: Option<Cue>,
    /// The gesture that is asked for; its end is not known yet.
    trial: Option<Trial>,
    permission: PermissionChanges,
}

impl Chronicle {
    pub(crate) fn new(survey: &Survey) -> Chronicle {
        let sample_rate_hz = survey.sample_rate_hz;
        let timeline = Timeline::new(sample_rate_hz, survey.begun_ns);
        Chronicle {
            timeline,
            sample_rate_hz,
            cue: None,
            trial: None,
            permission: PermissionChanges::default(),
        }
    }

    pub(crate) fn block(&mut self, block: &Block) -> Taken {
        let before = (self.timeline.end_s(), self.timeline.rows());
        let placed = self.timeline.take(block);
        let (mut cue, mut ended) = (None, None);
        // The end of a simulated gesture is known before it comes: the cue waits for its block.
        let end_sample = block.first_sample.saturating_add(u64::from(block.samples));
        if let Some(Cue { since_sample, gesture, .. }) = self.cue.take_if(|cue| cue.since_sample < end_sample)
        {
            let sample = since_sample.saturating_sub(block.first_sample);
            let start = (placed.start_s + sample as f64 / self.sample_rate_hz, placed.row + sample);
            // What ends with a block ends before the gap behind it.
            ended = self.end_trial(if sample == 0 { before } else { start });
            if let Some(gesture) = gesture {
                let ((start_s, start_row), text) = (start, gesture.clone());
                cue = Some(Happening { at_s: start_s, kind: "cue", text });
                self.trial = Some(Trial { start_s, end_s: start_s, gesture, start_row, end_row: start_row });
            } else if let Some(Trial { end_s, .. }) = ended {
                cue = Some(Happening { at_s: end_s, kind: "cue", text: IS_OVER.to_owned() });
            }
        }
        Taken { placed, cue, ended }
    }

    /// A cue comes before the block that says so.
    pub(crate) fn cue(&mut self, cue: &Cue) {
        self.cue = Some(cue.clone());
    }

    pub(crate) fn event(&self, event: &Event) -> Happening {
        let kind = match event.kind {
            EventKind::Session => "session",
            EventKind::Note => "note",
            EventKind::Recording => "recording",
        };
        Happening { at_s: self.timeline.clock_s(event.at_ns), kind, text: event.text.clone() }
    }

    /// When a state was published, s.
    pub(crate) fn state_s(&self, state: &StateRecord) -> f64 {
        self.timeline.clock_s(state.trace.published_ns[Stage::Robot.index()])
    }

    /// Whether the arm may move, where that changed.
    pub(crate) fn state(&mut self, state: &StateRecord) -> Option<Happening> {
        let text = self.permission.said(state.permission, state.stop_reason)?;
        Some(Happening { at_s: self.state_s(state), kind: "arm", text })
    }

    /// The trial that the recording's end has ended.
    pub(crate) fn finish(&mut self) -> Option<Trial> {
        self.end_trial((self.timeline.end_s(), self.timeline.rows()))
    }

    fn end_trial(&mut self, (end_s, end_row): (f64, u64)) -> Option<Trial> {
        let trial = self.trial.take()?;
        (end_row > trial.start_row).then_some(Trial { end_s, end_row, ..trial })
    }
}
