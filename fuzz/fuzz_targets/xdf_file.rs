//! Whatever bytes a file of this kind holds, reading it ends, never panics, and its cues and gaps lie within its samples.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tendon_recordings::{Channel, xdf};

fuzz_target!(|file: &[u8]| {
    let path = Path::new("fuzz.xdf");
    let Ok(signals) = xdf::read(path, file, &[Channel::Index(0)]) else { return };
    let end = signals.columns[0].len() as u64;
    assert!(signals.cues.iter().all(|cue| cue.start_sample < end));
    assert!(signals.gaps.iter().all(|gap| gap.before_sample < end));
    let segments = signals.segments(path);
    assert!(segments.iter().filter_map(|segment| segment.end_sample).is_sorted());
});
