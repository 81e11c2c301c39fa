//! Numbers out of a part of a file, one after the other, little-endian.

use crate::mat::problem::MatError;

#[derive(Clone, Copy)]
pub(super) struct Bytes<'a> {
    left: &'a [u8],
}

impl<'a> Bytes<'a> {
    pub(super) fn new(left: &'a [u8]) -> Bytes<'a> {
        Bytes { left }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.left.is_empty()
    }

    pub(super) fn len(&self) -> usize {
        self.left.len()
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], MatError> {
        let (taken, left) =
            self.left.split_at_checked(count).ok_or(MatError::Damaged("a part of it is too short"))?;
        self.left = left;
        Ok(taken)
    }

    pub(super) fn skip(&mut self, count: usize) -> Result<(), MatError> {
        self.take(count).map(|_| ())
    }

    /// Checks the letters that a part begins with.
    pub(super) fn expect(&mut self, signature: &[u8; 4]) -> Result<(), MatError> {
        if self.take(4)? == signature {
            Ok(())
        } else {
            Err(MatError::Damaged("it refers to a part that is none"))
        }
    }

    /// A number of up to eight bytes.
    pub(super) fn number(&mut self, count: usize) -> Result<u64, MatError> {
        Ok(self.take(count)?.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }

    pub(super) fn u8(&mut self) -> Result<u8, MatError> {
        Ok(self.number(1)? as u8)
    }

    pub(super) fn u16(&mut self) -> Result<u16, MatError> {
        Ok(self.number(2)? as u16)
    }

    pub(super) fn u32(&mut self) -> Result<u32, MatError> {
        Ok(self.number(4)? as u32)
    }

    pub(super) fn u64(&mut self) -> Result<u64, MatError> {
        self.number(8)
    }
}
