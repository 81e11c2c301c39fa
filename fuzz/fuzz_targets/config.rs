//! Whatever a configuration says, reading and checking it ends and never panics, and what was read can be
//! written and read back.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tendon_config::Config;

fuzz_target!(|text: &str| {
    let path = Path::new("tendon.toml");
    let Ok(config) = Config::parse(text, path) else { return };
    let _ = config.check();
    assert!(Config::parse(&config.to_toml(), path).is_ok());
});
