//! A round of cues, live: the source runs, the person follows the cues, what comes is recorded and looked at.
//!
//! ```text
//! acquisition ──blocks──▶ Recorder (file), SignalWatch ──trouble──▶ again?
//!      ▲ gestures of the simulated person       keys ─▶ Guide ──cue──▶ StatusBoard ─▶ terminal
//!      └───────────────────────────────────────────────────┘
//! ```

use std::time::Duration;

use tendon_config::{Config, Source};
use tendon_gesture::Gesture;
use tendon_guide::{Ask, Cue, Guide, SignalWatch, Span, Trial, Trouble};
use tendon_messages::BlockHeader;
use tendon_process::Order;
use tendon_recordings::{RecordedTrial, Recorder, RecorderError};
use tendon_session::{AcquisitionWatch, Heard, Writer};
use tendon_transport::Received;

use super::board::StatusBoard;
use super::in_words::InWords;
use super::status::{CalibrationStatus, May, Phase, asked};
use crate::Failure;

/// Longest time between two looks at keys and blocks: less than their topic holds.
const TICK: Duration = Duration::from_millis(20);
/// How often a trial is done again where nobody is there to be asked.
const TRIES: u32 = 3;
/// Smallest change of effort that the simulated person is told.
const EFFORT_STEP: f64 = 0.02;
/// Level, in multiples of rest, at which the bar of effort is full until somebody has been stronger.
const STRONG_LEVEL: f64 = 5.0;

/// How a round ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoundEnd {
    /// Everything was made.
    Done,
    /// Somebody said stop.
    Stopped,
}

/// Who can be asked.
#[derive(Clone, Copy, Debug)]
pub struct Attendance {
    /// Somebody at the keys.
    pub has_keys: bool,
    /// Somebody at the page.
    pub has_page: bool,
}

impl Attendance {
    /// Whether anybody can be asked.
    fn has_somebody(self) -> bool {
        self.has_keys || self.has_page
    }
}

/// The source that runs, and what is known of its samples.
pub struct Live<'a> {
    acquisition: AcquisitionWatch<'a>,
    watch: SignalWatch,
    errors: &'a Writer,
    board: &'a StatusBoard,
    attendance: Attendance,
    /// Somebody said stop while nothing could be stopped.
    is_to_stop: bool,
    is_simulated: bool,
    /// The sample after the newest one; `None` before the first block.
    next_sample: Option<u64>,
    /// What the simulated person was told last.
    told: (Gesture, f64),
    strongest_level: f64,
    /// Gestures that were recorded though something was wrong with them.
    spoilt: Vec<Gesture>,
}

impl<'a> Live<'a> {
    /// Follows the samples of a source that was started.
    pub fn new(
        acquisition: AcquisitionWatch<'a>,
        config: &Config,
        channels: &[String],
        (errors, board): (&'a Writer, &'a StatusBoard),
        attendance: Attendance,
    ) -> Result<Live<'a>, Failure> {
        let watch = SignalWatch::new(&config.dsp.filter, channels, config.acquisition.sample_rate_hz);
        Ok(Live {
            acquisition,
            watch: watch.map_err(Failure::input)?,
            errors,
            board,
            attendance,
            is_to_stop: false,
            is_simulated: config.acquisition.source == Source::Simulate,
            next_sample: None,
            told: (Gesture::REST, 0.0),
            strongest_level: STRONG_LEVEL,
            spoilt: Vec::new(),
        })
    }

    /// Lets samples go by until the first have come.
    ///
    /// # Errors
    ///
    /// The source ended.
    pub fn wait_for_samples(&mut self) -> Result<RoundEnd, Failure> {
        while self.next_sample.is_none() {
            if self.take(None)? == Heard::Stop {
                return Ok(RoundEnd::Stopped);
            }
        }
        Ok(RoundEnd::Done)
    }

    /// Guides the person through a round and records it. `phase` is what the round is called.
    ///
    /// # Errors
    ///
    /// The source ended, the recording cannot be written, or a trial failed again and again with nobody there to be asked.
    pub fn round(
        &mut self,
        phase: Phase,
        guide: &mut Guide,
        recorder: &mut Recorder,
    ) -> Result<RoundEnd, Failure> {
        self.board.change(|status| status.phase = phase);
        let mut round = Round { guide, recorder, shown: None, aborted: false, asks: false, tries: 0 };
        let mut has_begun = self.attendance.has_somebody();
        while !round.guide.is_over() || round.asks {
            let heard = if self.is_to_stop { Heard::Stop } else { self.take(Some(&mut *round.recorder))? };
            match heard {
                Heard::Stop => {
                    self.tell_simulated(Gesture::REST, 0.0);
                    return Ok(RoundEnd::Stopped);
                }
                Heard::GoOn => round.go_on(),
                Heard::Redo => {
                    // Of one that was broken off, nothing is kept that could be spoilt.
                    if round.asks && !round.aborted {
                        self.spoilt.pop();
                    }
                    round.redo()?;
                }
                Heard::Nothing => {}
            }
            if !round.asks {
                self.board.change(|status| status.trouble = None);
            }
            self.follow(&mut round)?;
            if !has_begun && self.next_sample.is_some() {
                has_begun = true;
                round.guide.go_on();
            }
        }
        self.tell_simulated(Gesture::REST, 0.0);
        Ok(RoundEnd::Done)
    }

    /// Lets samples go by while `work` is done in another thread; gives what came of it. A stop counts after it.
    ///
    /// # Errors
    ///
    /// The source ended.
    pub fn meanwhile<T: Send>(&mut self, work: impl FnOnce() -> T + Send) -> Result<T, Failure> {
        self.board.change(|status| status.rest_in(Phase::Fitting));
        std::thread::scope(|scope| {
            let work = scope.spawn(work);
            while !work.is_finished() {
                self.is_to_stop |= self.take(None)? == Heard::Stop;
            }
            work.join()
                .map_err(|_| Failure::running(anyhow::anyhow!("the fit broke off: please report this")))
        })
    }

    /// Gestures that were recorded though something was wrong with them.
    pub fn spoilt(&self) -> &[Gesture] {
        &self.spoilt
    }

    /// Of each channel, the share of its samples that was clipped.
    pub fn clipped_shares(&self) -> Vec<f64> {
        self.watch.clipped_shares()
    }

    /// Stops the source.
    ///
    /// # Errors
    ///
    /// It had to be killed.
    pub fn stop(self) -> Result<(), Failure> {
        self.acquisition.stop().map_err(Failure::running)
    }

    /// Takes the blocks that have come.
    fn take(&mut self, mut recorder: Option<&mut Recorder>) -> Result<Heard, Failure> {
        let Live { acquisition, watch, next_sample, .. } = self;
        let mut written: Result<(), RecorderError> = Ok(());
        let heard = acquisition.turn(TICK, |block: &Received<BlockHeader, f32>| {
            let header = block.header();
            let expected = next_sample.unwrap_or(header.first_sample);
            watch.push(block.payload(), header.first_sample.saturating_sub(expected));
            if let Some(recorder) = recorder.as_mut().filter(|_| written.is_ok()) {
                written = recorder.push(header.first_sample, block.payload());
            }
            *next_sample = Some(header.first_sample + u64::from(header.samples));
        });
        let flushed = recorder.map_or(Ok(()), Recorder::flush);
        let heard = heard.map_err(Failure::running)?;
        written.and(flushed).map_err(Failure::running)?;
        Ok(heard)
    }

    /// Looks where the guide is after the newest sample.
    fn follow(&mut self, round: &mut Round<'_>) -> Result<(), Failure> {
        let Some(newest_sample) = self.next_sample else { return Ok(()) };
        while let Some(span) = round.guide.advance(newest_sample) {
            self.span_ended(round, span)?;
        }
        let cue = round.guide.cue();
        self.show(round, &cue);
        if round.shown != Some((cue.ask, cue.trial)) {
            round.shown = Some((cue.ask, cue.trial));
            self.watch.begin_trial();
            if let Some(prompt) = self.board.look(CalibrationStatus::prompt) {
                self.errors.say(prompt);
            }
        }
        if cue.ask == Ask::Hold
            && let Some(trouble) = self.watch.trouble_now(cue.trial)
        {
            round.guide.redo();
            round.aborted = true;
            self.trouble(round, cue.trial, &trouble, false)?;
        }
        let (gesture, effort) = round.guide.effort();
        self.tell_simulated(gesture, effort);
        self.show(round, &round.guide.cue());
        self.errors.show(&self.board.look(|status| status.line(self.attendance.has_keys)));
        Ok(())
    }

    /// Labels what was made, if it was.
    fn span_ended(&mut self, round: &mut Round<'_>, span: Span) -> Result<(), Failure> {
        let trouble = self.watch.end_trial(span.trial);
        if !span.ends_trial {
            // A rest between gestures is welcome, but nobody is asked to do it again.
            if trouble.is_none() {
                round.label(span)?;
            }
            return Ok(());
        }
        self.watch.begin_trial();
        let is_labelled = !matches!(trouble, Some(Trouble::Lost { .. } | Trouble::NotNumbers { .. }))
            && round.label(span)?;
        match trouble {
            Some(trouble) => self.trouble(round, span.trial, &trouble, is_labelled),
            None if !is_labelled => {
                self.trouble(round, span.trial, &Trouble::Lost { samples: 0 }, is_labelled)
            }
            None => {
                round.tries = 0;
                Ok(())
            }
        }
    }

    /// Says what went wrong and what can be done. Without anybody to ask, it is done again at once, a few times.
    fn trouble(
        &mut self,
        round: &mut Round<'_>,
        trial: Trial,
        trouble: &Trouble,
        is_labelled: bool,
    ) -> Result<(), Failure> {
        if trial.gesture == Gesture::REST {
            // Another rest may have other electrodes.
            self.watch.forget_rest();
        }
        if self.attendance.has_somebody() {
            if !is_labelled && !round.aborted {
                round.guide.redo();
                round.aborted = true;
            }
            if is_labelled {
                self.spoilt.push(trial.gesture);
            }
            round.guide.wait();
            round.asks = true;
            self.board.change(|status| {
                status.trouble = Some(InWords::of(trouble));
                status.may = round.may();
            });
            if let Some(line) = self.board.look(|status| status.trouble_line(self.attendance.has_keys)) {
                self.errors.say(line);
            }
            return Ok(());
        }
        round.tries += 1;
        if round.tries < TRIES {
            self.errors.say(format!("! {trouble}; once more"));
            if round.aborted {
                round.aborted = false;
            } else {
                round.redo_trial(trial)?;
            }
            round.guide.go_on();
            return Ok(());
        }
        if is_labelled {
            self.errors.say(format!("! {trouble}; kept as it is after {TRIES} tries"));
            self.spoilt.push(trial.gesture);
            round.tries = 0;
            return Ok(());
        }
        Err(Failure::running(anyhow::anyhow!("{trouble}; this went on for {TRIES} tries")))
    }

    fn tell_simulated(&mut self, gesture: Gesture, effort: f64) {
        let (told, told_effort) = self.told;
        if self.is_simulated && (gesture != told || (effort - told_effort).abs() >= EFFORT_STEP) {
            self.acquisition.order(Order::Gesture { gesture, effort: effort as f32 });
            self.told = (gesture, effort);
        }
    }

    /// Keeps the status current.
    fn show(&mut self, round: &Round<'_>, cue: &Cue) {
        let level = self.watch.level();
        self.strongest_level = self.strongest_level.max(level);
        let share = (level - 1.0) / (self.strongest_level - 1.0);
        let (_, asked_effort_share) = round.guide.effort();
        self.board.change(|status| {
            status.follow(cue, share, asked_effort_share);
            status.may = round.may();
        });
    }
}

struct Round<'a> {
    guide: &'a mut Guide,
    recorder: &'a mut Recorder,
    /// What the person has been told.
    shown: Option<(Ask, Trial)>,
    /// The trial that is asked for now was broken off, and waits to be done again.
    aborted: bool,
    /// Something went wrong, and the person has not said yet what to do.
    asks: bool,
    /// How often the trial has failed.
    tries: u32,
}

impl Round<'_> {
    /// Somebody wants the last trial once more.
    fn redo(&mut self) -> Result<(), Failure> {
        if !self.aborted
            && let Some(trial) = self.guide.redo()
        {
            self.unlabel(trial)?;
        }
        self.go_on();
        Ok(())
    }

    fn go_on(&mut self) {
        (self.aborted, self.asks) = (false, false);
        self.guide.go_on();
    }

    /// What somebody can say now.
    fn may(&self) -> Vec<May> {
        let go_on = if self.asks { !self.aborted } else { self.guide.cue().ask == Ask::Wait };
        let redo = self.asks || self.guide.can_redo();
        let may = [(May::GoOn, go_on), (May::Redo, redo), (May::Stop, true)];
        may.into_iter().filter(|(_, is_so)| *is_so).map(|(may, _)| may).collect()
    }

    /// The trial that has just ended is to be done once more.
    fn redo_trial(&mut self, trial: Trial) -> Result<(), Failure> {
        self.guide.redo();
        self.unlabel(trial)
    }

    fn unlabel(&mut self, trial: Trial) -> Result<(), Failure> {
        let is_spoilt =
            |label: &RecordedTrial| (label.gesture, label.repetition) == (trial.gesture, trial.repetition);
        self.recorder.unlabel(is_spoilt).map_err(Failure::running)
    }

    fn label(&mut self, span: Span) -> Result<bool, Failure> {
        let Span { trial: Trial { gesture, repetition }, start_sample, end_sample, .. } = span;
        let asked = asked(gesture).split_once(": ").map_or(String::new(), |(_, how)| how.to_owned());
        let trial = RecordedTrial { gesture, repetition, asked, start_sample, end_sample };
        self.recorder.label(trial).map_err(Failure::running)
    }
}
