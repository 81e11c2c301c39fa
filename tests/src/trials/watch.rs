//! The flange as the emulated arm sees it.

use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::REST_MM_PER_S;
use crate::EmulatedArm;

/// Time between two looks.
const LOOK: Duration = Duration::from_millis(2);

/// Looks at the flange until it is dropped.
pub struct Watch {
    motion: Arc<Mutex<Vec<(Instant, f64)>>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Begins to look.
    pub fn start(emulator: &Arc<EmulatedArm>) -> Watch {
        let motion = Arc::new(Mutex::new(Vec::new()));
        let ended = Arc::new(AtomicBool::new(false));
        let arm = Arc::clone(emulator);
        let thread = {
            let (motion, ended) = (Arc::clone(&motion), Arc::clone(&ended));
            std::thread::spawn(move || {
                while !ended.load(Ordering::Relaxed) {
                    let speed_mm_per_s = arm.model().speed_mm_per_s();
                    if speed_mm_per_s > REST_MM_PER_S {
                        motion.lock().unwrap().push((Instant::now(), speed_mm_per_s));
                    }
                    std::thread::sleep(LOOK);
                }
            })
        };
        Watch { motion, ended, thread: Some(thread) }
    }

    /// When the flange moved last, after `since`.
    pub fn last_motion_after(&self, since: Instant) -> Option<Instant> {
        self.motion.lock().unwrap().last().map(|(time, _)| *time).filter(|time| *time > since)
    }

    /// The greatest speed of the flange so far, mm/s; 0 when it did not move.
    pub fn greatest_speed_mm_per_s(&self) -> f64 {
        self.motion.lock().unwrap().iter().map(|(_, speed)| *speed).fold(0.0, f64::max)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A look that panicked has said so.
            let _ = thread.join();
        }
    }
}
