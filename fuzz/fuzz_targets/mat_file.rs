//! Whatever bytes a MAT-file of level 5 or version 7.3 holds, reading it ends, never panics, and gives only finite samples. The
//! files to begin with: `cargo +nightly fuzz run mat_file CORPUS ../shared/recordings/tests/golden`.
#![no_main]

use std::io::Cursor;

use libfuzzer_sys::fuzz_target;
use tendon_recordings::mat::MatFile;

fuzz_target!(|file: &[u8]| {
    let Ok(mut file) = MatFile::open(Cursor::new(file)) else { return };
    let _ = file.number("fs");
    for (name, channels) in [("data", [0, 3]), ("long", [2, 0])] {
        if let Ok(columns) = file.columns(name, &channels) {
            assert!(columns.iter().flatten().all(|sample| sample.is_finite()));
        }
    }
});
