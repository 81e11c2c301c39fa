//! Blocks out of the chunks that a device or a network delivers.
//!
//! ```text
//! chunks        ├──── 18 ────┤├──── 18 ────┤   lost   ├──── 18 ────┤      instants, all channels of one together
//! blocks of 10  ├─ 10 ─┤├─ 10 ─┤├─ 10 ─┤├6┤           ├─ 10 ─┤├ 8 wait for more
//! ```
//!
//! No block spans lost samples: what lies before them goes out as a shorter block.

use std::collections::VecDeque;

use tendon_messages::Truth;

use crate::Block;

/// Longest time of samples that wait for the next stage, s. Older ones are too late to act upon.
const WAITING_S: f64 = 1.0;

/// Samples as a device delivers them.
#[derive(Clone, Copy, Debug)]
pub struct Chunk<'a> {
    /// Index of its first sample since the device began, those that were lost included.
    pub first_sample: u64,
    /// When its newest sample was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
    /// `[samples × channels]`: all channels of an instant together.
    pub instants: &'a [f32],
}

/// Makes blocks of chunks. Allocates nothing after it was made.
#[derive(Clone, Debug)]
pub struct BlockAssembler {
    channels: usize,
    block_samples: usize,
    sample_ns: f64,
    /// Instants that wait, as in [`Chunk::instants`].
    instants: VecDeque<f32>,
    /// Their runs without a gap, oldest first.
    runs: VecDeque<Run>,
    most_samples: usize,
}

/// Samples without a gap, whose newest one was captured at a known time.
#[derive(Clone, Copy, Debug)]
struct Run {
    first_sample: u64,
    samples: usize,
    captured_ns: u64,
}

impl Run {
    fn end(&self) -> u64 {
        self.first_sample + self.samples as u64
    }
}

impl BlockAssembler {
    /// For blocks of `block_samples` of each of `channels` channels.
    pub fn new(channels: usize, block_samples: usize, sample_rate_hz: f64) -> BlockAssembler {
        let most_samples = block_samples.max((WAITING_S * sample_rate_hz) as usize);
        BlockAssembler {
            channels,
            block_samples,
            sample_ns: 1e9 / sample_rate_hz,
            instants: VecDeque::with_capacity(most_samples * channels),
            runs: VecDeque::with_capacity(most_samples),
            most_samples,
        }
    }

    /// Takes a chunk. When more than a second of samples waits, the oldest are dropped, and the numbers of the next block
    /// show it.
    ///
    /// # Panics
    ///
    /// When the chunk does not hold whole instants.
    pub fn push(&mut self, chunk: Chunk<'_>) {
        assert!(chunk.instants.len().is_multiple_of(self.channels), "a chunk holds whole instants");
        let samples = chunk.instants.len() / self.channels;
        let dropped = samples.saturating_sub(self.most_samples);
        let samples = samples - dropped;
        if samples == 0 {
            return;
        }
        while self.waiting_samples() + samples > self.most_samples {
            self.drop_oldest(self.waiting_samples() + samples - self.most_samples);
        }
        self.instants.extend(&chunk.instants[dropped * self.channels..]);
        self.runs.push_back(Run {
            first_sample: chunk.first_sample + dropped as u64,
            samples,
            captured_ns: chunk.captured_ns,
        });
    }

    /// Writes the next block into `out` (`[channels × block_samples]`; a shorter one lies at its beginning), if there is one.
    pub fn next_block(&mut self, out: &mut [f32]) -> Option<Block> {
        let (samples, captured_ns) = self.next_samples()?;
        let first_sample = self.runs.front()?.first_sample;
        for sample in 0..samples {
            for channel in 0..self.channels {
                out[channel * samples + sample] = self.instants[sample * self.channels + channel];
            }
        }
        self.drop_oldest(samples);
        Some(Block { first_sample, samples, captured_ns, publish_at_ns: 0, truth: Truth::default() })
    }

    /// Whether the next block is complete.
    pub fn has_block(&self) -> bool {
        self.next_samples().is_some()
    }

    /// Forgets what waits: the device began anew.
    pub fn clear(&mut self) {
        self.instants.clear();
        self.runs.clear();
    }

    fn waiting_samples(&self) -> usize {
        self.instants.len() / self.channels
    }

    /// How many samples the next block has and when its newest one was captured; `None` while it is not complete.
    fn next_samples(&self) -> Option<(usize, u64)> {
        let mut samples = 0;
        let mut newest: Option<&Run> = None;
        for run in &self.runs {
            if newest.is_some_and(|before| before.end() != run.first_sample) {
                break;
            }
            newest = Some(run);
            samples += run.samples;
            if samples >= self.block_samples {
                let after = samples - self.block_samples;
                return Some((self.block_samples, run.captured_ns - self.duration_ns(after, run)));
            }
        }
        let is_before_a_gap = newest?.end() != self.runs.back()?.end();
        is_before_a_gap.then(|| (samples, newest.map_or(0, |run| run.captured_ns)))
    }

    /// Duration of samples at the end of a run, not longer than the run's own time, ns.
    fn duration_ns(&self, samples: usize, run: &Run) -> u64 {
        ((samples as f64 * self.sample_ns) as u64).min(run.captured_ns)
    }

    fn drop_oldest(&mut self, samples: usize) {
        self.instants.drain(..samples * self.channels);
        let mut left = samples;
        while left > 0 {
            let Some(run) = self.runs.front_mut() else { return };
            let dropped = left.min(run.samples);
            run.first_sample += dropped as u64;
            run.samples -= dropped;
            left -= dropped;
            if run.samples == 0 {
                self.runs.pop_front();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CHANNELS: usize = 3;
    const RATE_HZ: f64 = 1000.0;

    /// What was sampled in channel `channel` at index `sample`.
    fn value(sample: u64, channel: usize) -> f32 {
        sample as f32 + channel as f32 * 0.25
    }

    fn instants(first_sample: u64, samples: usize) -> Vec<f32> {
        let all = first_sample..first_sample + samples as u64;
        all.flat_map(|sample| (0..CHANNELS).map(move |channel| value(sample, channel))).collect()
    }

    fn push(assembler: &mut BlockAssembler, first_sample: u64, samples: usize) {
        let captured_ns = (first_sample + samples as u64 - 1) * 1_000_000;
        let instants = instants(first_sample, samples);
        assembler.push(Chunk { first_sample, captured_ns, instants: &instants });
    }

    /// All blocks that are complete, with their samples checked.
    fn blocks(assembler: &mut BlockAssembler, block_samples: usize) -> Vec<Block> {
        let mut out = vec![0.0; CHANNELS * block_samples];
        std::iter::from_fn(|| {
            let block = assembler.next_block(&mut out)?;
            for channel in 0..CHANNELS {
                for sample in 0..block.samples {
                    let expected = value(block.first_sample + sample as u64, channel);
                    assert_eq!(out[channel * block.samples + sample], expected);
                }
            }
            assert_eq!(block.captured_ns, (block.first_sample + block.samples as u64 - 1) * 1_000_000);
            Some(block)
        })
        .collect()
    }

    #[test]
    fn a_block_before_lost_samples_is_shorter_and_none_spans_them() {
        let mut assembler = BlockAssembler::new(CHANNELS, 10, RATE_HZ);
        push(&mut assembler, 0, 18);
        push(&mut assembler, 18, 18);
        push(&mut assembler, 54, 18);
        let found: Vec<_> =
            blocks(&mut assembler, 10).iter().map(|block| (block.first_sample, block.samples)).collect();
        assert_eq!(found, [(0, 10), (10, 10), (20, 10), (30, 6), (54, 10)]);
    }

    #[test]
    fn of_more_than_a_second_the_oldest_is_dropped() {
        let mut assembler = BlockAssembler::new(CHANNELS, 10, RATE_HZ);
        push(&mut assembler, 0, 700);
        push(&mut assembler, 700, 700);
        assert_eq!(blocks(&mut assembler, 10)[0].first_sample, 400);
        push(&mut assembler, 1400, 2500);
        assert_eq!(blocks(&mut assembler, 10)[0].first_sample, 2900);
        assembler.clear();
        assert_eq!(blocks(&mut assembler, 10), []);
    }

    proptest! {
        #[test]
        fn every_sample_that_came_is_in_one_block(
            block_samples in 1_usize..30,
            chunks in proptest::collection::vec((1_usize..40, prop_oneof![4 => Just(0_u64), 1 => 1_u64..100]), 1..40),
        ) {
            let mut assembler = BlockAssembler::new(CHANNELS, block_samples, RATE_HZ);
            let (mut next, mut came, mut found) = (0, Vec::new(), Vec::new());
            for (samples, lost) in chunks {
                push(&mut assembler, next, samples);
                came.extend(next..next + samples as u64);
                next += samples as u64 + lost;
                found.extend(blocks(&mut assembler, block_samples));
            }
            let numbers: Vec<u64> = found
                .iter()
                .flat_map(|block| block.first_sample..block.first_sample + block.samples as u64)
                .collect();
            prop_assert_eq!(&numbers[..], &came[..numbers.len()]);
            prop_assert!(came.len() - numbers.len() < block_samples);
            for pair in found.windows(2) {
                let is_before_a_gap = pair[0].first_sample + pair[0].samples as u64 != pair[1].first_sample;
                prop_assert!(pair[0].samples == block_samples || is_before_a_gap);
            }
        }
    }
}
