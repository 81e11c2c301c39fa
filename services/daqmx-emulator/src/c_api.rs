//! The functions that a client calls.

use std::ffi::{c_char, c_void};
use std::time::Duration;

use crate::channels::{self, DEVICES, inputs_of};
use crate::driver::{Fault, Input, Read, driver, fault, read};
use crate::errors::{BAD_VALUE, NOT_DONE, Refusal, last, returned, text_of};
use crate::text;

/// The handle of a task: its number.
pub type TaskHandle = *mut c_void;

/// Client libraries of this version are served.
pub const VERSION: [u32; 3] = [26, 5, 0];
/// Only continuous sampling and volts are imitated.
const CONTINUOUSLY: i32 = 10123;
const VOLTS: i32 = 10348;

pub fn number(task: TaskHandle) -> usize {
    task.addr()
}

/// The devices there are now.
pub fn device_names() -> String {
    let is_there = |name: &&str| fault() != Fault::Unplugged || !name.starts_with("cDAQ1");
    let names: Vec<&str> = DEVICES.iter().map(|device| device.name).filter(is_there).collect();
    names.join(", ")
}

/// Defines a function that a client finds by its name, and whose outcome becomes a code.
macro_rules! exported {
    ($(fn $name:ident($($argument:ident: $type:ty),* $(,)?) $body:block)+) => {
        $(
            /// As in NI's header.
            ///
            /// # Safety
            ///
            /// Pointers are null or valid, texts end with zero, buffers are as long as said.
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $name($($argument: $type),*) -> i32 {
                #[allow(unused_unsafe, reason = "not every function touches a pointer")]
                // SAFETY: by the contract of the function.
                let outcome = || -> Result<i32, Refusal> { unsafe { $body } };
                returned(outcome())
            }
        )+
    };
}
pub(crate) use exported;

exported! {
    fn DAQmxSetRuntimeEnvironment(_a: *const c_char, _b: *const c_char, _c: *const c_char, _d: *const c_char) {
        Ok(0)
    }
    fn DAQmxGetSysNIDAQMajorVersion(major: *mut u32) { text::put(major, VERSION[0]) }
    fn DAQmxGetSysNIDAQMinorVersion(minor: *mut u32) { text::put(minor, VERSION[1]) }
    fn DAQmxGetSysNIDAQUpdateVersion(update: *mut u32) { text::put(update, VERSION[2]) }
    fn DAQmxGetSysDevNames(buffer: *mut c_char, length: u32) { text::write(&device_names(), buffer, length) }
    fn DAQmxGetDevProductType(name: *const c_char, buffer: *mut c_char, length: u32) {
        text::write(channels::device(text::read(name))?.product, buffer, length)
    }
    fn DAQmxGetDevProductCategory(name: *const c_char, category: *mut i32) {
        text::put(category, channels::device(text::read(name))?.category)
    }
    fn DAQmxGetDevSerialNum(name: *const c_char, serial: *mut u32) {
        text::put(serial, channels::device(text::read(name))?.serial)
    }
    fn DAQmxGetDevIsSimulated(name: *const c_char, is_simulated: *mut u32) {
        channels::device(text::read(name))?;
        text::put(is_simulated, 1)
    }
    fn DAQmxGetDevAIPhysicalChans(name: *const c_char, buffer: *mut c_char, length: u32) {
        text::write(&inputs_of(channels::device(text::read(name))?), buffer, length)
    }
    fn DAQmxGetDevAIMaxMultiChanRate(name: *const c_char, rate_hz: *mut f64) {
        text::put(rate_hz, channels::device(text::read(name))?.fastest_hz)
    }
    fn DAQmxCreateTask(name: *const c_char, task: *mut TaskHandle) {
        let number = driver().create(text::read(name));
        text::put(task, std::ptr::without_provenance_mut(number))
    }
    fn DAQmxClearTask(task: TaskHandle) { driver().clear(number(task)) }
    fn DAQmxStartTask(task: TaskHandle) { driver().start(number(task)) }
    fn DAQmxStopTask(task: TaskHandle) {
        driver().task(number(task))?.stop();
        Ok(0)
    }
    fn DAQmxTaskControl(task: TaskHandle, action: i32) {
        match action {
            0 => driver().start(number(task)),
            1 | 6 => {
                driver().task(number(task))?.stop();
                Ok(0)
            }
            2..=5 => driver().task(number(task)).map(|_| 0),
            _ => Err(BAD_VALUE),
        }
    }
    fn DAQmxIsTaskDone(task: TaskHandle, is_done: *mut u32) {
        let is_running = driver().task(number(task))?.is_running();
        text::put(is_done, u32::from(!is_running))
    }
    fn DAQmxWaitUntilTaskDone(task: TaskHandle, timeout_s: f64) {
        std::thread::sleep(Duration::from_secs_f64(timeout_s.clamp(0.0, 1.0)));
        if driver().task(number(task))?.is_running() { Err(NOT_DONE) } else { Ok(0) }
    }
    fn DAQmxCreateAIVoltageChan(
        task: TaskHandle,
        physical: *const c_char,
        name: *const c_char,
        _terminal: i32,
        lowest: f64,
        highest: f64,
        units: i32,
        _scale: *const c_char,
    ) {
        if units != VOLTS || lowest.is_nan() || highest.is_nan() || lowest >= highest {
            return Err(BAD_VALUE);
        }
        let named = text::read(name);
        let inputs = channels::parse(text::read(physical))?.into_iter().enumerate().map(
            |(place, (device, input))| Input {
                device,
                name: match (named, place) {
                    ("", _) => format!("{}/ai{input}", device.name),
                    (named, 0) => named.to_owned(),
                    (named, place) => format!("{named}{place}"),
                },
                range_v: [lowest, highest],
            },
        );
        driver().task(number(task))?.add(inputs.collect())
    }
    fn DAQmxCfgSampClkTiming(
        task: TaskHandle,
        _source: *const c_char,
        rate_hz: f64,
        _edge: i32,
        mode: i32,
        samples: u64,
    ) {
        if mode != CONTINUOUSLY {
            return Err(BAD_VALUE);
        }
        driver().task(number(task))?.time(rate_hz, samples)
    }
    fn DAQmxCfgInputBuffer(task: TaskHandle, samples: u32) {
        driver().task(number(task))?.buffer_samples = u64::from(samples);
        Ok(0)
    }
    fn DAQmxGetBufInputBufSize(task: TaskHandle, samples: *mut u32) {
        let buffer_samples = driver().task(number(task))?.buffer_samples;
        text::put(samples, buffer_samples as u32)
    }
    fn DAQmxGetSampClkRate(task: TaskHandle, rate_hz: *mut f64) {
        let real_hz = driver().task(number(task))?.rate_hz;
        text::put(rate_hz, real_hz)
    }
    fn DAQmxGetReadNumChans(task: TaskHandle, count: *mut u32) {
        let channels = driver().task(number(task))?.inputs.len();
        text::put(count, channels as u32)
    }
    fn DAQmxGetReadChannelsToRead(task: TaskHandle, buffer: *mut c_char, length: u32) {
        let names = channel_names(task)?;
        text::write(&names, buffer, length)
    }
    fn DAQmxGetReadAvailSampPerChan(task: TaskHandle, samples: *mut u32) {
        let available = driver().task(number(task))?.available()?;
        text::put(samples, available as u32)
    }
    fn DAQmxGetReadTotalSampPerChanAcquired(task: TaskHandle, samples: *mut u64) {
        let acquired = driver().task(number(task))?.acquired();
        text::put(samples, acquired)
    }
    fn DAQmxGetReadCurrReadPos(task: TaskHandle, samples: *mut u64) {
        let position = driver().task(number(task))?.position;
        text::put(samples, position)
    }
    fn DAQmxReadAnalogF64(
        task: TaskHandle,
        samples: i32,
        timeout_s: f64,
        fill: u32,
        data: *mut f64,
        data_length: u32,
        samples_read: *mut i32,
        _reserved: *mut u32,
    ) {
        let volts: &mut [f64] =
            if data.is_null() { &mut [] } else { std::slice::from_raw_parts_mut(data, data_length as usize) };
        let wanted = Read {
            samples: usize::try_from(samples).ok(),
            timeout: Duration::try_from_secs_f64(timeout_s).ok(),
            by_scan: fill == 1,
        };
        let (outcome, count) = read(number(task), wanted, volts);
        text::put(samples_read, count as i32)?;
        outcome
    }
    fn DAQmxGetErrorString(code: i32, buffer: *mut c_char, length: u32) {
        text::write(text_of(code), buffer, length)
    }
    fn DAQmxGetExtendedErrorInfo(buffer: *mut c_char, length: u32) {
        text::write(text_of(last()), buffer, length)
    }
    fn DAQmxResetDevice(name: *const c_char) {
        channels::device(text::read(name)).map(|_| 0)
    }
}

/// Names of a task's channels.
pub fn channel_names(task: TaskHandle) -> Result<String, Refusal> {
    let mut driver = driver();
    let names: Vec<String> =
        driver.task(number(task))?.inputs.iter().map(|input| input.name.clone()).collect();
    Ok(names.join(", "))
}
