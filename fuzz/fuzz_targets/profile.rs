//! Whatever a profile says, reading it ends and never panics, and what was read can be written and read back.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_emg_simulation::Profile;

fuzz_target!(|text: &str| {
    let Ok(profile) = Profile::from_toml(text) else { return };
    assert!(Profile::from_toml(&profile.to_toml()).is_ok());
});
