//! NI-DAQmx: National Instruments' driver, as far as measuring voltages needs it.
//!
//! ```text
//! libnidaqmx.so.1 ──loaded at run time──▶ Daqmx ──▶ devices, version
//!                                           └─▶ Task: channels ─▶ sample clock ─▶ start ─▶ read, read, …
//! ```
//!
//! The device's own clock times the samples. A reader that is too slow gets an error, so nothing is lost silently. The driver
//! has no time stamps.
//!
//! Names, numbers and signatures are those of NI's header `NIDAQmx.h`. All calls block at most as long as they are told.
#![deny(unsafe_op_in_unsafe_fn)]

mod error;
mod functions;
mod settings;
mod task;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use error::{DaqmxError, LoadError, Trouble};
pub use settings::{InvalidNidaqmxSetting, NidaqmxSettings, Terminal};
pub use task::Task;

use crate::functions::Functions;

/// The names under which the driver is looked for.
const LIBRARY_NAMES: [&str; 2] = ["libnidaqmx.so.1", "libnidaqmx.so"];
/// Longest list of names that is read, bytes.
const LONGEST_LIST: usize = 16 << 10;

/// The driver.
#[derive(Clone, Debug)]
pub struct Daqmx {
    functions: Arc<Functions>,
    path: PathBuf,
}

/// A device that the driver knows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    /// Its name, such as `cDAQ1Mod1`.
    pub name: String,
    /// What it is, such as `NI 9215`.
    pub product: String,
    /// Its analog inputs, such as `cDAQ1Mod1/ai0`.
    pub analog_inputs: Vec<String>,
    /// Whether it exists in software only.
    pub is_simulated: bool,
}

impl Daqmx {
    /// Loads the driver: from `library`, or from where the dynamic linker finds it.
    ///
    /// # Errors
    ///
    /// [`LoadError`] when it is not installed, or lacks a function.
    pub fn load(library: Option<&Path>) -> Result<Daqmx, LoadError> {
        let names = match library {
            Some(library) => vec![library.to_owned()],
            None => LIBRARY_NAMES.map(PathBuf::from).to_vec(),
        };
        let mut refusals = Vec::new();
        for name in names {
            match Functions::load(&name) {
                Ok(functions) => return Ok(Daqmx { functions: Arc::new(functions), path: name }),
                Err(LoadError::NotFound { reason, .. }) => refusals.push(reason),
                Err(error) => return Err(error),
            }
        }
        let path = library.map_or_else(|| LIBRARY_NAMES[0].into(), Path::to_owned);
        Err(LoadError::NotFound { path, reason: refusals.swap_remove(0) })
    }

    /// Where it was found.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its version, such as `26.5`.
    ///
    /// # Errors
    ///
    /// [`DaqmxError`] when the driver does not answer.
    pub fn version(&self) -> Result<String, DaqmxError> {
        let (major, minor) = self.functions.version()?;
        Ok(format!("{major}.{minor}"))
    }

    /// The devices that it knows, chassis without inputs among them.
    ///
    /// # Errors
    ///
    /// [`DaqmxError`] when the driver does not answer.
    pub fn devices(&self) -> Result<Vec<Device>, DaqmxError> {
        let names = self.functions.device_names()?;
        let device = |name: &str| {
            Ok(Device {
                name: name.to_owned(),
                product: self.functions.product(name)?,
                analog_inputs: list(&self.functions.analog_inputs(name)?).map(str::to_owned).collect(),
                is_simulated: self.functions.is_simulated(name)?,
            })
        };
        list(&names).map(device).collect()
    }
}

/// The names of a list of the driver's.
fn list(names: &str) -> impl Iterator<Item = &str> {
    names.split(',').map(str::trim).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_that_is_not_there_is_refused_with_a_remedy() {
        let refused = Daqmx::load(Some(Path::new("/nonexistent/libnidaqmx.so.1"))).unwrap_err().to_string();
        assert!(refused.contains("/nonexistent/libnidaqmx.so.1") && refused.contains("ni.com"), "{refused}");
    }

    #[test]
    fn names_of_a_list_are_taken_apart() {
        assert_eq!(list("cDAQ1, cDAQ1Mod1").collect::<Vec<_>>(), ["cDAQ1", "cDAQ1Mod1"]);
        assert_eq!(list("").count(), 0);
    }
}
