//! Whatever a script says, reading it ends and never panics, and a script that was read has steps, each of
//! which lasts.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_emg_simulation::Script;

fuzz_target!(|text: &str| {
    let Ok(script) = text.parse::<Script>() else { return };
    assert!(!script.steps().is_empty());
    assert!(script.steps().iter().all(|step| !step.duration.is_zero()));
});
