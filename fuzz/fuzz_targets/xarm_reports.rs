//! Whatever bytes come on a report connection, in whatever pieces, the decoder ends and never panics, and what it
//! reads is written and read back the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_xarm::report::{Decoder, Kind, Report};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, stream) = input;
    for kind in [Kind::Normal, Kind::Rich, Kind::RealTime] {
        let mut decoder = Decoder::new(kind);
        for mut piece in stream.chunks(usize::from(piece).max(1)) {
            while let Some(report) = decoder.next_report(&mut piece) {
                let mut bytes = Vec::new();
                report.encode(kind, &mut bytes);
                let again = Report::decode(kind, &bytes).expect("what was encoded is a report");
                assert_eq!((again.joints_rad, again.pose), (report.joints_rad, report.pose));
                let is_whole = report.setup.is_some_and(|setup| setup.gravity.is_some());
                assert!(!is_whole || again.setup == report.setup);
            }
        }
    }
});
