//! What is typed, and what has been sent: between the person at the keyboard and the emulator's thread.

use std::collections::VecDeque;
use std::io::{BufRead, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tendon_gesture::Gesture;

use crate::Fault;

/// Shared by the keyboard and the emulator.
#[derive(Clone, Debug, Default)]
pub struct Console {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Debug, Default)]
struct Shared {
    faults: VecDeque<Fault>,
    gesture: Option<Gesture>,
    sent_samples: u64,
    lost_samples: u64,
    connections: u64,
}

impl Console {
    fn shared(&self) -> MutexGuard<'_, Shared> {
        // What lies behind this lock is whole at every moment.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes something go wrong.
    pub fn inject(&self, fault: Fault) {
        self.shared().faults.push_back(fault);
    }

    pub(crate) fn take_fault(&self) -> Option<Fault> {
        self.shared().faults.pop_front()
    }

    pub(crate) fn take_gesture(&self) -> Option<Gesture> {
        self.shared().gesture.take()
    }

    pub(crate) fn count_connection(&self) {
        self.shared().connections += 1;
    }

    pub(crate) fn count_samples(&self, sent: u64, lost: u64) {
        let mut shared = self.shared();
        shared.sent_samples += sent;
        shared.lost_samples += lost;
    }

    /// Samples that were sent and lost in all connections, and their number.
    pub fn state(&self) -> String {
        let shared = self.shared();
        format!(
            "sent {} lost {} connections {}",
            shared.sent_samples, shared.lost_samples, shared.connections
        )
    }

    /// Runs an emulator in a thread, ends the process if that fails, and obeys standard input: faults, gestures, `state` and `quit`. Returns at `quit`; at the end of the input the emulator runs
    /// until it is killed.
    ///
    /// # Errors
    ///
    /// When the standard streams are broken.
    pub fn obey_beside(
        &self,
        program: &'static str,
        run: impl FnOnce() -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<()> {
        std::thread::spawn(move || {
            if let Err(error) = run() {
                let _ = writeln!(std::io::stderr(), "{program}: error: {error:#}");
                std::process::exit(1);
            }
        });
        self.obey()
    }

    fn obey(&self) -> anyhow::Result<()> {
        let mut output = std::io::stdout();
        for line in std::io::stdin().lock().lines() {
            let line = line?;
            match line.trim() {
                "" => {}
                "quit" => return Ok(()),
                "state" => writeln!(output, "{}", self.state())?,
                text => match (text.parse::<Fault>(), text.parse::<Gesture>()) {
                    (Ok(fault), _) => self.inject(fault),
                    (_, Ok(gesture)) if !text.contains(' ') => self.shared().gesture = Some(gesture),
                    (Err(error), _) => writeln!(output, "{error}; or a gesture, state or quit")?,
                },
            }
        }
        loop {
            std::thread::park();
        }
    }
}
