//! How a guided calibration stands: what the person is asked, how strong they are, what is wrong, what was learnt.
//!
//! ```text
//! cue, level, trouble ─▶ CalibrationStatus ─┬─▶ line, trouble_line   terminal
//! phase, report, error ─▶                   └─▶ JSON                 page
//! ```

use serde::Serialize;
use tendon_gesture::Gesture;
use tendon_guide::{Ask, Cue, Trouble};
use tendon_people::PersonName;

use super::in_words::InWords;
use super::learnt::PageReport;

/// Width of a bar, in characters.
const BAR_WIDTH: usize = 20;

/// How far a calibration has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// The person follows cues.
    Cues,
    /// The person is being fitted, or a check round scored.
    Fitting,
    /// The person follows the cues of the check round.
    Check,
    /// It is over, and the person is kept.
    Done,
    /// It broke off.
    Failed,
    /// Somebody said stop.
    Stopped,
}

impl Phase {
    /// Whether nothing more comes of it.
    pub fn is_over(self) -> bool {
        matches!(self, Phase::Done | Phase::Failed | Phase::Stopped)
    }
}

/// What somebody at the keys or the page can say now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum May {
    /// Let it go on.
    GoOn,
    /// The trial once more.
    Redo,
    /// End it.
    Stop,
}

/// A calibration as it is now. Shares are from 0 to 1.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationStatus {
    /// Whom it is of.
    pub name: PersonName,
    /// How far it has come.
    pub phase: Phase,
    /// What the person is asked.
    pub ask: Ask,
    /// The gesture that it is about: the one that is made now or comes next.
    pub gesture: Gesture,
    /// For the how manieth time it is asked for, from 1.
    pub repetition: u32,
    /// How often each is asked for.
    pub repetitions: u32,
    /// Seconds to the gesture, while they are counted down.
    pub countdown_s: Option<u32>,
    /// Left of what is asked, s.
    pub left_s: f64,
    /// How strong the muscles are, as a share of the strongest so far.
    pub effort_share: f64,
    /// How strong they are asked to be, as a share of firm.
    pub asked_effort_share: f64,
    /// Share of the round that is done.
    pub progress: f64,
    /// Left of the round, s.
    pub all_left_s: f64,
    /// What is wrong and waits for an answer.
    pub trouble: Option<InWords<Trouble>>,
    /// What can be said now.
    pub may: Vec<May>,
    /// What was learnt, once it is.
    pub report: Option<PageReport>,
    /// Why it failed, and what to do.
    pub error: Option<String>,
}

impl CalibrationStatus {
    /// Of a calibration that has not begun.
    pub fn new(name: PersonName, repetitions: u32) -> CalibrationStatus {
        CalibrationStatus {
            name,
            phase: Phase::Cues,
            ask: Ask::Wait,
            gesture: Gesture::REST,
            repetition: 1,
            repetitions,
            countdown_s: None,
            left_s: 0.0,
            effort_share: 0.0,
            asked_effort_share: 0.0,
            progress: 0.0,
            all_left_s: 0.0,
            trouble: None,
            may: vec![May::Stop],
            report: None,
            error: None,
        }
    }

    /// Takes what is asked now, and how strong the muscles are and are asked to be.
    pub fn follow(&mut self, cue: &Cue, effort_share: f64, asked_effort_share: f64) {
        self.ask = cue.ask;
        self.gesture = cue.trial.gesture;
        self.repetition = cue.trial.repetition + 1;
        self.countdown_s = cue.countdown_s();
        self.left_s = cue.left_s;
        self.all_left_s = cue.all_left_s;
        self.progress = cue.progress;
        // It is below 0 before rest was measured, and no number while the samples are none.
        self.effort_share = if effort_share.is_nan() { 0.0 } else { effort_share.clamp(0.0, 1.0) };
        self.asked_effort_share = asked_effort_share;
    }

    /// Enters a phase in which nobody is asked anything.
    pub fn rest_in(&mut self, phase: Phase) {
        self.phase = phase;
        self.ask = Ask::Nothing;
        self.countdown_s = None;
        (self.left_s, self.asked_effort_share) = (0.0, 0.0);
        self.trouble = None;
        self.may.clear();
    }

    /// The terminal's line that follows the person. `has_keys` says whether somebody is at its keys.
    pub fn line(&self, has_keys: bool) -> String {
        let gesture = self.gesture;
        let what = match (self.ask, self.countdown_s) {
            (Ask::Wait, _) if has_keys => format!("Enter when you are ready; next: {gesture}"),
            (Ask::Wait | Ask::Nothing, _) => String::new(),
            (Ask::Relax, Some(seconds)) => format!("{gesture} in {seconds}"),
            (Ask::Relax, None) => "relax".to_owned(),
            (Ask::Hold, _) => format!("{} {:.1} s", gesture.name().to_uppercase(), self.left_s),
        };
        let left_s = self.all_left_s.ceil() as u64;
        format!(
            "{what:<26} {} {:>3.0} % done, {}:{:02} left",
            bar(self.effort_share),
            100.0 * self.progress,
            left_s / 60,
            left_s % 60
        )
    }

    /// What the terminal says once of what is asked now; nothing where the line says it.
    pub fn prompt(&self) -> Option<String> {
        match self.ask {
            Ask::Wait | Ask::Nothing => None,
            Ask::Relax => Some(format!("relax; next: {}", self.gesture)),
            Ask::Hold => Some(asked(self.gesture)),
        }
    }

    /// What the terminal says of the trouble that waits for an answer. `has_keys` as in [`CalibrationStatus::line`].
    pub fn trouble_line(&self, has_keys: bool) -> Option<String> {
        let trouble = self.trouble.as_ref()?;
        let answers = match (has_keys, self.may.contains(&May::GoOn)) {
            (false, _) => "the page asks what to do",
            (true, true) => "r: again, Enter: keep it as it is, q: stop",
            (true, false) => "Enter: again, q: stop",
        };
        Some(format!("! {}\n  {answers}", trouble.text))
    }
}

/// What is asked of a gesture, in words.
pub fn asked(gesture: Gesture) -> String {
    if gesture == Gesture::REST {
        return "rest: lay the arm down and relax".to_owned();
    }
    format!("{gesture}: from light to firm and back")
}

fn bar(share: f64) -> String {
    let full = (share.clamp(0.0, 1.0) * BAR_WIDTH as f64).round() as usize;
    format!("[{}{}]", "#".repeat(full), ".".repeat(BAR_WIDTH - full))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_guide::Trial;
    use tendon_people::Finding;

    fn status() -> CalibrationStatus {
        CalibrationStatus::new("anna".parse().unwrap(), 2)
    }

    fn cue(ask: Ask, left_s: f64) -> Cue {
        let trial = Trial { gesture: Gesture::GRIP, repetition: 1 };
        Cue { ask, trial, left_s, all_left_s: 70.2, progress: 0.25 }
    }

    #[test]
    fn a_bar_is_between_empty_and_full() {
        assert_eq!(bar(-1.0), "[....................]");
        assert_eq!(bar(0.5), "[##########..........]");
        assert_eq!(bar(7.0), "[####################]");
        assert_eq!(bar(f64::NAN), "[....................]");
    }

    #[test]
    fn a_gesture_is_asked_from_light_to_firm_and_rest_is_not() {
        assert_eq!(asked(Gesture::GRIP), "grip: from light to firm and back");
        assert!(!asked(Gesture::REST).contains("firm"));
    }

    #[test]
    fn the_terminals_line_says_what_is_asked_how_strong_one_is_and_what_is_left() {
        let mut status = status();
        let line = |status: &CalibrationStatus| status.line(true);
        status.follow(&cue(Ask::Wait, 0.0), -0.25, 0.0);
        assert!(line(&status).starts_with("Enter when you are ready; next: grip [.."), "{}", line(&status));
        assert_eq!(status.prompt(), None);
        assert!(status.line(false).starts_with("   "));
        status.follow(&cue(Ask::Relax, 2.4), 0.0, 0.0);
        assert!(line(&status).starts_with("grip in 3 "), "{}", line(&status));
        status.follow(&cue(Ask::Hold, 1.2), 0.5, 1.0);
        assert_eq!(
            line(&status),
            format!("{:<26} [##########..........]  25 % done, 1:11 left", "GRIP 1.2 s")
        );
        assert_eq!(status.prompt().unwrap(), "grip: from light to firm and back");
    }

    #[test]
    fn trouble_is_said_with_what_can_be_answered() {
        let mut status = status();
        assert_eq!(status.trouble_line(true), None);
        status.trouble = Some(InWords::of(&Trouble::NoRest));
        status.may = vec![May::Redo, May::Stop];
        let line = status.trouble_line(true).unwrap();
        assert!(
            line.starts_with("! the muscles were tense") && line.ends_with("\n  Enter: again, q: stop"),
            "{line}"
        );
        status.may = vec![May::GoOn, May::Redo, May::Stop];
        assert!(status.trouble_line(true).unwrap().contains("keep it as it is"));
        assert!(status.trouble_line(false).unwrap().ends_with("the page asks what to do"));
    }

    #[test]
    fn the_page_reads_words_and_nothing_for_what_is_not_known() {
        let mut status = status();
        status.follow(&cue(Ask::Relax, 2.4), 0.0, 0.0);
        status.may = vec![May::GoOn];
        let json = serde_json::to_value(&status).unwrap();
        let expected = serde_json::json!({
            "name": "anna", "phase": "cues", "ask": "relax", "gesture": "grip", "repetition": 2, "repetitions": 2,
            "countdown_s": 3, "left_s": 2.4, "effort_share": 0.0, "asked_effort_share": 0.0, "progress": 0.25,
            "all_left_s": 70.2, "trouble": null, "may": ["go-on"], "report": null, "error": null,
        });
        assert_eq!(json, expected);
        status.trouble = Some(InWords::of(&Trouble::Lost { samples: 40 }));
        let trouble = &serde_json::to_value(&status).unwrap()["trouble"];
        assert_eq!((&trouble["kind"], &trouble["samples"]), (&"lost".into(), &40.into()));
        let not_made = Trouble::Signal(Finding::NotMade { gesture: Gesture::GRIP });
        status.trouble = Some(InWords::of(&not_made));
        let trouble = &serde_json::to_value(&status).unwrap()["trouble"];
        assert_eq!((&trouble["kind"], &trouble["gesture"]), (&"not_made".into(), &"grip".into()));
        assert!(trouble["text"].as_str().unwrap().starts_with("grip looks like rest"), "{trouble}");
        status.rest_in(Phase::Fitting);
        assert_eq!((status.ask, status.may.len(), status.countdown_s), (Ask::Nothing, 0, None));
    }
}
