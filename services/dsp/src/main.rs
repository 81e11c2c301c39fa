//! The dsp process: blocks in, filtered windows out. The work itself is `tendon_signal::SignalChain`.

mod electrodes;
mod recorded;

use std::process::ExitCode;

use anyhow::ensure;
use tendon_config::Config;
use tendon_messages::{
    Activity, BLOCKS, BlockHeader, Measured, Stage, Truth, WINDOWS, WindowContext, WindowHeader,
};
use tendon_process::{Consumer, StageProcess};
use tendon_signal::{DesignError, SignalChain};
use tendon_transport::{Publisher, Received, Subscriber};

use electrodes::Electrodes;
use recorded::RecordedWindows;

fn main() -> ExitCode {
    tendon_process::main(Stage::Dsp, |process| {
        let config = &process.config;
        let acquisition = &config.acquisition;
        let delivery = config.delivery();
        let windows = Publisher::open(
            &process.session,
            &WINDOWS,
            config.window_length(),
            delivery,
            process.control.stop_flag(),
        )?;
        let dsp = Dsp {
            chain: chain(config)?,
            output: Output {
                windows,
                channels: acquisition.channels,
                sample_rate_hz: acquisition.sample_rate_hz,
                window_samples: config.dsp.windows.window_samples,
                truth_before: Truth::default(),
                recorded: RecordedWindows::of(config)?,
            },
            next_sample: None,
            calibrated: false,
            electrodes: Electrodes::new(acquisition.channels, acquisition.sample_rate_hz),
        };
        let blocks = Subscriber::open(&process.session, &BLOCKS, Some(Stage::Dsp), delivery)?;
        process.connect(&blocks)?;
        process.ready(&format!(
            "windows of {} samples every {}",
            process.config.dsp.windows.window_samples, process.config.dsp.windows.increment_samples
        ))?;
        Ok(move |process: &mut StageProcess| process.consume(blocks, dsp))
    })
}

fn chain(config: &Config) -> Result<SignalChain, DesignError> {
    let acquisition = &config.acquisition;
    SignalChain::new(&config.dsp, acquisition.channels, acquisition.sample_rate_hz)
}

struct Dsp {
    chain: SignalChain,
    output: Output,
    /// Index of the sample that comes next if none is missing.
    next_sample: Option<u64>,
    calibrated: bool,
    electrodes: Electrodes,
}

/// Where windows go.
struct Output {
    windows: Publisher<WindowHeader, f32>,
    channels: usize,
    sample_rate_hz: f64,
    window_samples: usize,
    /// The truth at the end of the block before.
    truth_before: Truth,
    /// In the replay of a recorded session.
    recorded: Option<RecordedWindows>,
}

impl Consumer<BlockHeader, f32> for Dsp {
    type Error = anyhow::Error;

    fn take(
        &mut self,
        process: &mut StageProcess,
        block: &Received<BlockHeader, f32>,
    ) -> anyhow::Result<Measured> {
        let header = block.header();
        let (channels, sample_rate_hz) = (self.output.channels, self.output.sample_rate_hz);
        ensure!(
            header.channels as usize == channels && header.sample_rate_hz == sample_rate_hz,
            "acquisition delivers {} channels at {} Hz, this session has {} at {} Hz: start all processes with \
             the same configuration",
            header.channels,
            header.sample_rate_hz,
            channels,
            sample_rate_hz
        );
        let samples = header.samples as usize;
        ensure!(
            samples > 0 && block.payload().len() == samples * channels,
            "a block of {} samples a channel holds {} values in all",
            samples,
            block.payload().len()
        );
        let recorded = self.output.recorded.as_mut();
        if recorded.is_some_and(|recorded| recorded.begins_anew(header.first_sample)) {
            self.chain = chain(&process.config)?;
            (self.next_sample, self.output.truth_before, self.calibrated) = (None, Truth::default(), false);
        }
        // Lost on the way or skipped by the source; a source that began anew misses nothing but is no
        // continuation either.
        if let Some(expected) = self.next_sample.filter(|expected| *expected != header.first_sample) {
            self.chain.gap(header.first_sample.saturating_sub(expected));
        }
        if let Some(recorded) = &mut self.output.recorded {
            let follows = self.next_sample == Some(header.first_sample);
            recorded.align(&mut self.chain, header.first_sample, samples, follows);
        }
        self.next_sample = Some(header.first_sample + samples as u64);

        let Dsp { chain, output, electrodes, .. } = self;
        let mut published_ns = None;
        let replaced_samples = chain.push_block(block.payload(), |chain, window, end| {
            published_ns = output.publish(process, block, chain, &window, end)?.or(published_ns);
            if let Some(warning) = electrodes.look(window.first_sample, chain.faults()) {
                tracing::warn!("{warning}");
            }
            anyhow::Ok(())
        })?;
        process.measurements.counts.replaced_samples += u64::from(replaced_samples);
        self.output.truth_before = header.truth;
        self.report_calibration();
        Ok(process.measure(&block.trace(), published_ns))
    }
}

impl Output {
    /// Publishes the window that ended with sample `end` of `block` (exclusive), unless it is too old.
    fn publish(
        &mut self,
        process: &mut StageProcess,
        block: &Received<BlockHeader, f32>,
        chain: &SignalChain,
        window: &tendon_signal::Window,
        end: usize,
    ) -> anyhow::Result<Option<u64>> {
        let header = block.header();
        let mut trace = block.trace();
        let duration_ns = |samples: usize| (samples as f64 * 1e9 / self.sample_rate_hz) as u64;
        // The block's newest sample may be newer than the window's.
        trace.captured_ns = trace.captured_ns.saturating_sub(duration_ns(header.samples as usize - end));
        if process.is_stale(&trace) {
            process.measurements.counts.stale += 1;
            return Ok(None);
        }
        let newest_sample = header.first_sample + end as u64 - 1;
        let first_sample = newest_sample + 1 - self.window_samples as u64;
        let replay_marks = match &self.recorded {
            None => 0,
            Some(recorded) => match recorded.marks(first_sample) {
                Some(marks) => marks,
                None => return Ok(None),
            },
        };
        let truth =
            if header.truth.since_sample() <= newest_sample { header.truth } else { self.truth_before };
        let activity = match window.activity {
            tendon_signal::Activity::Calibrating => Activity::Calibrating,
            tendon_signal::Activity::Rest => Activity::Rest,
            tendon_signal::Activity::Move => Activity::Move,
        };
        let context = WindowContext {
            first_sample,
            first_captured_ns: trace.captured_ns.saturating_sub(duration_ns(self.window_samples - 1)),
            truth,
            replaced_samples: window.replaced_samples,
            calibration_left_ms: (duration_ns(chain.calibration_left_samples()) / 1_000_000) as u32,
            activity: activity.number(),
            replay_marks,
            ordered_mode: self.recorded.as_ref().map_or(0, |recorded| recorded.ordered_mode(first_sample)),
        };
        let window_header = WindowHeader {
            trace,
            context,
            novelty: window.novelty,
            channels: self.channels as u32,
            samples: self.window_samples as u32,
        };
        let published_ns =
            self.windows.publish(window_header, chain.window_len(), |payload| chain.write_window(payload))?;
        process.measurements.counts.published = self.windows.published();
        Ok(Some(published_ns))
    }
}

impl Dsp {
    /// Says once, when the calibration has ended, which channels gave no signal.
    fn report_calibration(&mut self) {
        if self.calibrated {
            return;
        }
        let Some(baselines) = self.chain.baselines() else {
            return;
        };
        self.calibrated = true;
        for (channel, baseline) in baselines.iter().enumerate() {
            if baseline.sigma <= 0.0 {
                tracing::warn!(
                    "channel {channel} was constant during the rest calibration: is its electrode connected?"
                );
            }
        }
    }
}
