//! An acquisition program of somebody else's, as `acquisition.program` names one: it stands for a vendor's library that
//! pushes blocks of samples from a thread of its own, with a clock that has another origin than ours, runs fast, and
//! counts the samples that the device lost.
//!
//! ```text
//! thread of the library ── pipe: device time, first sample, samples ──▶ Device (Source) ─▶ tendon_source::acquire
//! ```
#![forbid(unsafe_code)]

use std::io::{ErrorKind, PipeReader, Read, Write};
use std::os::fd::AsFd;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use tendon_messages::{Stage, Truth};
use tendon_process::StageProcess;
use tendon_source::{Block, DeviceClock, Next, Source, SourceError, Wait};
use tendon_transport::now_ns;

/// The device counts 100 ppm faster than CLOCK_MONOTONIC, from its own zero.
const DRIFT: f64 = 100e-6;
/// The block that the device loses.
const LOST_BLOCK: u64 = 300;
/// With this environment variable the device is silent: it never pushes a block.
const SILENT: &str = "PUSH_DEVICE_SILENT";
/// Bytes of device time and first sample before the samples.
const HEAD: usize = 16;

fn main() -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let settings = &process.config.acquisition;
        let mut device = Device {
            channels: settings.channels,
            block_samples: settings.block_samples,
            sample_rate_hz: settings.sample_rate_hz,
            pipe: None,
            bytes: Vec::new(),
            clock: DeviceClock::default(),
        };
        let blocks = tendon_source::open_blocks(process)?;
        process.ready("a device that pushes")?;
        Ok(move |process: &mut StageProcess| tendon_source::acquire(process, &mut device, blocks))
    })
}

struct Device {
    channels: usize,
    block_samples: usize,
    sample_rate_hz: f64,
    /// From the library, once it was started.
    pipe: Option<PipeReader>,
    /// Of a block that has not come as a whole.
    bytes: Vec<u8>,
    clock: DeviceClock,
}

impl Source for Device {
    fn start(&mut self) -> Result<(), SourceError> {
        let (pipe, library) = std::io::pipe().map_err(SourceError::new)?;
        fcntl(&pipe, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).map_err(SourceError::new)?;
        self.pipe = Some(pipe);
        let (length, samples, rate_hz) =
            (self.channels * self.block_samples, self.block_samples as u64, self.sample_rate_hz);
        std::thread::spawn(move || push_blocks(library, length, samples, rate_hz));
        Ok(())
    }

    fn clock_drift_ppm(&self) -> Option<f64> {
        self.clock.drift_ppm()
    }

    fn wait(&self) -> Wait<'_> {
        self.pipe.as_ref().map_or(Wait::Nothing, |pipe| Wait::Readable(pipe.as_fd()))
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        let Some(pipe) = &mut self.pipe else { return Ok(Next::NotYet) };
        let length = HEAD + size_of_val(samples);
        let mut room = vec![0; length - self.bytes.len()];
        match pipe.read(&mut room) {
            Ok(0) => return Ok(Next::End),
            Ok(count) => self.bytes.extend_from_slice(&room[..count]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(Next::NotYet),
            Err(error) => return Err(SourceError::new(error)),
        }
        if self.bytes.len() < length {
            return Ok(Next::NotYet);
        }
        let received_ns = now_ns();
        let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte));
        let (device_ns, first_sample) = (word(&self.bytes[..8]), word(&self.bytes[8..HEAD]));
        for (sample, bytes) in samples.iter_mut().zip(self.bytes[HEAD..].chunks_exact(4)) {
            *sample = f32::from_bits(word(bytes) as u32);
        }
        self.bytes.clear();
        let captured_ns = self.clock.captured_ns(device_ns, received_ns);
        Ok(Next::Block(Block {
            first_sample,
            samples: self.block_samples,
            captured_ns,
            publish_at_ns: 0,
            truth: Truth::default(),
        }))
    }
}

/// The library: pushes a block whenever its own clock says so, until nobody reads any more.
fn push_blocks(mut pipe: impl Write, length: usize, block_samples: u64, sample_rate_hz: f64) {
    let began = Instant::now();
    let mut noise = 1_u32;
    while std::env::var_os(SILENT).is_some() {
        std::thread::park();
    }
    for block in 0.. {
        let device_s = ((block + 1) * block_samples) as f64 / sample_rate_hz;
        let due = Duration::from_secs_f64(device_s / (1.0 + DRIFT));
        std::thread::sleep(due.saturating_sub(began.elapsed()));
        if block == LOST_BLOCK {
            continue;
        }
        let mut bytes = ((device_s * 1e9) as u64).to_le_bytes().to_vec();
        bytes.extend((block * block_samples).to_le_bytes());
        for _ in 0..length {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            bytes.extend((noise as f32 / u32::MAX as f32 - 0.5).to_le_bytes());
        }
        if pipe.write_all(&bytes).is_err() {
            return;
        }
    }
}
