//! The acquisition process: samples in, blocks out.
//!
//! ```text
//! simulated DAQ ─┐
//!                ├─▶ fill a block in shared memory ─▶ sleep until it is due ─▶ publish
//! recording ─────┘
//! ```
//!
//! Blocks carry the time they were *due*: if this process is late, that shows in every latency. They are
//! filled beforehand, because an amplifier would not spend the processor's time on making its samples. A block that is too late to act upon is left out, and counted, as an amplifier whose buffer
//! overflows would do.

mod source;

use std::process::ExitCode;

use anyhow::Context;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_gesture::Gesture;
use tendon_messages::{BLOCKS, BlockHeader, Measured, MessageTimes, Stage, Trace, Truth};
use tendon_process::{Order, STALE_NS, StageProcess, Wake};
use tendon_transport::{Delivery, Loan, Publisher, now_ns};

use source::Source;

fn main() -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let source = Source::open(&process.config.acquisition)?;
        let blocks = Publisher::open(
            &process.session,
            &BLOCKS,
            process.config.block_length(),
            process.config.delivery(),
            process.control.stop_flag(),
        )?;
        process.ready(&source.describe())?;
        Ok(move |process: &mut StageProcess| Acquisition::new(process, source, blocks).run(process))
    })
}

struct Acquisition {
    source: Source,
    blocks: Publisher<BlockHeader, f32>,
    channels: usize,
    block_samples: usize,
    sample_rate_hz: f64,
    delivery: Delivery,
    jitter_ns: f64,
    jitter: Xoshiro256PlusPlus,
}

/// A block that waits until it is due.
struct Prepared {
    loan: Loan<BlockHeader, f32>,
    truth: Truth,
    non_finite_samples: u32,
}

impl Acquisition {
    fn new(process: &StageProcess, source: Source, blocks: Publisher<BlockHeader, f32>) -> Acquisition {
        let settings = &process.config.acquisition;
        Acquisition {
            source,
            blocks,
            channels: settings.channels,
            block_samples: settings.block_samples,
            sample_rate_hz: settings.sample_rate_hz,
            delivery: process.config.delivery(),
            jitter_ns: settings.simulate.jitter_ms * 1e6,
            jitter: Xoshiro256PlusPlus::seed_from_u64(settings.simulate.seed),
        }
    }

    fn run(mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        if !self.wait_for_start(process)? {
            return Ok(());
        }
        let start_ns = now_ns();
        let mut block: u64 = 0;
        loop {
            let Some(prepared) = self.prepare()? else {
                self.finish(process)?;
                break;
            };
            // When the block's newest sample is there: computed from the start, so that no error adds up.
            let samples = (block + 1) * self.block_samples as u64;
            let due_ns = start_ns + (samples as f64 * 1e9 / self.sample_rate_hz) as u64;
            if !self.wait_until_due(process, due_ns)? {
                break;
            }
            match self.publish(process, prepared, block * self.block_samples as u64, due_ns) {
                // Being stopped while the next stage takes nothing more is no failure.
                Err(_) if process.control.is_stopped() => break,
                published => published?,
            }
            block += 1;
        }
        process.measurements.publish()
    }

    /// Sleeps until the supervisor says that all stages are ready; `false` when it says stop instead.
    fn wait_for_start(&mut self, process: &mut StageProcess) -> anyhow::Result<bool> {
        loop {
            match process.control.wait(None, None)? {
                Wake::Stop => return Ok(false),
                Wake::Order(Order::Start) => return Ok(true),
                Wake::Order(Order::Gesture(gesture)) => self.source.set_gesture(gesture),
                Wake::Order(_) | Wake::Message | Wake::Deadline => {}
            }
        }
    }

    /// Sleeps until a block is due; `false` when the process is to stop instead. At full speed a block is
    /// always due.
    fn wait_until_due(&mut self, process: &mut StageProcess, due_ns: u64) -> anyhow::Result<bool> {
        let jitter_ns = (self.jitter_ns * self.jitter.random::<f64>()) as u64;
        let deadline_ns = match self.delivery {
            Delivery::Live => due_ns + jitter_ns,
            Delivery::Lossless => 0,
        };
        loop {
            match process.control.wait(None, Some(deadline_ns))? {
                Wake::Stop => return Ok(false),
                Wake::Deadline => return Ok(true),
                Wake::Order(Order::Gesture(gesture)) => self.source.set_gesture(gesture),
                Wake::Order(_) | Wake::Message => {}
            }
        }
    }

    /// The next block, filled in shared memory; `None` at the end of the source.
    fn prepare(&mut self) -> anyhow::Result<Option<Prepared>> {
        let mut loan = self.blocks.loan(self.channels * self.block_samples)?;
        let truth = self.source.fill(loan.payload_mut()).context("the source failed")?;
        let non_finite_samples = loan.payload_mut().iter().filter(|sample| !sample.is_finite()).count();
        Ok(truth.map(|truth| Prepared { loan, truth, non_finite_samples: non_finite_samples as u32 }))
    }

    /// Publishes a block that was due at `due_ns`, unless it is too late to act upon.
    fn publish(
        &mut self,
        process: &mut StageProcess,
        prepared: Prepared,
        first_sample: u64,
        due_ns: u64,
    ) -> anyhow::Result<()> {
        let now_ns = now_ns();
        let captured_ns = match self.delivery {
            Delivery::Live if now_ns.saturating_sub(due_ns) > STALE_NS => {
                process.measurements.counts.stale += 1;
                return Ok(());
            }
            Delivery::Live => due_ns,
            Delivery::Lossless => now_ns,
        };
        let header = BlockHeader {
            trace: Trace { captured_ns, ..Trace::default() },
            first_sample,
            sample_rate_hz: self.sample_rate_hz,
            truth: prepared.truth,
            channels: self.channels as u32,
            samples: self.block_samples as u32,
            non_finite_samples: prepared.non_finite_samples,
        };
        let published_ns = self.blocks.send(prepared.loan, header)?;
        let late_ns = published_ns.saturating_sub(captured_ns);
        process.measurements.counts.published = self.blocks.published();
        process.measurements.record(Measured::Message(MessageTimes {
            transit_ns: 0,
            work_ns: late_ns,
            newest_sample_to_publish_ns: Some(late_ns),
        }))
    }

    /// Says that the source has come to its end, and waits to be stopped: the memory that others still read
    /// from lives in this process.
    fn finish(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        process.measurements.counts.finished = 1;
        process.measurements.publish()?;
        while process.control.wait(None, None)? != Wake::Stop {}
        Ok(())
    }
}

impl Source {
    /// The keyboard's gesture; a recording has its own.
    fn set_gesture(&mut self, gesture: Gesture) {
        if let Source::Simulate { performance, .. } = self {
            performance.set_gesture(gesture);
        }
    }
}
