//! Whatever the file of a session holds, reading it ends and never panics.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tendon_session_file::Reader;

fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader::new(bytes, Path::new("session.mcap"));
    while let Ok(Some(_)) = reader.next() {}
});
