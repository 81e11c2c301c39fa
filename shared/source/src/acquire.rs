//! The loop of every acquisition process.

use tendon_messages::{BLOCKS, BlockHeader, Measured, MessageTimes, Trace};
use tendon_process::{Order, ProcessError, STALE_NS, StageProcess, Wake};
use tendon_transport::{Delivery, Loan, PublishError, Publisher, SessionError, now_ns};

use crate::{Block, Next, Source, SourceError, Wait};

/// Why nothing more is acquired.
#[derive(Debug, thiserror::Error)]
pub enum AcquireError {
    /// The source broke off.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A block cannot be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The process cannot go on.
    #[error(transparent)]
    Process(#[from] ProcessError),
}

/// Publishes the blocks of `source` until it ends or the process is told to stop.
///
/// The topic is opened before the process says ready; the source starts when the supervisor gives the order, so that
/// all stages see its first sample. Blocks that are too late to act upon are left out and counted, and so are those
/// that the source says it lost, by a gap in its sample numbers.
///
/// # Errors
///
/// When the source breaks off, or the transport.
pub fn acquire(
    process: &mut StageProcess,
    source: &mut dyn Source,
    blocks: Publisher<BlockHeader, f32>,
) -> Result<(), AcquireError> {
    let settings = &process.config.acquisition;
    let mut acquisition = Acquisition {
        blocks,
        channels: settings.channels,
        block_samples: settings.block_samples,
        sample_rate_hz: settings.sample_rate_hz,
        delivery: process.config.delivery(),
        next_sample: 0,
        short: vec![0.0; settings.channels * settings.block_samples],
    };
    process.measurements.counts.clock_drift_ppm = f64::NAN;
    if acquisition.wait_for_start(process, source)? {
        source.start()?;
        acquisition.run(process, source)?;
    }
    Ok(process.measurements.publish()?)
}

/// Opens the topic of blocks for [`acquire`].
///
/// # Errors
///
/// When shared memory is too small.
pub fn open_blocks(process: &StageProcess) -> Result<Publisher<BlockHeader, f32>, SessionError> {
    let config = &process.config;
    let stop = process.control.stop_flag();
    Publisher::open(&process.session, &BLOCKS, config.block_length(), config.delivery(), stop)
}

struct Acquisition {
    blocks: Publisher<BlockHeader, f32>,
    channels: usize,
    block_samples: usize,
    sample_rate_hz: f64,
    delivery: Delivery,
    /// Index of the sample that comes next if none is lost.
    next_sample: u64,
    /// A short block on its way from one loan to another.
    short: Vec<f32>,
}

impl Acquisition {
    /// Sleeps until the supervisor says that all stages are ready; `false` when it says stop instead.
    fn wait_for_start(
        &self,
        process: &mut StageProcess,
        source: &mut dyn Source,
    ) -> Result<bool, ProcessError> {
        loop {
            match process.control.wait(None, None)? {
                Wake::Stop => return Ok(false),
                Wake::Order(Order::Start) => return Ok(true),
                Wake::Order(Order::Gesture { gesture, effort }) => source.set_gesture(gesture, effort),
                Wake::Order(_) | Wake::Message | Wake::Deadline => {}
            }
        }
    }

    fn run(&mut self, process: &mut StageProcess, source: &mut dyn Source) -> Result<(), AcquireError> {
        while wait(process, source)? {
            let mut loan = self.blocks.loan(self.channels * self.block_samples)?;
            let block = match source.next_block(loan.payload_mut())? {
                Next::Block(block) => block,
                Next::NotYet => continue,
                Next::End => return Ok(finish(process)?),
            };
            // Counted while there is time: a block that was prepared ahead goes out at once when it is due.
            let written = &loan.payload_mut()[..self.channels * block.samples];
            let non_finite = written.iter().filter(|sample| !sample.is_finite()).count();
            if block.samples < self.block_samples {
                loan = self.shortened(loan, block.samples)?;
            }
            if block.publish_at_ns > 0 && !wait_until(process, source, block.publish_at_ns)? {
                break;
            }
            process.measurements.counts.clock_drift_ppm = source.clock_drift_ppm().unwrap_or(f64::NAN);
            match self.publish(process, loan, block, non_finite as u32) {
                // Being stopped while the next stage takes nothing more is no failure.
                Err(_) if process.control.is_stopped() => break,
                published => published?,
            }
        }
        Ok(())
    }

    /// A loan that holds just the `samples` of each channel at the beginning of `loan`.
    fn shortened(
        &mut self,
        mut loan: Loan<BlockHeader, f32>,
        samples: usize,
    ) -> Result<Loan<BlockHeader, f32>, PublishError> {
        let short = &mut self.short[..self.channels * samples];
        short.copy_from_slice(&loan.payload_mut()[..short.len()]);
        // There is one loan at a time.
        drop(loan);
        let mut loan = self.blocks.loan(short.len())?;
        loan.payload_mut().copy_from_slice(short);
        Ok(loan)
    }

    /// Publishes a block, unless it is too late to act upon.
    fn publish(
        &mut self,
        process: &mut StageProcess,
        loan: Loan<BlockHeader, f32>,
        block: Block,
        non_finite_samples: u32,
    ) -> Result<(), AcquireError> {
        let lost_samples = block.first_sample.saturating_sub(self.next_sample);
        process.measurements.counts.lost_samples += lost_samples;
        process.measurements.counts.stale += lost_samples.div_ceil(self.block_samples as u64);
        self.next_sample = block.first_sample + block.samples as u64;
        let trace = Trace { captured_ns: block.captured_ns, ..Trace::default() };
        if self.delivery == Delivery::Live && trace.is_stale(STALE_NS, now_ns()) {
            process.measurements.counts.stale += 1;
            return Ok(());
        }
        let header = BlockHeader {
            trace,
            first_sample: block.first_sample,
            sample_rate_hz: self.sample_rate_hz,
            truth: block.truth,
            channels: self.channels as u32,
            samples: block.samples as u32,
            non_finite_samples,
        };
        let published_ns = self.blocks.send(loan, header)?;
        let late_ns = published_ns.saturating_sub(block.captured_ns);
        process.measurements.counts.published = self.blocks.published();
        Ok(process.measurements.record(Measured::Message(MessageTimes {
            transit_ns: 0,
            work_ns: late_ns,
            newest_sample_to_publish_ns: Some(late_ns),
        }))?)
    }
}

/// Sleeps until the source may have a block; `false` when the process is to stop instead.
fn wait(process: &mut StageProcess, source: &mut dyn Source) -> Result<bool, ProcessError> {
    loop {
        let wake = match source.wait() {
            Wait::Nothing => return Ok(!process.control.is_stopped()),
            Wait::Until(deadline_ns) => process.control.wait(None, Some(deadline_ns))?,
            Wait::Readable(descriptor) => {
                process.control.wait(Some(descriptor), process.measurements.deadline_ns())?
            }
            Wait::ReadableUntil(descriptor, deadline_ns) => {
                let earliest_ns =
                    process.measurements.deadline_ns().map_or(deadline_ns, |due| due.min(deadline_ns));
                process.control.wait(Some(descriptor), Some(earliest_ns))?
            }
        };
        match wake {
            Wake::Stop => return Ok(false),
            Wake::Order(Order::Gesture { gesture, effort }) => source.set_gesture(gesture, effort),
            Wake::Order(_) => {}
            Wake::Message => return Ok(true),
            Wake::Deadline => {
                process.measurements.publish_if_due()?;
                return Ok(true);
            }
        }
    }
}

/// Sleeps until that time; `false` when the process is to stop instead.
fn wait_until(
    process: &mut StageProcess,
    source: &mut dyn Source,
    time_ns: u64,
) -> Result<bool, ProcessError> {
    loop {
        match process.control.wait(None, Some(time_ns))? {
            Wake::Stop => return Ok(false),
            Wake::Deadline => return Ok(true),
            Wake::Order(Order::Gesture { gesture, effort }) => source.set_gesture(gesture, effort),
            Wake::Order(_) | Wake::Message => {}
        }
    }
}

/// Says that the source has come to its end, and waits to be stopped: the memory that others still read from lies in
/// this process.
fn finish(process: &mut StageProcess) -> Result<(), ProcessError> {
    process.measurements.counts.finished = 1;
    process.measurements.publish()?;
    while process.control.wait(None, None)? != Wake::Stop {}
    Ok(())
}
