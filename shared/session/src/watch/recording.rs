//! The recording of a session that is watched.
//!
//! ```text
//! plan_recording ─▶ recorder from the start ─┐
//! key w, request ─▶ record ──────────────────┴▶ hear_recorder ─▶ recording_ended ─▶ recordings
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use tendon_process::{Answer, with_causes};
use tendon_session_file::{RecordingReport, Said, Told};
use tendon_transport::Leftovers;

use super::Watch;
use crate::children::ChildrenError;
use crate::failure::SessionFailure;
use crate::recorder::{Heard, Recorder, RecordingPlan};

impl Watch<'_> {
    /// Lets the session be recorded as `plan` says.
    ///
    /// # Errors
    ///
    /// [`ChildrenError::Start`] when the recorder cannot be started at once.
    pub fn plan_recording(&mut self, plan: RecordingPlan) -> Result<(), ChildrenError> {
        if plan.folder.is_some() {
            self.recorder = Some(self.children.start_recorder(&plan)?);
        }
        self.plan = Some(plan);
        Ok(())
    }

    /// Whether the session is to be recorded from its beginning and the recorder is not ready.
    pub(super) fn is_recorder_missing(&self) -> bool {
        let is_wanted = self.plan.as_ref().is_some_and(|plan| plan.folder.is_some());
        is_wanted && self.recorder.as_ref().is_none_or(|recorder| recorder.path().is_none())
    }

    /// Begins or ends a recording.
    pub fn record(&mut self, is_wanted: bool) -> Answer {
        match (&mut self.recorder, is_wanted) {
            (Some(recorder), _) if recorder.is_finishing() => {
                Answer::refused("the recording is being finished: ask again in a moment")
                    .with_key("recording-finishing")
            }
            (Some(_), true) => Answer::done("it is being recorded already"),
            (Some(recorder), false) => {
                recorder.let_finish();
                Answer::done("the recording ends")
            }
            (None, false) => Answer::done("nothing is being recorded"),
            (None, true) => self.begin_recording(),
        }
    }

    fn begin_recording(&mut self) -> Answer {
        let Some(plan) = &self.plan else {
            return Answer::refused("this session cannot be recorded").with_key("recording-impossible");
        };
        self.recording_failure = None;
        match self.children.start_recorder(plan) {
            Ok(recorder) => {
                self.recorder = Some(recorder);
                self.tell_recorder_of_the_stages();
                Answer::done("the recording begins")
            }
            Err(error) => {
                let why_not = with_causes(&error);
                let text = format!("the recording cannot begin: {why_not}");
                self.recording_failure = Some(why_not);
                self.note(text.clone());
                Answer::refused(text)
            }
        }
    }

    /// The file that the session is being recorded to.
    pub fn recording(&self) -> Option<&Path> {
        self.recorder.as_ref().filter(|recorder| !recorder.is_finishing()).and_then(Recorder::path)
    }

    /// Why the last recording broke off or could not begin, if it did.
    pub fn recording_failure(&self) -> Option<&str> {
        self.recording_failure.as_deref()
    }

    /// Tells the recorder what the stages said when they were ready.
    pub(super) fn tell_recorder_of_the_stages(&mut self) {
        let Some(recorder) = &mut self.recorder else { return };
        let stages = self.ready.iter().map(|(stage, ready)| (stage.name(), ready));
        // A Ready is made of texts and lists of them.
        if let Ok(stages) = serde_json::to_value(stages.collect::<BTreeMap<_, _>>()) {
            recorder.tell(&Told::Ready(stages));
        }
    }

    /// Takes what the recorder said.
    pub(super) fn hear_recorder(&mut self) -> Result<(), SessionFailure> {
        while let Some(heard) = self.recorder.as_mut().and_then(Recorder::take_heard) {
            match heard {
                Heard::Said(Said::Ready(path)) => {
                    self.standard_error.say(format!("tendon: recording to {}", path.display()));
                }
                Heard::Said(Said::Ended(_)) => {}
                Heard::Closed => {
                    let Some(recorder) = self.recorder.take() else { return Ok(()) };
                    let was_missing = recorder.path().is_none() && !self.has_begun();
                    let (status, last_words) = self.recording_ended(recorder);
                    // Its ports are in nobody's way any more.
                    Leftovers::remove_of_the_dead(&self.config.session);
                    if was_missing {
                        return Err(SessionFailure::RecorderEnded { status, last_words });
                    }
                }
            }
        }
        Ok(())
    }

    /// Keeps what came of a recording, and says so; gives how the recorder ended and its last words.
    pub(super) fn recording_ended(&mut self, recorder: Recorder) -> (String, String) {
        let was_asked = recorder.is_finishing();
        let (report, status, last_words) = recorder.end();
        let status = status.map_or_else(|| "gone".to_owned(), |status| status.to_string());
        if let Some(report) = report {
            self.recording_failure = report.error.clone();
            match &report.error {
                // Its own reason says so where the file is gone.
                Some(error) if !report.path.exists() => {
                    self.note(format!("the recording has stopped: {error}; the session goes on"));
                }
                Some(error) => self.note(format!(
                    "the recording has stopped: {error}; the session goes on. {} holds what was written until then",
                    report.path.display()
                )),
                None if was_asked => {
                    self.standard_error.say(format!("tendon: recorded to {}", report.path.display()));
                }
                None => {}
            }
            self.recordings.push(report);
        } else if self.has_begun() {
            self.note(format!("the recording could not begin ({status}); the session goes on"));
            let why_not = last_words.lines().last().map(|line| line.rsplit("error: ").next().unwrap_or(line));
            self.recording_failure = Some(why_not.map_or_else(|| status.clone(), str::to_owned));
        }
        (status, last_words)
    }

    /// Keeps in the recording how the task of the session went. Call it before [`Watch::stop`].
    pub fn keep_task(&mut self, report: serde_json::Value) {
        if let Some(recorder) = &mut self.recorder {
            recorder.tell_last(&Told::Task(report));
        }
    }

    /// What came of the recordings so far.
    pub fn recordings(&self) -> &[RecordingReport] {
        &self.recordings
    }
}
