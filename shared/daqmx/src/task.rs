//! A measurement: channels, clock, samples.

use std::marker::PhantomData;
use std::sync::Arc;

use crate::functions::{Functions, TaskHandle, Voltage, c_text};
use crate::{Daqmx, DaqmxError, NidaqmxSettings, list};

/// A task of the driver, which measures voltages by the device's own clock. It stays on the thread that made it, and ends
/// when it is dropped.
#[derive(Debug)]
pub struct Task {
    functions: Arc<Functions>,
    handle: TaskHandle,
    channels: Vec<String>,
    sample_rate_hz: f64,
    /// Not to be sent to another thread.
    here: PhantomData<*const ()>,
}

impl Task {
    /// Reserves the inputs of `settings` and sets the clock to `sample_rate_hz`. The device may choose another rate:
    /// [`Task::sample_rate_hz`].
    ///
    /// # Errors
    ///
    /// [`DaqmxError`] when there is no such device or channel, it is in use, or it does not take a setting.
    pub fn new(daqmx: &Daqmx, settings: &NidaqmxSettings, sample_rate_hz: f64) -> Result<Task, DaqmxError> {
        let functions = daqmx.functions.clone();
        let handle = functions.create_task()?;
        let mut task =
            Task { functions, handle, channels: Vec::new(), sample_rate_hz: 0.0, here: PhantomData };
        let channels = c_text(&settings.channels);
        let (terminal, range_v) = (settings.terminal.number(), settings.range_v);
        // SAFETY: the task was created above and is cleared when it is dropped, here and in all that follows.
        unsafe {
            task.functions.add_channels(handle, Voltage { channels: &channels, terminal, range_v })?;
            let buffer_samples = (settings.buffer_s * sample_rate_hz).ceil() as u32;
            task.sample_rate_hz = task.functions.time_by_clock(handle, sample_rate_hz, buffer_samples)?;
            let names = task.functions.channel_names(handle)?;
            task.channels = list(&names).map(str::to_owned).collect();
            let count = task.functions.channel_count(handle)?;
            // A driver that groups names says fewer than it has.
            if task.channels.len() != count {
                task.channels = (0..count).map(|channel| format!("ai{channel}")).collect();
            }
        }
        Ok(task)
    }

    /// Names of its channels, in the order of the samples.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// The rate that the device really has, Hz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Begins to measure.
    ///
    /// # Errors
    ///
    /// [`DaqmxError`] when the device does not start.
    pub fn start(&self) -> Result<(), DaqmxError> {
        // SAFETY: see `new`.
        unsafe { self.functions.start(self.handle) }
    }

    /// Waits until `samples` of each channel are there, but no longer than `timeout_s`, and writes them into `volts`, all
    /// channels of an instant together. Returns how many of each channel it wrote.
    ///
    /// # Errors
    ///
    /// [`DaqmxError`]; a time-out is one of [`Trouble::NotYet`](crate::Trouble::NotYet).
    ///
    /// # Panics
    ///
    /// When `volts` is too short.
    pub fn read(&self, samples: usize, timeout_s: f64, volts: &mut [f64]) -> Result<usize, DaqmxError> {
        assert!(volts.len() >= samples * self.channels.len(), "room for all samples");
        // SAFETY: see `new`.
        unsafe { self.functions.read(self.handle, samples, timeout_s, volts) }
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        // SAFETY: the task was created in `new` and is cleared only here.
        unsafe { self.functions.clear_task(self.handle) };
    }
}
