//! Whatever bytes a program sends, in whatever pieces, header and frames are read or refused, and samples do not depend on the
//! pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_stream::{Decoder, Header, Instants};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, bytes) = input;
    let _ = Header::parse(&bytes);
    let decode = |piece: usize| {
        let mut decoder = Decoder::new(2, 2000.0);
        let mut samples = Vec::new();
        let whole = bytes.chunks(piece).all(|piece| {
            let take = |run: Instants<'_>| {
                let instants = run.instants.chunks(2).zip(run.first_sample..);
                samples.extend(instants.map(|(instant, index)| (index, instant[0].to_bits())));
            };
            decoder.push(piece, take).is_ok()
        });
        whole.then_some(samples)
    };
    assert_eq!(decode(usize::from(piece).max(1)), decode(bytes.len().max(1)));
});
