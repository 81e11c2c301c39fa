//! The generic getters by attribute number, which NI's Python client uses.

use std::ffi::{c_char, c_void};

use crate::c_api::{TaskHandle, VERSION, channel_names, device_names, exported, number};
use crate::channels::{device, inputs_of};
use crate::driver::driver;
use crate::errors::{NO_ATTRIBUTE, Refusal, returned};
use crate::text;

/// NI's number of analog inputs, and of the measurement of a voltage.
const ANALOG_INPUT: i32 = 10100;
const VOLTAGE: i32 = 10322;

exported! {
    fn DAQmxGetSystemInfoAttribute(attribute: i32, value: *mut c_void, length: u32) {
        match attribute {
            0x1272 => text::put(value.cast(), VERSION[0]),
            0x1923 => text::put(value.cast(), VERSION[1]),
            0x2F22 => text::put(value.cast(), VERSION[2]),
            0x193B => text::write(&device_names(), value.cast(), length),
            _ => Err(NO_ATTRIBUTE),
        }
    }
    fn DAQmxGetDeviceAttribute(name: *const c_char, attribute: i32, value: *mut c_void, length: u32) {
        let device = device(text::read(name))?;
        match attribute {
            0x0631 => text::write(device.product, value.cast(), length),
            0x0632 => text::put(value.cast(), device.serial),
            0x22CA => text::put(value.cast(), 1_u32),
            0x29A9 => text::put(value.cast(), device.category),
            0x231E => text::write(&inputs_of(device), value.cast(), length),
            _ => Err(NO_ATTRIBUTE),
        }
    }
    fn DAQmxGetTaskAttribute(task: TaskHandle, attribute: i32, value: *mut c_void, length: u32) {
        let (name, channels) = {
            let mut driver = driver();
            let task = driver.task(number(task))?;
            (task.name.clone(), task.inputs.len())
        };
        match attribute {
            0x1276 => text::write(&name, value.cast(), length),
            0x1273 => text::write(&channel_names(task)?, value.cast(), length),
            0x2181 => text::put(value.cast(), channels as u32),
            _ => Err(NO_ATTRIBUTE),
        }
    }
    fn DAQmxGetTimingAttribute(task: TaskHandle, attribute: i32, value: *mut c_void, _length: u32) {
        let rate_hz = driver().task(number(task))?.rate_hz;
        match attribute {
            0x1344 => text::put(value.cast(), rate_hz),
            _ => Err(NO_ATTRIBUTE),
        }
    }
    fn DAQmxGetReadAttribute(task: TaskHandle, attribute: i32, value: *mut c_void, length: u32) {
        if attribute == 0x1823 {
            return text::write(&channel_names(task)?, value.cast(), length);
        }
        let mut driver = driver();
        let task = driver.task(number(task))?;
        match attribute {
            0x217B => text::put(value.cast(), task.inputs.len() as u32),
            0x1223 | 0x31E8 => text::put(value.cast(), task.available()? as u32),
            0x192A => text::put(value.cast(), task.acquired()),
            0x1221 => text::put(value.cast(), task.position),
            _ => Err(NO_ATTRIBUTE),
        }
    }
    fn DAQmxGetChanAttribute(
        task: TaskHandle,
        _channel: *const c_char,
        attribute: i32,
        value: *mut c_void,
        _length: u32,
    ) {
        driver().task(number(task))?;
        match attribute {
            0x187F => text::put(value.cast(), ANALOG_INPUT),
            0x0695 => text::put(value.cast(), VOLTAGE),
            _ => Err(NO_ATTRIBUTE),
        }
    }
}
