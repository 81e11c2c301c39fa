//! Texts of a C caller: read with care, written with the driver's rule for lengths.

use std::ffi::{CStr, c_char};

use crate::errors::{Refusal, SMALL_TEXT};

/// A text of the caller; nothing for a null pointer.
///
/// # Safety
///
/// `text` is null or ends with zero.
pub unsafe fn read<'a>(text: *const c_char) -> &'a str {
    if text.is_null() {
        return "";
    }
    // SAFETY: by the contract.
    unsafe { CStr::from_ptr(text) }.to_str().unwrap_or_default()
}

/// Writes `text` and a zero. Without a buffer, the length that is needed is returned.
///
/// # Safety
///
/// `buffer` is null or has room for `length` bytes.
pub unsafe fn write(text: &str, buffer: *mut c_char, length: u32) -> Result<i32, Refusal> {
    let needed = text.len() + 1;
    if buffer.is_null() || length == 0 {
        return Ok(needed as i32);
    }
    if (length as usize) < needed {
        return Err(SMALL_TEXT);
    }
    // SAFETY: by the contract and the length just checked.
    unsafe {
        buffer.cast::<u8>().copy_from_nonoverlapping(text.as_ptr(), text.len());
        buffer.add(text.len()).write(0);
    }
    Ok(0)
}

/// Writes a value where a pointer is given.
///
/// # Safety
///
/// `place` is null or can hold a `T`.
pub unsafe fn put<T>(place: *mut T, value: T) -> Result<i32, Refusal> {
    if !place.is_null() {
        // SAFETY: by the contract; callers in C need not align what they pass through `void *`.
        unsafe { place.write_unaligned(value) };
    }
    Ok(0)
}
