//! What the driver says when something is wrong, and what to do about it.

use std::path::PathBuf;

/// The driver cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// It is not installed.
    #[error(
        "NI-DAQmx was not found ({}: {reason}): install NI-DAQmx for Linux from ni.com (package ni-daqmx), or name its library \
         in acquisition.nidaqmx.library",
        path.display()
    )]
    NotFound {
        /// Where it was looked for.
        path: PathBuf,
        /// What the dynamic linker says.
        reason: String,
    },
    /// The library lacks a function.
    #[error("{}: has no function {function}: is it NI-DAQmx 20 or later?", path.display())]
    Function {
        /// The library.
        path: PathBuf,
        /// The function.
        function: &'static str,
    },
}

/// What kind of trouble an error of the driver means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// Samples were overwritten, or not acquired, because nobody took them in time.
    Overrun,
    /// They have not come yet.
    NotYet,
    /// There is no such device or channel.
    NoDevice,
    /// Somebody else uses it.
    InUse,
    /// The device was there and is gone.
    Unplugged,
    /// A value that the device does not take.
    BadValue,
    /// Anything else.
    Other,
}

impl Trouble {
    /// What an error code of the driver means.
    pub fn of(code: i32) -> Trouble {
        match code {
            -200_279 | -200_222 | -200_361 | -200_010 | -200_019 | -200_714 => Trouble::Overrun,
            -200_284 | -200_278 | -200_474 => Trouble::NotYet,
            -200_220 | -200_170 => Trouble::NoDevice,
            -50_103 | -200_089 => Trouble::InUse,
            -201_003 | -200_324 | -200_045 | -88_717 | -88_705 | -89_130 | -50_405 | -50_808 | -50_300
            | -201_190 => Trouble::Unplugged,
            -200_077 => Trouble::BadValue,
            _ => Trouble::Other,
        }
    }

    /// What to do about it.
    fn remedy(self) -> &'static str {
        match self {
            Trouble::Overrun => {
                "samples were lost because they were not taken in time: is the computer overloaded, or the buffer too small?"
            }
            Trouble::NotYet => "no samples came: does the device still run?",
            Trouble::NoDevice => {
                "there is no such device or channel: `tendon sources` lists those there are; set acquisition.nidaqmx.channels"
            }
            Trouble::InUse => "another program uses the device: close it",
            Trouble::Unplugged => "the device is gone: plug it in again",
            Trouble::BadValue => "the device does not take this value: see its specifications",
            Trouble::Other => "see the code at ni.com",
        }
    }
}

/// A call that the driver refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("DAQmx{call}: {text} (code {code}): {}", Trouble::of(*code).remedy())]
pub struct DaqmxError {
    /// The function, without its prefix.
    pub call: &'static str,
    /// The driver's code, below zero.
    pub code: i32,
    /// What the driver says of it, on one line.
    pub text: String,
}

impl DaqmxError {
    /// What kind of trouble it is.
    pub fn trouble(&self) -> Trouble {
        Trouble::of(self.code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_what_the_driver_says_and_what_to_do() {
        let error = DaqmxError { call: "ReadAnalogF64", code: -200_279, text: "Overwritten.".to_owned() };
        assert_eq!(error.trouble(), Trouble::Overrun);
        let said = error.to_string();
        assert!(
            said.starts_with("DAQmxReadAnalogF64: Overwritten. (code -200279): samples were lost"),
            "{said}"
        );
        assert_eq!(Trouble::of(-88_705), Trouble::Unplugged);
    }
}
