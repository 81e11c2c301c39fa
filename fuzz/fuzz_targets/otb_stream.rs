//! Whatever bytes an amplifier of OT Bioelettronica sends, in whatever pieces, the decoder ends and never panics, and samples
//! do not depend on the pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_otb::{Decoder, OtbSettings};

fuzz_target!(|input: (u8, Vec<u8>)| {
    let (piece, bytes) = input;
    let muovi = OtbSettings::default().amplifier(2000.0).expect("a Muovi has this rate");
    let decode = |piece: usize| {
        let mut decoder = Decoder::new(muovi.layout(0));
        let mut samples = Vec::new();
        let whole = bytes.chunks(piece).all(|piece| {
            let take = |run: tendon_otb::Instants<'_>| {
                samples.extend(run.instants_mv.chunks(32).zip(run.first_sample..).map(|(instant, index)| (index, instant[0])));
            };
            decoder.push(piece, take).is_ok()
        });
        whole.then_some((samples, decoder.lost_samples()))
    };
    assert_eq!(decode(usize::from(piece).max(1)), decode(bytes.len().max(1)));
    let _ = tendon_otb::find_accessories(8, &bytes);
});
