//! The device as a source.

use std::io::PipeReader;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::Context;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use tendon_config::AcquisitionSettings;
use tendon_process::SignalDescription;
use tendon_source::{
    BlockAssembler, Choice, Chunk, DeviceClock, Next, Offer, OfferedChannel, Source, SourceError, Wait,
};

use crate::reader::{Found, Reader};
use crate::record::{Head, Incoming};

/// Room in the pipe, bytes: a quarter of a second of 64 channels at 2 kHz.
const PIPE_BYTES: i32 = 1 << 17;

/// An NI device that measures.
pub struct Device {
    found: Found,
    gain: f64,
    choice: Choice,
    incoming: Incoming,
    /// Of the session, of the newest record.
    chosen: Vec<f32>,
    assembler: BlockAssembler,
    clock: DeviceClock,
    pipe: PipeReader,
    start: SyncSender<()>,
    stop: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Device {
    /// Opens the device; it does not measure yet.
    ///
    /// # Errors
    ///
    /// When the driver is missing, the device is not there or in use, or it does not have what the session wants.
    pub fn open(settings: &AcquisitionSettings) -> anyhow::Result<Device> {
        let (pipe, end) = std::io::pipe().context("cannot make a pipe")?;
        fcntl(&pipe, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))
            .context("cannot make a pipe that does not wait")?;
        // Where the system does not grant it, the driver's own buffer has to do.
        let _ = fcntl(&pipe, FcntlArg::F_SETPIPE_SZ(PIPE_BYTES));
        let stop = Arc::new(AtomicBool::new(false));
        let reader = Reader {
            settings: settings.nidaqmx.clone(),
            sample_rate_hz: settings.sample_rate_hz,
            block_samples: settings.block_samples,
            pipe: end,
            stop: stop.clone(),
        };
        let ((found_sender, found), (start, started)) = (sync_channel(1), sync_channel(1));
        let thread = std::thread::Builder::new().name("NI-DAQmx".to_owned());
        let thread =
            thread.spawn(move || reader.run(&found_sender, &started)).context("cannot start a thread")?;
        let found = found.recv().context("the thread of the driver ended")??;
        let offered =
            |name: &String| OfferedChannel { name: name.clone(), unit: "mV".to_owned(), is_emg: true };
        let offer = Offer {
            sample_rate_hz: found.sample_rate_hz,
            channels: found.channels.iter().map(offered).collect(),
        };
        let choice = offer.choose(settings)?;
        Ok(Device {
            gain: settings.nidaqmx.gain,
            incoming: Incoming::new(settings.block_samples * found.channels.len()),
            chosen: Vec::with_capacity(settings.block_samples * settings.channels),
            assembler: BlockAssembler::new(settings.channels, settings.block_samples, found.sample_rate_hz),
            clock: DeviceClock::default(),
            found,
            choice,
            pipe,
            start,
            stop,
            reader: Some(thread),
        })
    }

    /// What a user may want to know.
    pub fn description(&self) -> String {
        let Found { description, sample_rate_hz, .. } = &self.found;
        let channels = self.choice.signal.channels.join(", ");
        format!("{description}: {channels} at {sample_rate_hz} Hz, gain {}", self.gain)
    }

    /// The channels and their unit.
    pub fn signal(&self) -> SignalDescription {
        self.choice.signal.clone()
    }

    fn take(&mut self, head: Head) {
        self.chosen.clear();
        self.choice.take(self.incoming.samples(), &mut self.chosen);
        let samples = (self.incoming.samples().len() / self.found.channels.len()) as u64;
        let device_ns = (head.first_sample + samples) as f64 * 1e9 / self.found.sample_rate_hz;
        self.assembler.push(Chunk {
            first_sample: head.first_sample,
            captured_ns: self.clock.captured_ns(device_ns as u64, head.received_ns),
            instants: &self.chosen,
        });
    }
}

impl Source for Device {
    fn start(&mut self) -> Result<(), SourceError> {
        self.start.send(()).map_err(SourceError::new)
    }

    fn wait(&self) -> Wait<'_> {
        Wait::Readable(self.pipe.as_fd())
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        loop {
            if let Some(block) = self.assembler.next_block(samples) {
                return Ok(Next::Block(block));
            }
            match self.incoming.take(&mut self.pipe).map_err(SourceError::new)? {
                Some(head) => self.take(head),
                None => return Ok(Next::NotYet),
            }
        }
    }

    fn clock_drift_ppm(&self) -> Option<f64> {
        self.clock.drift_ppm()
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A thread that waits for the start finds nobody there.
        let (start, _) = sync_channel(1);
        self.start = start;
        // One that waits for room in the pipe waits in vain.
        if let Some(reader) = self.reader.take()
            && let Ok((pipe, _)) = std::io::pipe()
        {
            self.pipe = pipe;
            let _ = reader.join();
        }
    }
}
