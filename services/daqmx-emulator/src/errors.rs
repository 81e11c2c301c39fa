//! Error codes of the driver, and its last word about one.

use std::cell::RefCell;

/// A function refuses: the driver's code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal(pub i32);

pub const OVERRUN: Refusal = Refusal(-200_279);
pub const NOT_YET: Refusal = Refusal(-200_284);
pub const NO_DEVICE: Refusal = Refusal(-200_220);
pub const NO_CHANNEL: Refusal = Refusal(-200_170);
pub const BAD_VALUE: Refusal = Refusal(-200_077);
pub const BAD_TASK: Refusal = Refusal(-200_088);
pub const RESERVED: Refusal = Refusal(-50_103);
pub const NOT_WHILE_RUNNING: Refusal = Refusal(-200_479);
pub const NOT_STARTED: Refusal = Refusal(-200_473);
pub const UNPLUGGED: Refusal = Refusal(-88_705);
pub const SMALL_BUFFER: Refusal = Refusal(-200_229);
pub const SMALL_TEXT: Refusal = Refusal(-200_228);
pub const NO_ATTRIBUTE: Refusal = Refusal(-200_197);
pub const NOT_DONE: Refusal = Refusal(-200_560);

thread_local! {
    static LAST: RefCell<i32> = const { RefCell::new(0) };
}

/// What the driver says of a code.
pub fn text_of(code: i32) -> &'static str {
    match Refusal(code) {
        OVERRUN => {
            "The application is not able to keep up with the hardware acquisition: samples were overwritten."
        }
        NOT_YET => "Some or all of the samples requested have not yet been acquired.",
        NO_DEVICE => "Device identifier is invalid.",
        NO_CHANNEL => "Physical channel specified does not exist on this device.",
        BAD_VALUE => "Requested value is not a supported value for this property.",
        BAD_TASK => "Task specified is invalid or does not exist.",
        RESERVED => "The specified resource is reserved.",
        NOT_WHILE_RUNNING => "Specified operation cannot be performed while the task is running.",
        NOT_STARTED => "Samples were to be read before the task was started.",
        UNPLUGGED => "The device is not present or not active in the system.",
        SMALL_BUFFER => "Buffer is too small to fit the samples read.",
        SMALL_TEXT => "Buffer is too small to fit the text.",
        NO_ATTRIBUTE => "The stand-in does not know this property.",
        NOT_DONE => "Wait until done did not indicate that the task was done within the specified timeout.",
        _ => "No error.",
    }
}

/// What a function returns, which the next [`last`] of this thread is about.
pub fn returned(outcome: Result<i32, Refusal>) -> i32 {
    match outcome {
        Ok(value) => value,
        Err(Refusal(code)) => {
            LAST.set(code);
            code
        }
    }
}

/// Code of the last refusal on this thread.
pub fn last() -> i32 {
    LAST.with_borrow(|code| *code)
}
