//! Whatever bytes a MAT-file holds, reading it ends, never panics, and gives only finite samples.
#![no_main]

use std::io::Cursor;

use libfuzzer_sys::fuzz_target;
use tendon_recordings::mat::MatFile;

fuzz_target!(|file: &[u8]| {
    let Ok(mut file) = MatFile::open(Cursor::new(file)) else { return };
    let _ = file.number("fs");
    if let Ok(columns) = file.columns("data", &[0, 3]) {
        assert!(columns.iter().flatten().all(|sample| sample.is_finite()));
    }
});
