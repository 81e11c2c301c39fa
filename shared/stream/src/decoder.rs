//! Frames in, runs of samples out.

/// The bytes that every frame begins with.
pub const MAGIC: [u8; 4] = *b"EMGf";
/// Most samples of a channel in a frame.
pub const LONGEST_FRAME: u32 = 100_000;
/// Longest loss that is believed, s.
const LONGEST_LOSS_S: f64 = 60.0;
/// Bytes before the samples of a frame.
const HEAD: usize = 16;

/// What comes is no frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// It begins with something else.
    #[error(
        "a frame begins with the bytes {found:?} instead of \"EMGf\": does every frame hold as many samples as it says?"
    )]
    Magic {
        /// Its first bytes.
        found: [u8; 4],
    },
    /// It says that it holds nothing, or more than may be.
    #[error("a frame of {samples} samples: send 1 to {LONGEST_FRAME}, best those of 5 to 20 ms")]
    Length {
        /// What it says.
        samples: u32,
    },
    /// Its samples came before, or far too many were lost.
    #[error(
        "the first sample of a frame is {first_sample}, after {expected}: indices rise, and samples that were lost count"
    )]
    Index {
        /// What it says.
        first_sample: u64,
        /// The index that would come next.
        expected: u64,
    },
}

/// Samples that follow one another without a loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instants<'a> {
    /// Index of the first, as the frame says it.
    pub first_sample: u64,
    /// `[samples × channels]`.
    pub instants: &'a [f32],
}

/// Decodes the frames of one connection. Holds no more than a read and the beginning of a sample, however long a frame says
/// that it is. Allocates nothing once it has seen its longest read.
#[derive(Clone, Debug)]
pub struct Decoder {
    channels: usize,
    longest_loss: u64,
    /// Beginning of a head or an instant whose rest has not come.
    torn: Vec<u8>,
    instants: Vec<f32>,
    /// Samples of the current frame that have not come.
    left: u32,
    /// Index of the first of `instants`.
    first_sample: u64,
    /// Index after the newest sample; `None` before the first frame.
    next_sample: Option<u64>,
}

impl Decoder {
    /// For frames of so many channels, at this rate.
    pub fn new(channels: usize, rate_hz: f64) -> Decoder {
        Decoder {
            channels,
            longest_loss: (LONGEST_LOSS_S * rate_hz) as u64,
            torn: Vec::with_capacity(HEAD.max(4 * channels)),
            instants: Vec::new(),
            left: 0,
            first_sample: 0,
            next_sample: None,
        }
    }

    /// Takes the bytes of a read, and gives every run of samples without a loss to `take`.
    ///
    /// # Errors
    ///
    /// [`FrameError`]: what follows cannot be read.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Instants<'_>)) -> Result<(), FrameError> {
        let mut bytes = bytes;
        loop {
            let wanted = if self.left == 0 { HEAD } else { 4 * self.channels };
            if self.torn.is_empty() && bytes.len() >= wanted {
                let (piece, rest) = bytes.split_at(wanted);
                self.piece(piece, &mut take)?;
                bytes = rest;
                continue;
            }
            let (part, rest) = bytes.split_at(bytes.len().min(wanted - self.torn.len()));
            self.torn.extend_from_slice(part);
            bytes = rest;
            if self.torn.len() < wanted {
                break;
            }
            let mut torn = std::mem::take(&mut self.torn);
            let taken = self.piece(&torn, &mut take);
            torn.clear();
            self.torn = torn;
            taken?;
        }
        self.hand_over(&mut take);
        Ok(())
    }

    /// Takes a head, or the channels of a sample.
    fn piece(&mut self, piece: &[u8], take: &mut impl FnMut(Instants<'_>)) -> Result<(), FrameError> {
        if self.left > 0 {
            let values = piece
                .chunks_exact(4)
                .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
            self.instants.extend(values);
            self.left -= 1;
            return Ok(());
        }
        let word = |at: usize, length: usize| {
            piece[at..at + length].iter().rev().fold(0_u64, |word, byte| word << 8 | u64::from(*byte))
        };
        let found = [piece[0], piece[1], piece[2], piece[3]];
        let (samples, first_sample) = (word(4, 4) as u32, word(8, 8));
        if found != MAGIC {
            return Err(FrameError::Magic { found });
        }
        if !(1..=LONGEST_FRAME).contains(&samples) {
            return Err(FrameError::Length { samples });
        }
        let expected = self.next_sample.map_or(first_sample, |next| next);
        let lost = first_sample.checked_sub(expected).filter(|lost| *lost <= self.longest_loss);
        // So that no later index overflows.
        let end = first_sample.checked_add(u64::from(samples)).filter(|end| *end <= i64::MAX as u64);
        let (Some(lost), Some(end)) = (lost, end) else {
            return Err(FrameError::Index { first_sample, expected });
        };
        if lost > 0 || self.next_sample.is_none() {
            self.hand_over(take);
            self.first_sample = first_sample;
        }
        self.next_sample = Some(end);
        self.left = samples;
        Ok(())
    }

    fn hand_over(&mut self, take: &mut impl FnMut(Instants<'_>)) {
        let samples = (self.instants.len() / self.channels) as u64;
        if samples > 0 {
            take(Instants { first_sample: self.first_sample, instants: &self.instants });
            self.first_sample += samples;
            self.instants.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A frame of samples `[sample, -sample]`.
    fn frame(first_sample: u64, samples: u32) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(samples.to_le_bytes());
        bytes.extend(first_sample.to_le_bytes());
        for sample in first_sample..first_sample + u64::from(samples) {
            bytes.extend((sample as f32).to_le_bytes());
            bytes.extend((-(sample as f32)).to_le_bytes());
        }
        bytes
    }

    /// Index and value of every sample, pushed in reads of these lengths in turn.
    fn decode(bytes: &[u8], reads: &[usize]) -> Result<Vec<(u64, f32)>, FrameError> {
        let mut decoder = Decoder::new(2, 2000.0);
        let (mut left, mut found) = (bytes, Vec::new());
        for length in reads.iter().cycle() {
            let (read, rest) = left.split_at((*length).min(left.len()));
            left = rest;
            decoder.push(read, |run| {
                let samples = run.instants.chunks_exact(2).zip(run.first_sample..);
                found.extend(samples.map(|(instant, index)| (index, instant[0])));
            })?;
            if left.is_empty() {
                break;
            }
        }
        Ok(found)
    }

    #[test]
    fn frames_are_read_and_a_jump_of_the_index_is_a_loss() {
        let bytes = [frame(5, 3), frame(8, 1), frame(100, 2)].concat();
        let found = decode(&bytes, &[10_000]).unwrap();
        let numbers: Vec<u64> = found.iter().map(|(index, _)| *index).collect();
        assert_eq!(numbers, [5, 6, 7, 8, 100, 101]);
        assert!(found.iter().all(|(index, value)| *index as f32 == *value));
    }

    #[test]
    fn what_is_no_frame_is_refused_with_the_reason() {
        let refusal = |bytes: Vec<u8>| decode(&bytes, &[10_000]).unwrap_err().to_string();
        assert!(refusal(vec![b'x'; 100]).contains("instead of \"EMGf\""));
        assert!(
            refusal([frame(0, 5), frame(4, 5)].concat()).contains("first sample of a frame is 4, after 5")
        );
        assert!(refusal([frame(0, 5), frame(1_000_000, 5)].concat()).contains("after 5"));
        let long = |samples: u32| [MAGIC.as_slice(), &samples.to_le_bytes(), &[0; 8]].concat();
        assert!(refusal(long(0)).contains("a frame of 0 samples"));
        assert!(refusal(long(u32::MAX)).contains("4294967295"));
        assert!(refusal([&MAGIC[..], &[1, 0, 0, 0], &[0xFF; 8]].concat()).contains("first sample"));
    }

    proptest! {
        #[test]
        fn reads_of_any_length_give_the_same_samples(
            frames in proptest::collection::vec((1_u32..40, 0_u64..20), 1..20),
            reads in proptest::collection::vec(1_usize..100, 1..10),
        ) {
            let (mut bytes, mut next) = (Vec::new(), 3);
            for (samples, lost) in frames {
                bytes.extend(frame(next + lost, samples));
                next += lost + u64::from(samples);
            }
            prop_assert_eq!(decode(&bytes, &reads).unwrap(), decode(&bytes, &[bytes.len()]).unwrap());
        }

        #[test]
        fn any_bytes_are_taken_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..500)) {
            let _ = decode(&[&MAGIC, &bytes[..]].concat(), &[7, 100]);
            let _ = crate::Header::parse(&bytes);
        }
    }
}
