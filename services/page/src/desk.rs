//! How the session stands besides its topics, as its supervisor tells it: recording, people, task, calibration.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use serde_json::{Value, json};
use tendon_process::session_status;
use tendon_transport::SessionName;
use tokio::sync::watch;

use crate::access::Rights;

/// Time between two questions while things change, as in a calibration.
const CHANGING: Duration = Duration::from_millis(50);
/// The same where nothing has changed.
const STEADY: Duration = Duration::from_millis(200);

/// The newest that the supervisor has told.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Desk {
    /// What stands under `desk`; null while nobody tells anything.
    pub facts: Value,
    /// As it was told; empty while nobody tells anything.
    told: Bytes,
}

impl Desk {
    /// Takes what the supervisor told.
    fn new(told: String) -> Desk {
        let all: Option<Value> = serde_json::from_str(&told).ok();
        let facts = all.and_then(|mut all| all.get_mut("desk").map(Value::take)).unwrap_or_default();
        Desk { facts, told: told.into() }
    }

    /// The message for somebody with these rights: whoever only watches need not know who else was calibrated here.
    pub fn message(&self, rights: Rights) -> Utf8Bytes {
        let mut facts = self.facts.clone();
        if let (Rights::Watch, Some(facts)) = (rights, facts.as_object_mut()) {
            facts.remove("people");
        }
        json!({ "desk": facts }).to_string().into()
    }
}

/// Asks once, and tells the viewers if something has changed. Whether it has.
pub fn look(session: &SessionName, viewers: &watch::Sender<Desk>) -> bool {
    // One that does not run, or hangs, tells nothing.
    let told = session_status(session).unwrap_or_default();
    let has_changed = viewers.borrow().told != told.as_bytes();
    if has_changed {
        viewers.send_replace(Desk::new(told));
    }
    has_changed
}

/// Asks until `stop`.
pub fn follow(session: &SessionName, viewers: &watch::Sender<Desk>, stop: &Arc<AtomicBool>) {
    while !stop.load(Ordering::Relaxed) {
        let has_changed = look(session, viewers);
        std::thread::sleep(if has_changed { CHANGING } else { STEADY });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_only_watches_is_not_told_who_was_calibrated() {
        let told = json!({"desk": {"people": ["anna"], "person": "anna"}});
        let desk = Desk::new(told.to_string());
        let said = |rights| serde_json::from_str::<Value>(&desk.message(rights)).unwrap();
        assert_eq!(said(Rights::Orders), told);
        assert_eq!(said(Rights::Watch), json!({"desk": {"person": "anna"}}));
        for nothing in ["", "?", "[]", "{}"] {
            let desk = Desk::new(nothing.to_owned());
            assert_eq!(&*desk.message(Rights::Watch), r#"{"desk":null}"#, "{nothing}");
        }
    }
}
