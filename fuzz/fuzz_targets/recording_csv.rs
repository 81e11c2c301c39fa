//! Whatever bytes a file holds, reading it as a table ends, never panics, and gives only finite samples.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_recordings::Channel;
use tendon_recordings::table::Table;

fuzz_target!(|text: &[u8]| {
    let Ok(mut table) = Table::open(text, &[Channel::Index(0)]) else { return };
    let mut frame = [0.0];
    while let Ok(true) = table.next_row(text, &mut frame) {
        assert!(frame[0].is_finite());
    }
});
