//! What the thread of the driver hands over: records in a pipe, all of one length.
//!
//! ```text
//! first sample u64 │ received, CLOCK_MONOTONIC ns u64 │ samples × channels f32, all channels of an instant together
//! ```
//! The bytes never leave the process, so they are in its own order.

use std::io::{ErrorKind, PipeReader, Read};

/// Length of what comes before the samples.
const HEAD_BYTES: usize = 16;

/// A record to be filled and written.
#[derive(Debug)]
pub struct Outgoing {
    bytes: Vec<u8>,
}

impl Outgoing {
    /// For `values` samples of all channels together.
    pub fn new(values: usize) -> Outgoing {
        Outgoing { bytes: Vec::with_capacity(HEAD_BYTES + values * size_of::<f32>()) }
    }

    /// The bytes of a record.
    pub fn bytes(
        &mut self,
        first_sample: u64,
        received_ns: u64,
        samples: impl Iterator<Item = f32>,
    ) -> &[u8] {
        self.bytes.clear();
        self.bytes.extend(first_sample.to_ne_bytes());
        self.bytes.extend(received_ns.to_ne_bytes());
        self.bytes.extend(samples.flat_map(f32::to_ne_bytes));
        &self.bytes
    }
}

/// Takes records out of a pipe that does not wait.
#[derive(Debug)]
pub struct Incoming {
    bytes: Vec<u8>,
    filled: usize,
    /// Samples of the newest record.
    samples: Vec<f32>,
}

/// The head of a record, whose samples are in [`Incoming::samples`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    pub first_sample: u64,
    pub received_ns: u64,
}

impl Incoming {
    /// For `values` samples of all channels together.
    pub fn new(values: usize) -> Incoming {
        Incoming {
            bytes: vec![0; HEAD_BYTES + values * size_of::<f32>()],
            filled: 0,
            samples: Vec::with_capacity(values),
        }
    }

    /// The samples of the newest record.
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// Takes the next record; `None` while it is not there as a whole.
    ///
    /// # Errors
    ///
    /// When the pipe cannot be read, or its other end is gone.
    pub fn take(&mut self, pipe: &mut PipeReader) -> std::io::Result<Option<Head>> {
        while self.filled < self.bytes.len() {
            match pipe.read(&mut self.bytes[self.filled..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => self.filled += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.filled = 0;
        let (head, samples) = self.bytes.split_at(HEAD_BYTES);
        let word = |bytes: &[u8]| u64::from_ne_bytes(bytes.try_into().expect("eight bytes were cut"));
        self.samples.clear();
        let value = |bytes: &[u8]| f32::from_ne_bytes(bytes.try_into().expect("four bytes were cut"));
        self.samples.extend(samples.chunks_exact(size_of::<f32>()).map(value));
        Ok(Some(Head { first_sample: word(&head[..8]), received_ns: word(&head[8..]) }))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use nix::fcntl::{FcntlArg, OFlag, fcntl};

    use super::*;

    #[test]
    fn a_record_that_comes_in_pieces_is_read_as_it_was_written() {
        let (mut pipe, mut end) = std::io::pipe().unwrap();
        fcntl(&pipe, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
        let (mut outgoing, mut incoming) = (Outgoing::new(3), Incoming::new(3));
        let bytes = outgoing.bytes(7, 99, [1.0, -2.0, f32::MAX].into_iter()).to_vec();
        end.write_all(&bytes[..17]).unwrap();
        assert_eq!(incoming.take(&mut pipe).unwrap(), None);
        end.write_all(&bytes[17..]).unwrap();
        assert_eq!(incoming.take(&mut pipe).unwrap(), Some(Head { first_sample: 7, received_ns: 99 }));
        assert_eq!(incoming.samples(), [1.0, -2.0, f32::MAX]);
        drop(end);
        assert_eq!(incoming.take(&mut pipe).unwrap_err().kind(), ErrorKind::UnexpectedEof);
    }
}
