//! A clock for what has none: the simulated person and recordings.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_gesture::Gesture;
use tendon_messages::Truth;
use tendon_transport::now_ns;

use crate::{Block, Next, Source, SourceError, Wait};

/// Makes one block of samples after the other, at any pace.
pub trait BlockMaker {
    /// Writes the next block, `[channels × samples]`, channel-major, and describes it; `None` at the end.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when the recording cannot be read.
    fn make(&mut self, samples: &mut [f32]) -> Result<Option<MadeBlock>, SourceError>;

    /// As [`Source::set_gesture`].
    fn set_gesture(&mut self, _gesture: Gesture, _effort: f32) {}
}

/// A block as its maker describes it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MadeBlock {
    /// Samples that are missing before its first one.
    pub lost_samples: u64,
    /// The truth at its newest sample.
    pub truth: Truth,
}

/// How fast blocks come.
#[derive(Clone, Debug)]
pub enum Pace {
    /// As an amplifier would deliver them.
    True {
        /// Sampling rate, Hz.
        sample_rate_hz: f64,
        /// Each block is published up to this much later than it is due, at random, ns.
        jitter_ns: f64,
        /// The same seed gives the same delays.
        seed: u64,
        /// Where samples are missing, nothing comes for so long at most, s: nobody waits out the years by which a clock was set.
        longest_silence_s: f64,
    },
    /// As fast as they are taken.
    Full,
}

/// A [`BlockMaker`] with a clock.
///
/// A block is made ahead of its time, because an amplifier would not spend the processor's time on making its samples.
/// It counts as captured when it is *due*: if this process is late, that shows in every latency.
#[derive(Debug)]
pub struct Paced<M> {
    maker: M,
    pace: Pace,
    block_samples: usize,
    jitter: Xoshiro256PlusPlus,
    start_ns: u64,
    /// Samples so far, those missing included.
    elapsed_samples: u64,
    /// Those among the missing ones that were not waited for.
    passed_over_samples: u64,
}

impl<M: BlockMaker> Paced<M> {
    /// Blocks of `block_samples` samples a channel from `maker`, at this pace.
    pub fn new(maker: M, pace: Pace, block_samples: usize) -> Paced<M> {
        let seed = if let Pace::True { seed, .. } = pace { seed } else { 0 };
        let jitter = Xoshiro256PlusPlus::seed_from_u64(seed);
        Paced { maker, pace, block_samples, jitter, start_ns: 0, elapsed_samples: 0, passed_over_samples: 0 }
    }
}

impl<M: BlockMaker> Source for Paced<M> {
    fn start(&mut self) -> Result<(), SourceError> {
        self.start_ns = now_ns();
        Ok(())
    }

    fn wait(&self) -> Wait<'_> {
        match self.pace {
            Pace::True { .. } => Wait::Nothing,
            // Always due, but orders are looked at in between.
            Pace::Full => Wait::Until(0),
        }
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        let Some(MadeBlock { lost_samples, truth }) = self.maker.make(samples)? else { return Ok(Next::End) };
        let first_sample = self.elapsed_samples + lost_samples;
        self.elapsed_samples = first_sample + self.block_samples as u64;
        let (captured_ns, publish_at_ns) = match self.pace {
            Pace::True { sample_rate_hz, jitter_ns, longest_silence_s, .. } => {
                let most_samples = (longest_silence_s * sample_rate_hz) as u64;
                self.passed_over_samples += lost_samples.saturating_sub(most_samples);
                // From the start, so that no error adds up.
                let samples = self.elapsed_samples - self.passed_over_samples;
                let due_ns = self.start_ns + (samples as f64 * 1e9 / sample_rate_hz) as u64;
                (due_ns, due_ns + (jitter_ns * self.jitter.random::<f64>()) as u64)
            }
            Pace::Full => (now_ns(), 0),
        };
        Ok(Next::Block(Block {
            first_sample,
            samples: self.block_samples,
            captured_ns,
            publish_at_ns,
            truth,
        }))
    }

    fn set_gesture(&mut self, gesture: Gesture, effort: f32) {
        self.maker.set_gesture(gesture, effort);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks left. 20 samples are missing before the last one.
    struct Ones(u32);

    impl BlockMaker for Ones {
        fn make(&mut self, samples: &mut [f32]) -> Result<Option<MadeBlock>, SourceError> {
            samples.fill(1.0);
            self.0 -= 1;
            let lost_samples = if self.0 == 1 { 20 } else { 0 };
            Ok((self.0 > 0).then_some(MadeBlock { lost_samples, ..MadeBlock::default() }))
        }
    }

    #[test]
    fn blocks_are_due_one_after_the_other_from_the_start_but_for_missing_samples_and_end() {
        // 20 missing samples last 10 ms.
        for (longest_silence_s, last_due_ms) in [(10.0, 25), (0.005, 20)] {
            let pace = Pace::True { sample_rate_hz: 2000.0, jitter_ns: 0.0, seed: 1, longest_silence_s };
            let mut source = Paced::new(Ones(4), pace, 10);
            source.start().unwrap();
            let mut samples = [0.0; 10];
            for (first_sample, due_ms) in [(0, 5), (10, 10), (40, last_due_ms)] {
                let Next::Block(made) = source.next_block(&mut samples).unwrap() else { panic!("a block") };
                assert_eq!(made.first_sample, first_sample);
                assert_eq!(made.captured_ns, source.start_ns + 1_000_000 * due_ms);
                assert_eq!(made.publish_at_ns, made.captured_ns);
            }
            assert_eq!(source.next_block(&mut samples).unwrap(), Next::End);
        }
    }

    #[test]
    fn jitter_delays_the_publication_and_not_the_capture() {
        let pace = Pace::True { sample_rate_hz: 2000.0, jitter_ns: 3e6, seed: 1, longest_silence_s: 10.0 };
        let mut source = Paced::new(Ones(100), pace, 10);
        source.start().unwrap();
        let delays_ns: Vec<u64> = (0..50)
            .map(|_| match source.next_block(&mut [0.0; 10]).unwrap() {
                Next::Block(block) => block.publish_at_ns - block.captured_ns,
                other => panic!("{other:?}"),
            })
            .collect();
        assert!(delays_ns.iter().all(|delay| *delay <= 3_000_000));
        assert!(delays_ns.iter().max() > delays_ns.iter().min());
    }
}
