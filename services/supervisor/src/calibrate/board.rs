//! The status of a calibration where others see it, and what they ask of it.
//!
//! ```text
//! round ─▶ StatusBoard ─▶ RequestSocket ──status──▶ page
//! page ──request──▶ RequestSocket ─▶ can that be said now? ─▶ Event::Request ─▶ round, or what follows it
//!      ◀─ refusal ────────────────────┘
//! ```

use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tendon_config::Config;
use tendon_process::{Answer, Asked, CalibrationRequest, Request, RequestError, RequestSocket};
use tendon_session::Event;

use super::status::{CalibrationStatus, May};
use crate::desk::{Desk, DeskKind};

/// The status that the calibration keeps current and others look at.
#[derive(Debug)]
pub struct StatusBoard {
    status: Arc<Mutex<CalibrationStatus>>,
    desk: Mutex<Desk>,
    socket: RequestSocket,
}

impl StatusBoard {
    /// Shows `status` to whoever asks the session of this configuration. What is asked for, and can be now, comes as `events`.
    ///
    /// # Errors
    ///
    /// [`RequestError`] when the socket cannot be had.
    pub fn open(
        status: CalibrationStatus,
        config: &Config,
        events: &Sender<Event>,
    ) -> Result<StatusBoard, RequestError> {
        let mut desk = Desk::new(DeskKind::Calibration, config);
        desk.calibration = Some(status.clone());
        let status = Arc::new(Mutex::new(status));
        let (seen, events) = (status.clone(), events.clone());
        let on_request = move |asked: Asked| {
            let refusal = refusal(&asked.request, &lock(&seen));
            match refusal {
                Some(refusal) => asked.answer(&refusal),
                // Once nobody listens any more the request is dropped, which says so.
                None => drop(events.send(Event::Request(asked))),
            }
        };
        let socket = RequestSocket::listen(&config.session, desk.text(), on_request)?;
        Ok(StatusBoard { status, desk: Mutex::new(desk), socket })
    }

    /// Changes the status and shows it.
    pub fn change(&self, change: impl FnOnce(&mut CalibrationStatus)) {
        let mut status = lock(&self.status);
        change(&mut status);
        let mut desk = lock(&self.desk);
        if status.phase.is_over() && !desk.can.next {
            desk.can.next = true;
            desk.look_for_people();
        }
        desk.calibration = Some(status.clone());
        self.socket.show(desk.text());
    }

    /// What `look` sees in it.
    pub fn look<T>(&self, look: impl FnOnce(&CalibrationStatus) -> T) -> T {
        look(&lock(&self.status))
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Why this cannot be asked for now.
fn refusal(request: &Request, status: &CalibrationStatus) -> Option<Answer> {
    let refused = |text| Some(Answer::refused(text));
    match request {
        Request::Calibration(what) => {
            let wanted = match what {
                CalibrationRequest::GoOn => May::GoOn,
                CalibrationRequest::Redo => May::Redo,
                CalibrationRequest::Stop => May::Stop,
            };
            let not_waiting = || Answer::refused("the calibration does not wait for that now");
            (!status.may.contains(&wanted)).then(|| not_waiting().with_key("calibration-not-waiting"))
        }
        Request::Next(_) => {
            let not_over = || Answer::refused("the calibration is not over: stop it first");
            (!status.phase.is_over()).then(|| not_over().with_key("calibration-not-over"))
        }
        Request::Record(_) => refused("a calibration is always recorded, and ends its recording itself"),
        Request::Gesture(_) => refused("in a calibration the simulated person follows the cues"),
        Request::Mode(_) => refused("there is no arm in a calibration, so there are no modes"),
        Request::Status => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::status::Phase;

    #[test]
    fn only_what_the_calibration_waits_for_can_be_asked_of_it() {
        let mut status = CalibrationStatus::new("anna".parse().unwrap(), 1);
        let can = |status: &CalibrationStatus, request: &str| {
            refusal(&serde_json::from_str(request).unwrap(), status).is_none()
        };
        let (go_on, stop) = (r#"{"calibration":"go-on"}"#, r#"{"calibration":"stop"}"#);
        let next = r#"{"next":{"session":{"person":"anna"}}}"#;
        assert!(can(&status, stop) && !can(&status, go_on) && !can(&status, next));
        status.may = vec![May::GoOn, May::Stop];
        assert!(can(&status, go_on) && !can(&status, r#"{"calibration":"redo"}"#));
        status.rest_in(Phase::Done);
        assert!(can(&status, next) && !can(&status, stop));
        for other in [r#"{"record":true}"#, r#"{"mode":"x-z"}"#, r#"{"gesture":{"gesture":"grip"}}"#] {
            assert!(!can(&status, other), "{other}");
        }
    }
}
