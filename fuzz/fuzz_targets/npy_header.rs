//! Whatever bytes an array begins with, reading its header ends, never panics, and the data do not begin beyond the
//! end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_recordings::npy::Header;

fuzz_target!(|file: &[u8]| {
    let Ok(header) = Header::parse(file) else { return };
    assert!(header.bytes <= file.len());
});
