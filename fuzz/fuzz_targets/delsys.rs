//! Whatever a Trigno server sends on either port, in whatever pieces, replies and samples are read or refused, and do not depend
//! on the pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_delsys::{Decoder, Replies, frame_rate_hz};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, bytes) = input;
    let mut replies = Replies::default();
    let mut decoder = Decoder::new(2000.0);
    let mut samples = Vec::new();
    for piece in bytes.chunks(usize::from(piece).max(1)) {
        replies.push(piece);
        while let Ok(Some(reply)) = replies.next_reply() {
            let _ = frame_rate_hz("0.0135", &reply);
            let _ = frame_rate_hz(&reply, "27");
        }
        samples.extend(decoder.push(piece).1.iter().map(|value| value.to_bits()));
    }
    let mut whole = Decoder::new(2000.0);
    let whole: Vec<u32> = whole.push(&bytes).1.iter().map(|value| value.to_bits()).collect();
    assert_eq!(samples, whole);
});
