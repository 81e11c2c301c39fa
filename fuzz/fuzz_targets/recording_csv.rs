//! Whatever bytes a file holds, reading it as a table ends, never panics, and gives only finite samples; so does asking what
//! its columns are, and watching its time.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_recordings::Channel;
use tendon_recordings::table::{self, Row, Table};

fuzz_target!(|text: &[u8]| {
    let Ok(mut table) = Table::open(text, &[Channel::Index(0)]) else { return };
    let Ok(columns) = table::columns(text) else { return };
    assert_eq!(columns.len(), table.columns());
    let _ = table::first_muscles(&columns, 1);
    let Ok(timing) = table.watch_time(text, &columns) else { return };
    assert!(timing.rate_hz.is_none_or(|rate_hz| rate_hz.is_finite() && rate_hz > 0.0));
    let mut frame = [0.0];
    loop {
        match table.next_row(text, &mut frame) {
            Ok(Row::Samples) => assert!(frame[0].is_finite()),
            Ok(Row::Missing | Row::Gap(_)) => {}
            Ok(Row::End) | Err(_) => break,
        }
    }
});
