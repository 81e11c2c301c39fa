//! A block of raw samples as bytes: little-endian, bit for bit.
//!
//! ```text
//! byte  0  sequence               u64    56  truth: gesture        u8, its class number; 255: not known
//!       8  captured_ns            u64    57  zeros                 7 bytes
//!      16  published_ns           u64    64  channels              u32
//!      24  first_sample           u64    68  samples               u32, of each channel
//!      32  sample_rate_hz         f64    72  non_finite_samples    u32
//!      40  truth: since_sample    u64    76  zeros                 4 bytes
//!      48  zeros                  u64    80  f32 [channels × samples], channel-major
//! ```

use tendon_messages::{BlockHeader, Stage, Trace, Truth};

/// Bytes before the samples.
const HEADER_LENGTH: usize = 80;
/// The class number that stands for none.
const UNKNOWN: u8 = u8::MAX;

/// The same layout in words, as the file says it.
pub(crate) const LAYOUT: &str = "little-endian: u64 sequence, u64 captured_ns, u64 published_ns, u64 first_sample, \
    f64 sample_rate_hz, u64 truth_since_sample, u64 zero, u8 truth_gesture (class number, 255 unknown), 7 zero bytes, \
    u32 channels, u32 samples, u32 non_finite_samples, u32 zero, then f32 [channels x samples], channel-major. \
    Times are CLOCK_MONOTONIC in ns.";

/// A block of raw samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Block {
    /// Sequence number on the topic.
    pub sequence: u64,
    /// When its newest sample was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
    /// When it was published, CLOCK_MONOTONIC ns.
    pub published_ns: u64,
    /// Index of its first sample since the source began.
    pub first_sample: u64,
    /// Sampling rate in Hz.
    pub sample_rate_hz: f64,
    /// The true gesture at its newest sample.
    pub truth: Truth,
    /// Number of channels.
    pub channels: u32,
    /// Samples of each channel.
    pub samples: u32,
    /// NaN and infinite ones among the samples.
    pub non_finite_samples: u32,
    /// `[channels × samples]`, channel-major.
    pub values: Vec<f32>,
}

impl Block {
    /// A block as it was received.
    pub fn of(header: &BlockHeader, values: &[f32]) -> Block {
        let Trace { sequence, captured_ns, published_ns, .. } = header.trace;
        Block {
            sequence,
            captured_ns,
            published_ns: published_ns[Stage::Acquisition.index()],
            first_sample: header.first_sample,
            sample_rate_hz: header.sample_rate_hz,
            truth: header.truth,
            channels: header.channels,
            samples: header.samples,
            non_finite_samples: header.non_finite_samples,
            values: values.to_vec(),
        }
    }

    /// Writes it behind what `bytes` holds.
    pub(crate) fn encode(&self, bytes: &mut Vec<u8>) {
        for word in [self.sequence, self.captured_ns, self.published_ns, self.first_sample] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(self.sample_rate_hz.to_le_bytes());
        bytes.extend(self.truth.since_sample().to_le_bytes());
        bytes.extend(0_u64.to_le_bytes());
        bytes.extend([self.truth.gesture().unwrap_or(UNKNOWN), 0, 0, 0, 0, 0, 0, 0]);
        for word in [self.channels, self.samples, self.non_finite_samples, 0] {
            bytes.extend(word.to_le_bytes());
        }
        for value in &self.values {
            bytes.extend(value.to_le_bytes());
        }
    }

    /// Reads it; `None` if the bytes are none. Without the samples where they are not wanted.
    pub(crate) fn decode(bytes: &[u8], with_values: bool) -> Option<Block> {
        let mut block = Block::default();
        block.read(bytes, with_values).then_some(block)
    }

    /// The same into this one, whose room for samples is used again; whether the bytes are a block.
    pub(crate) fn read(&mut self, bytes: &[u8], with_values: bool) -> bool {
        let mut values = std::mem::take(&mut self.values);
        values.clear();
        let header = bytes.split_at_checked(HEADER_LENGTH).and_then(|(header, samples)| {
            let header = Block::decode_header(header, samples.len())?;
            let (words, _) = samples.as_chunks();
            if with_values {
                values.extend(words.iter().map(|word| f32::from_le_bytes(*word)));
            }
            Some(header)
        });
        let is_block = header.is_some();
        *self = Block { values, ..header.unwrap_or_default() };
        is_block
    }

    /// Reads a header, without samples; `None` if it is none for so many bytes of samples.
    fn decode_header(header: &[u8], bytes_of_samples: usize) -> Option<Block> {
        let u64_at = |at: usize| header[at..at + 8].try_into().ok().map(u64::from_le_bytes);
        let u32_at = |at: usize| header[at..at + 4].try_into().ok().map(u32::from_le_bytes);
        let gesture = Some(header[56]).filter(|gesture| *gesture != UNKNOWN);
        let (channels, samples) = (u32_at(64)?, u32_at(68)?);
        let length = (channels as usize).checked_mul(samples as usize)?.checked_mul(size_of::<f32>())?;
        if bytes_of_samples != length || length == 0 {
            return None;
        }
        Some(Block {
            sequence: u64_at(0)?,
            captured_ns: u64_at(8)?,
            published_ns: u64_at(16)?,
            first_sample: u64_at(24)?,
            sample_rate_hz: f64::from_bits(u64_at(32)?),
            truth: Truth::new(gesture, u64_at(40)?),
            channels,
            samples,
            non_finite_samples: u32_at(72)?,
            values: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_block_reads_back_bit_for_bit_and_no_other_length_is_one(
            words in prop::collection::vec(any::<u32>(), 12),
            header: [u64; 5],
            gesture in prop::option::of(0_u8..13),
            cut in 0_usize..200,
        ) {
            let block = Block {
                sequence: header[0],
                captured_ns: header[1],
                published_ns: header[2],
                first_sample: header[3],
                sample_rate_hz: 1259.259,
                truth: Truth::new(gesture, header[4]),
                channels: 4,
                samples: 3,
                non_finite_samples: 1,
                values: words.iter().map(|word| f32::from_bits(*word)).collect(),
            };
            let mut bytes = Vec::new();
            block.encode(&mut bytes);
            let read = Block::decode(&bytes, true).unwrap();
            let bits: Vec<u32> = read.values.iter().map(|value| value.to_bits()).collect();
            prop_assert_eq!(bits, words);
            let without = Block { values: Vec::new(), ..block };
            prop_assert_eq!(Block { values: Vec::new(), ..read }, without.clone());
            prop_assert_eq!(Block::decode(&bytes, false), Some(without));
            if cut != bytes.len() {
                bytes.resize(cut, 0);
                prop_assert_eq!(Block::decode(&bytes, true), None);
            }
        }
    }
}
