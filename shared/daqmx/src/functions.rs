//! The driver's functions, found by name at run time.

use std::ffi::{CStr, CString, c_char, c_void};
use std::path::Path;
use std::ptr::{null, null_mut};

use libloading::Library;

use crate::LONGEST_LIST;
use crate::error::{DaqmxError, LoadError};

/// Voltages are asked for in volts.
const VOLTS: i32 = 10348;
/// Sampled at the rising edge of the clock.
const RISING: i32 = 10280;
/// Until the task is stopped.
const CONTINUOUSLY: i32 = 10123;
/// All channels of an instant together.
const GROUP_BY_SCAN: u32 = 1;
/// Longest text of an error.
const LONGEST_TEXT: usize = 2048;

/// A task of the driver.
pub(crate) type TaskHandle = *mut c_void;

macro_rules! functions {
    ($($field:ident = $name:literal : fn($($argument:ty),*);)+) => {
        /// The functions of NI's header, each without its prefix. All return 0, a negative error, or a positive warning.
        #[derive(Debug)]
        pub(crate) struct Functions {
            $($field: unsafe extern "C" fn($($argument),*) -> i32,)+
            /// The pointers above are into it.
            _library: Library,
        }

        impl Functions {
            /// Finds them in the library at `path`.
            pub(crate) fn load(path: &Path) -> Result<Functions, LoadError> {
                // SAFETY: the library is NI's driver or its stand-in, whose initialisers have no preconditions.
                let library = unsafe { Library::new(path) }.map_err(|error| LoadError::NotFound {
                    path: path.to_owned(),
                    reason: error.to_string(),
                })?;
                Ok(Functions {
                    // SAFETY: the signatures are those of NI's header, and the library is kept as long as the pointers.
                    $($field: unsafe { *library.get(concat!("DAQmx", $name, "\0").as_bytes()).map_err(|_| {
                        LoadError::Function { path: path.to_owned(), function: concat!("DAQmx", $name) }
                    })? },)+
                    _library: library,
                })
            }
        }
    };
}

functions! {
    major_version = "GetSysNIDAQMajorVersion": fn(*mut u32);
    minor_version = "GetSysNIDAQMinorVersion": fn(*mut u32);
    device_names = "GetSysDevNames": fn(*mut c_char, u32);
    product_type = "GetDevProductType": fn(*const c_char, *mut c_char, u32);
    device_is_simulated = "GetDevIsSimulated": fn(*const c_char, *mut u32);
    analog_inputs = "GetDevAIPhysicalChans": fn(*const c_char, *mut c_char, u32);
    create_task = "CreateTask": fn(*const c_char, *mut TaskHandle);
    clear_task = "ClearTask": fn(TaskHandle);
    start_task = "StartTask": fn(TaskHandle);
    stop_task = "StopTask": fn(TaskHandle);
    create_voltage_channels = "CreateAIVoltageChan":
        fn(TaskHandle, *const c_char, *const c_char, i32, f64, f64, i32, *const c_char);
    time_by_clock = "CfgSampClkTiming": fn(TaskHandle, *const c_char, f64, i32, i32, u64);
    set_buffer = "CfgInputBuffer": fn(TaskHandle, u32);
    clock_rate = "GetSampClkRate": fn(TaskHandle, *mut f64);
    channel_count = "GetReadNumChans": fn(TaskHandle, *mut u32);
    channel_names = "GetReadChannelsToRead": fn(TaskHandle, *mut c_char, u32);
    read = "ReadAnalogF64": fn(TaskHandle, i32, f64, u32, *mut f64, u32, *mut i32, *mut u32);
    extended_error = "GetExtendedErrorInfo": fn(*mut c_char, u32);
}

// SAFETY: the driver's functions may be called from any thread (NI, "Multithreaded applications"); what must stay on one
// thread is a task, and `Task` is not `Send`.
unsafe impl Send for Functions {}
// SAFETY: as above.
unsafe impl Sync for Functions {}

/// What a channel measures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Voltage<'a> {
    pub(crate) channels: &'a CStr,
    pub(crate) terminal: i32,
    pub(crate) range_v: [f64; 2],
}

impl Functions {
    /// `code`, as an error if it is one.
    fn check(&self, call: &'static str, code: i32) -> Result<i32, DaqmxError> {
        if code >= 0 {
            return Ok(code);
        }
        let mut text = [0_u8; LONGEST_TEXT];
        // SAFETY: the buffer is as long as said.
        let told = unsafe { (self.extended_error)(text.as_mut_ptr().cast(), LONGEST_TEXT as u32) };
        let text = if told < 0 { String::new() } else { text_of(&text) };
        let lines: Vec<&str> = text.split_whitespace().collect();
        let text = if lines.is_empty() { "no further word".to_owned() } else { lines.join(" ") };
        Err(DaqmxError { call, code, text })
    }

    /// A text of the driver, which fills the buffer that it is given.
    fn text(
        &self,
        call: &'static str,
        fill: impl FnOnce(*mut c_char, u32) -> i32,
    ) -> Result<String, DaqmxError> {
        let mut buffer = vec![0_u8; LONGEST_LIST];
        self.check(call, fill(buffer.as_mut_ptr().cast(), LONGEST_LIST as u32))?;
        Ok(text_of(&buffer))
    }

    pub(crate) fn version(&self) -> Result<(u32, u32), DaqmxError> {
        let (mut major, mut minor) = (0, 0);
        // SAFETY: writes a number into each.
        self.check("GetSysNIDAQMajorVersion", unsafe { (self.major_version)(&mut major) })?;
        // SAFETY: as above.
        self.check("GetSysNIDAQMinorVersion", unsafe { (self.minor_version)(&mut minor) })?;
        Ok((major, minor))
    }

    pub(crate) fn device_names(&self) -> Result<String, DaqmxError> {
        // SAFETY: the buffer is as long as said.
        self.text("GetSysDevNames", |buffer, length| unsafe { (self.device_names)(buffer, length) })
    }

    pub(crate) fn product(&self, device: &str) -> Result<String, DaqmxError> {
        let name = c_text(device);
        // SAFETY: the name ends with zero, the buffer is as long as said.
        self.text("GetDevProductType", |buffer, length| unsafe {
            (self.product_type)(name.as_ptr(), buffer, length)
        })
    }

    pub(crate) fn analog_inputs(&self, device: &str) -> Result<String, DaqmxError> {
        let name = c_text(device);
        // SAFETY: the name ends with zero, the buffer is as long as said.
        self.text("GetDevAIPhysicalChans", |buffer, length| unsafe {
            (self.analog_inputs)(name.as_ptr(), buffer, length)
        })
    }

    pub(crate) fn is_simulated(&self, device: &str) -> Result<bool, DaqmxError> {
        let name = c_text(device);
        let mut is_simulated = 0;
        // SAFETY: the name ends with zero, and a number is written.
        let code = unsafe { (self.device_is_simulated)(name.as_ptr(), &mut is_simulated) };
        self.check("GetDevIsSimulated", code)?;
        Ok(is_simulated != 0)
    }

    pub(crate) fn create_task(&self) -> Result<TaskHandle, DaqmxError> {
        let mut task = null_mut();
        // SAFETY: an empty name makes the driver choose one; a handle is written.
        self.check("CreateTask", unsafe { (self.create_task)(c"".as_ptr(), &mut task) })?;
        Ok(task)
    }

    /// # Safety
    ///
    /// `task` is one of [`Functions::create_task`] that was not cleared; this holds for all that follow.
    pub(crate) unsafe fn clear_task(&self, task: TaskHandle) {
        // SAFETY: by the contract. Nothing can be done about an error of a task that is over.
        unsafe {
            (self.stop_task)(task);
            (self.clear_task)(task);
        }
    }

    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn add_channels(
        &self,
        task: TaskHandle,
        voltage: Voltage<'_>,
    ) -> Result<(), DaqmxError> {
        let [lowest, highest] = voltage.range_v;
        // SAFETY: by the contract; texts end with zero; no scale of one's own is named.
        let code = unsafe {
            let (channels, none) = (voltage.channels.as_ptr(), null());
            let create = self.create_voltage_channels;
            create(task, channels, c"".as_ptr(), voltage.terminal, lowest, highest, VOLTS, none)
        };
        self.check("CreateAIVoltageChan", code).map(drop)
    }

    /// Samples by the device's clock, and returns the rate that it really has, Hz.
    ///
    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn time_by_clock(
        &self,
        task: TaskHandle,
        rate_hz: f64,
        buffer_samples: u32,
    ) -> Result<f64, DaqmxError> {
        let samples = u64::from(buffer_samples);
        let mut real_hz = 0.0;
        // SAFETY: by the contract; an empty name is the device's own clock.
        let code =
            unsafe { (self.time_by_clock)(task, c"".as_ptr(), rate_hz, RISING, CONTINUOUSLY, samples) };
        self.check("CfgSampClkTiming", code)?;
        // SAFETY: by the contract.
        self.check("CfgInputBuffer", unsafe { (self.set_buffer)(task, buffer_samples) })?;
        // SAFETY: by the contract; a number is written.
        self.check("GetSampClkRate", unsafe { (self.clock_rate)(task, &mut real_hz) })?;
        Ok(real_hz)
    }

    /// Names of the task's channels, in the order of the samples.
    ///
    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn channel_names(&self, task: TaskHandle) -> Result<String, DaqmxError> {
        // SAFETY: by the contract; the buffer is as long as said.
        self.text("GetReadChannelsToRead", |buffer, length| unsafe {
            (self.channel_names)(task, buffer, length)
        })
    }

    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn channel_count(&self, task: TaskHandle) -> Result<usize, DaqmxError> {
        let mut count = 0;
        // SAFETY: by the contract; a number is written.
        self.check("GetReadNumChans", unsafe { (self.channel_count)(task, &mut count) })?;
        Ok(count as usize)
    }

    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn start(&self, task: TaskHandle) -> Result<(), DaqmxError> {
        // SAFETY: by the contract.
        self.check("StartTask", unsafe { (self.start_task)(task) }).map(drop)
    }

    /// Waits for `samples` of each channel, but no longer than `timeout_s`, writes them into `volts`, and returns how many of
    /// each channel it wrote.
    ///
    /// # Safety
    ///
    /// As [`Functions::clear_task`].
    pub(crate) unsafe fn read(
        &self,
        task: TaskHandle,
        samples: usize,
        timeout_s: f64,
        volts: &mut [f64],
    ) -> Result<usize, DaqmxError> {
        let mut read = 0;
        let length = volts.len() as u32;
        // SAFETY: by the contract; the buffer is as long as said, and a number is written.
        let code = unsafe {
            let reserved = null_mut();
            (self.read)(
                task,
                samples as i32,
                timeout_s,
                GROUP_BY_SCAN,
                volts.as_mut_ptr(),
                length,
                &mut read,
                reserved,
            )
        };
        self.check("ReadAnalogF64", code)?;
        Ok(usize::try_from(read).unwrap_or(0))
    }
}

/// The text in a buffer that ends with zero.
fn text_of(buffer: &[u8]) -> String {
    let text = CStr::from_bytes_until_nul(buffer).unwrap_or_default();
    text.to_string_lossy().into_owned()
}

/// A name for the driver; one that holds a zero is the name of nothing.
pub(crate) fn c_text(text: &str) -> CString {
    CString::new(text).unwrap_or_default()
}
