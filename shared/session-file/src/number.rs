//! An `f32` that JSON holds exactly.

use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// An `f32` in JSON. NaN is `null` (which NaN it was is lost), an infinity `"inf"` or `"-inf"`. Every other one reads back
/// bit for bit. It is written as the `f64` that it equals: readers go through an `f64`, and the shortest text of an `f32` may lie
/// so near the middle between two of them that this rounds to the wrong one.
#[derive(Clone, Copy, Debug)]
pub struct Number(pub f32);

/// Bit for bit; one NaN is as good as another.
impl PartialEq for Number {
    fn eq(&self, other: &Number) -> bool {
        self.0.to_bits() == other.0.to_bits() || (self.0.is_nan() && other.0.is_nan())
    }
}

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            number if number.is_nan() => serializer.serialize_unit(),
            f32::INFINITY => serializer.serialize_str("inf"),
            f32::NEG_INFINITY => serializer.serialize_str("-inf"),
            number => serializer.serialize_f64(number.into()),
        }
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Number, D::Error> {
        deserializer.deserialize_any(NumberVisitor)
    }
}

struct NumberVisitor;

impl Visitor<'_> for NumberVisitor {
    type Value = Number;

    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("a number, null, \"inf\" or \"-inf\"")
    }

    fn visit_unit<E: Error>(self) -> Result<Number, E> {
        Ok(Number(f32::NAN))
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Number, E> {
        Ok(Number(number as f32))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Number, E> {
        Ok(Number(number as f32))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Number, E> {
        Ok(Number(number as f32))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Number, E> {
        match text {
            "inf" => Ok(Number(f32::INFINITY)),
            "-inf" => Ok(Number(f32::NEG_INFINITY)),
            _ => Err(E::invalid_value(Unexpected::Str(text), &self)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn every_number_reads_back_bit_for_bit(bits: u32) {
            let number = Number(f32::from_bits(bits));
            let text = serde_json::to_string(&number).unwrap();
            prop_assert_eq!(serde_json::from_str::<Number>(&text).unwrap(), number, "{}", text);
        }
    }

    #[test]
    fn what_is_no_number_is_refused_and_zeros_keep_their_sign() {
        for zero in [0.0_f32, -0.0] {
            let text = serde_json::to_string(&Number(zero)).unwrap();
            assert_eq!(serde_json::from_str::<Number>(&text).unwrap().0.to_bits(), zero.to_bits(), "{text}");
        }
        assert_ne!(Number(0.0), Number(-0.0));
        for text in ["\"infinite\"", "[]", "true", "{}"] {
            assert!(serde_json::from_str::<Number>(text).is_err(), "{text}");
        }
    }
}
