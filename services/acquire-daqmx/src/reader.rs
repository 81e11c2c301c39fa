//! The thread that waits in the driver. The task stays on it from its beginning to its end.
//!
//! ```text
//! open ─▶ tell what was found ─▶ wait for the start ─▶ read, read, … ─▶ end
//!                                                       │     ▲
//!                                overrun, unplugged ────┘     └──── opened anew, every half second
//! ```

use std::io::{PipeWriter, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::time::{Duration, Instant};

use tendon_daqmx::{Daqmx, DaqmxError, NidaqmxSettings, Task, Trouble};
use tendon_transport::now_ns;

use crate::record::Outgoing;

/// Longest wait for samples, s: after it, the thread looks whether it is to end.
const LONGEST_WAIT_S: f64 = 0.25;
/// Time between two attempts to find a device that is gone.
const RETRY: Duration = Duration::from_millis(500);
/// Time between two lines about the same trouble.
const REMINDER: Duration = Duration::from_secs(30);

/// What the thread needs.
pub struct Reader {
    pub settings: NidaqmxSettings,
    pub sample_rate_hz: f64,
    pub block_samples: usize,
    /// Where the samples go.
    pub pipe: PipeWriter,
    /// The thread is to end.
    pub stop: Arc<AtomicBool>,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Found {
    pub description: String,
    pub channels: Vec<String>,
    pub sample_rate_hz: f64,
}

/// Where the numbers of the samples stand.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    /// Number of the next sample, if the task goes on.
    next: u64,
    /// When the sample before it came.
    newest_ns: u64,
}

impl Numbers {
    /// The number of a sample that comes now from a task that began anew: what was not acquired meanwhile counts as lost.
    fn resume(&mut self, newest_ns: u64, samples: usize, sample_rate_hz: f64) {
        let elapsed_s = newest_ns.saturating_sub(self.newest_ns) as f64 * 1e-9;
        let due = (elapsed_s * sample_rate_hz).round() as u64;
        self.next += due.saturating_sub(samples as u64);
    }
}

/// What was said last of what is wrong, so that it is not said at every try.
#[derive(Clone, Copy, Debug, Default)]
struct Told(Option<(Trouble, Instant)>);

impl Told {
    /// Whether this trouble is to be said now: another one than before, or the same after a while.
    fn is_due(&mut self, trouble: Trouble, now: Instant) -> bool {
        let is_due =
            self.0.is_none_or(|(before, at)| before != trouble || now.duration_since(at) >= REMINDER);
        if is_due {
            self.0 = Some((trouble, now));
        }
        is_due
    }
}

impl Reader {
    /// Opens the device, tells what was found, and reads from the start until the end.
    pub fn run(mut self, found: &SyncSender<anyhow::Result<Found>>, start: &Receiver<()>) {
        let opened = self.find().and_then(|(daqmx, description)| {
            let task = Task::new(&daqmx, &self.settings, self.sample_rate_hz)?;
            Ok((daqmx, task, description))
        });
        let (daqmx, task) = match opened {
            Ok((daqmx, task, description)) => {
                let channels = task.channels().to_vec();
                let _ =
                    found.send(Ok(Found { description, channels, sample_rate_hz: task.sample_rate_hz() }));
                (daqmx, task)
            }
            Err(error) => {
                let _ = found.send(Err(error));
                return;
            }
        };
        // Nobody starts a session that is over.
        if start.recv().is_ok() {
            self.read_until_stopped(&daqmx, task);
        }
    }

    /// The driver, and what it says of the device.
    fn find(&self) -> anyhow::Result<(Daqmx, String)> {
        let daqmx = Daqmx::load(self.settings.library.as_deref())?;
        let named = |device: &tendon_daqmx::Device| {
            let of_device = |channel: &str| channel.trim().split('/').next() == Some(device.name.as_str());
            self.settings.channels.split(',').any(of_device)
        };
        let devices: Vec<String> = daqmx
            .devices()?
            .iter()
            .filter(|device| named(device))
            .map(|device| {
                let simulated = if device.is_simulated { ", simulated" } else { "" };
                format!("{} ({}{simulated})", device.name, device.product)
            })
            .collect();
        let description = format!("NI-DAQmx {}, {}", daqmx.version()?, devices.join(", "));
        Ok((daqmx, description))
    }

    fn read_until_stopped(&mut self, daqmx: &Daqmx, task: Task) {
        let mut numbers = Numbers { next: 0, newest_ns: now_ns() };
        let mut task = Some(task);
        let mut told = Told::default();
        // Whether it is said that the device acquires again: if it was said that it did not.
        let mut says_resumed = None;
        while !self.stop.load(Ordering::Relaxed) {
            let Some(running) = task.take() else {
                std::thread::sleep(RETRY);
                // Why it cannot be opened was said when it was lost.
                task = Task::new(daqmx, &self.settings, self.sample_rate_hz).ok();
                continue;
            };
            let (began, first) = (Instant::now(), numbers.next);
            let error = match self.read(&running, &mut numbers, says_resumed) {
                Ok(()) => return,
                Err(error) => error,
            };
            let trouble = error.trouble();
            let acquired = numbers.next != first;
            if acquired && trouble != Trouble::Overrun {
                // It was back, and is gone once more.
                told = Told::default();
            }
            let is_due = told.is_due(trouble, Instant::now());
            says_resumed = Some(is_due || (!acquired && says_resumed == Some(true)));
            match trouble {
                _ if !is_due => {}
                Trouble::Overrun => tracing::warn!("{error}"),
                _ => tracing::warn!("{error}; looking for the device until it is back"),
            }
            drop(running);
            // At once, unless it never got to acquire.
            if trouble == Trouble::Overrun && began.elapsed() >= RETRY {
                task = Task::new(daqmx, &self.settings, self.sample_rate_hz).ok();
            }
        }
    }

    /// Starts the task and hands its samples over, until it fails or is to end. `says_resumed`: whether to say that the device
    /// acquires again; `None` for the first task.
    fn read(
        &mut self,
        task: &Task,
        numbers: &mut Numbers,
        says_resumed: Option<bool>,
    ) -> Result<(), DaqmxError> {
        let samples = self.block_samples;
        let values = samples * task.channels().len();
        let mut volts = vec![0.0; values];
        let mut record = Outgoing::new(values);
        // What an input in volts is at the skin in millivolts.
        let to_millivolts = 1e3 / self.settings.gain;
        task.start()?;
        let mut begins = true;
        while !self.stop.load(Ordering::Relaxed) {
            let count = match task.read(samples, LONGEST_WAIT_S, &mut volts) {
                Ok(count) => count,
                // The next read asks for the same samples again.
                Err(error) if error.trouble() == Trouble::NotYet => continue,
                Err(error) => return Err(error),
            };
            let received_ns = now_ns();
            if count != samples {
                continue;
            }
            if let (true, Some(is_said)) = (std::mem::take(&mut begins), says_resumed) {
                numbers.resume(received_ns, samples, task.sample_rate_hz());
                if is_said {
                    tracing::warn!("the device acquires again");
                }
            }
            let millivolts = volts.iter().map(|volt| (volt * to_millivolts) as f32);
            if self.pipe.write_all(record.bytes(numbers.next, received_ns, millivolts)).is_err() {
                // The process ends.
                return Ok(());
            }
            numbers.next += samples as u64;
            numbers.newest_ns = received_ns;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_pause_the_numbers_count_what_was_not_acquired() {
        let mut numbers = Numbers { next: 100, newest_ns: 1_000_000_000 };
        numbers.resume(2_005_000_000, 10, 2000.0);
        assert_eq!(numbers.next, 100 + 2000);
        numbers.resume(2_005_000_000, 10, 0.0);
        assert_eq!(numbers.next, 2100, "never backwards");
    }

    #[test]
    fn a_trouble_that_goes_on_is_said_once_and_then_rarely() {
        let (mut told, began) = (Told::default(), Instant::now());
        let tries = |told: &mut Told, trouble, from_s: u64| {
            (from_s * 2..(from_s + 60) * 2)
                .filter(|half| told.is_due(trouble, began + RETRY * *half as u32))
                .count()
        };
        assert_eq!(tries(&mut told, Trouble::Overrun, 0), 2);
        assert_eq!(tries(&mut told, Trouble::Unplugged, 60), 2);
        assert!(told.is_due(Trouble::Overrun, began + RETRY * 240));
    }
}
