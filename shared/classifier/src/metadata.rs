//! What a model file says of itself, read without ONNX Runtime: for programs that only tell which model it is.
//!
//! An ONNX file is a protobuf message `ModelProto`; its field 14 repeats key (1) and value (2) of the metadata
//! (onnx.proto3). Everything else is passed over.

use std::io;
use std::path::Path;

use crate::{Contract, TrainedOn};

/// Field of the metadata in a `ModelProto`.
const METADATA: u64 = 14;

/// Whom the model in this file was trained on, as far as it says.
///
/// # Errors
///
/// When the file cannot be read.
pub fn trained_on(model: &Path) -> io::Result<TrainedOn> {
    let content = tendon_input::read(model, tendon_input::LARGEST_MODEL)?;
    // Numbers that are none make the model unusable: whoever loads it says so.
    Ok(TrainedOn::read(|key| metadata(&content, key)).unwrap_or_default())
}

/// What the model in this file was trained for; `None` if that does not make sense, which whoever loads it says.
///
/// # Errors
///
/// When the file cannot be read.
pub fn contract_of(model: &Path) -> io::Result<Option<Contract>> {
    let content = tendon_input::read(model, tendon_input::LARGEST_MODEL)?;
    Ok(Contract::read(|key| metadata(&content, key)).ok())
}

/// The metadata's value for `key`.
fn metadata(model: &[u8], key: &str) -> Option<String> {
    for (number, content) in Fields(model) {
        if number == METADATA {
            let text = |wanted| {
                let mut entry = Fields(content);
                let found = entry.find(|(number, _)| *number == wanted)?;
                std::str::from_utf8(found.1).ok()
            };
            if text(1) == Some(key) {
                return text(2).map(str::to_owned);
            }
        }
    }
    None
}

/// The length-delimited fields of a protobuf message, by number; ends at the first byte that makes no sense.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (byte, rest) = self.0.split_first()?;
            self.0 = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u64, &'a [u8]);

    fn next(&mut self) -> Option<(u64, &'a [u8])> {
        loop {
            let tag = self.varint()?;
            let length = match tag & 7 {
                0 => {
                    self.varint()?;
                    continue;
                }
                1 => 8,
                2 => usize::try_from(self.varint()?).ok()?,
                5 => 4,
                _ => return None,
            };
            let (content, rest) = self.0.split_at_checked(length)?;
            self.0 = rest;
            if tag & 7 == 2 {
                return Some((tag >> 3, content));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_models_that_come_with_tendon_say_whom_they_were_trained_on() {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
        for model in ["cnn-five-gesture.onnx", "cnn-six-class.onnx", "cnn-rest-move.onnx"] {
            let TrainedOn { data_set, people, .. } = trained_on(&models.join(model)).unwrap();
            assert_eq!(data_set.as_deref(), Some("3DC"), "{model}");
            assert_eq!(people, [1, 3, 4, 5, 6, 7, 9, 11, 12, 13, 14, 15], "{model}");
            let contract = contract_of(&models.join(model)).unwrap().unwrap();
            assert_eq!((contract.channels, contract.remembered_channels().len()), (4, 0), "{model}");
        }
    }

    #[test]
    fn what_is_no_model_says_nothing() {
        let entry = b"\x72\x0a\x0a\x01k\x12\x05value";
        assert_eq!(metadata(entry, "k").as_deref(), Some("value"));
        for broken in [&b""[..], b"\xff", b"\x72\xff\xff\xff\xff\xff\xff\xff\xff\x7f", &entry[..5]] {
            assert_eq!(metadata(broken, "k"), None);
        }
        assert_eq!(metadata(entry, "other"), None);
    }
}
