//! Long lists of numbers in a text file: base64 of little-endian `f64`, so that what is read is to the bit what was
//! written.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde::{Deserialize, Deserializer, Serializer, de::Error};

pub(crate) fn serialize<S: Serializer>(numbers: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    serializer.serialize_str(&BASE64_STANDARD.encode(bytes))
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let bytes = BASE64_STANDARD.decode(text).map_err(D::Error::custom)?;
    let (numbers, []) = bytes.as_chunks::<8>() else {
        return Err(D::Error::custom("the numbers are cut short"));
    };
    Ok(numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect())
}
