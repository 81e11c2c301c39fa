//! The simulated devices and their inputs.

use crate::errors::{NO_CHANNEL, NO_DEVICE, Refusal};

/// A simulated device.
#[derive(Clone, Copy, Debug)]
pub struct Device {
    pub name: &'static str,
    pub product: &'static str,
    /// NI's number of the category.
    pub category: i32,
    pub inputs: usize,
    /// Highest rate, Hz.
    pub fastest_hz: f64,
    pub serial: u32,
}

pub const DEVICES: [Device; 3] = [
    Device {
        name: "cDAQ1",
        product: "cDAQ-9171",
        category: 14658,
        inputs: 0,
        fastest_hz: 0.0,
        serial: 0x1234,
    },
    Device {
        name: "cDAQ1Mod1",
        product: "NI 9215",
        category: 14659,
        inputs: 4,
        fastest_hz: 100_000.0,
        serial: 0x1235,
    },
    Device {
        name: "Dev1",
        product: "USB-6255",
        category: 14646,
        inputs: 80,
        fastest_hz: 15_000.0,
        serial: 0x1236,
    },
];

/// The device of this name.
pub fn device(name: &str) -> Result<&'static Device, Refusal> {
    DEVICES.iter().find(|device| device.name == name.trim()).ok_or(NO_DEVICE)
}

/// Names of a device's inputs.
pub fn inputs_of(device: &Device) -> String {
    let names: Vec<String> = (0..device.inputs).map(|input| format!("{}/ai{input}", device.name)).collect();
    names.join(", ")
}

/// The inputs that a text such as `cDAQ1Mod1/ai0:3, Dev1/ai7` names: device and number.
pub fn parse(text: &str) -> Result<Vec<(&'static Device, usize)>, Refusal> {
    let mut inputs = Vec::new();
    for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
        let (name, range) = part.split_once('/').ok_or(NO_CHANNEL)?;
        let device = device(name)?;
        let range = range.strip_prefix("ai").ok_or(NO_CHANNEL)?;
        let number = |text: &str| {
            let digits = text.strip_prefix("ai").unwrap_or(text);
            digits.parse::<usize>().map_err(|_| NO_CHANNEL)
        };
        let (first, last) = match range.split_once(':') {
            Some((first, last)) => (number(first)?, number(last)?),
            None => (number(range)?, number(range)?),
        };
        let rising = first.min(last)..=first.max(last);
        let mut numbers: Vec<usize> = rising.collect();
        if first > last {
            numbers.reverse();
        }
        if numbers.iter().any(|input| *input >= device.inputs) {
            return Err(NO_CHANNEL);
        }
        inputs.extend(numbers.into_iter().map(|input| (device, input)));
    }
    if inputs.is_empty() { Err(NO_CHANNEL) } else { Ok(inputs) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_read_as_the_driver_reads_them() {
        let numbers = |text: &str| parse(text).map(|inputs| inputs.iter().map(|(_, input)| *input).collect());
        assert_eq!(numbers("cDAQ1Mod1/ai0:3"), Ok(vec![0, 1, 2, 3]));
        assert_eq!(numbers("cDAQ1Mod1/ai3:ai1, Dev1/ai79"), Ok(vec![3, 2, 1, 79]));
        assert_eq!(numbers("cDAQ1Mod1/ai4"), Err::<Vec<usize>, _>(NO_CHANNEL));
        assert_eq!(numbers("cDAQ9/ai0"), Err(NO_DEVICE));
        assert_eq!(numbers("cDAQ1/ai0"), Err(NO_CHANNEL), "a chassis has no inputs");
        assert_eq!(numbers(""), Err(NO_CHANNEL));
    }
}
