//! Whatever a Trigno server sends on either port, in whatever pieces, replies and samples are read or refused, and do not depend
//! on the pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_delsys::{Decoder, Replies, frame_rate_hz};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, bytes) = input;
    let mut replies = Replies::default();
    let mut decoder = Decoder::new(2000.0);
    let mut samples = Some(Vec::new());
    for piece in bytes.chunks(usize::from(piece).max(1)) {
        replies.push(piece);
        while let Ok(Some(reply)) = replies.next_reply() {
            let _ = frame_rate_hz("0.0135", &reply);
            let _ = frame_rate_hz(&reply, "27");
        }
        // Nothing that comes after samples out of step is read.
        samples = samples.and_then(|mut samples| {
            samples.extend(decoder.push(piece).ok()?.1.iter().map(|value| value.to_bits()));
            Some(samples)
        });
    }
    let mut whole = Decoder::new(2000.0);
    let whole: Option<Vec<u32>> =
        whole.push(&bytes).ok().map(|(_, values)| values.iter().map(|value| value.to_bits()).collect());
    assert_eq!(samples, whole);
});
