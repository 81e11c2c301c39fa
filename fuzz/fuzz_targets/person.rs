//! Person files, with and without the head that holds the checksum.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_people::Person;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = Person::from_text(text);
        if let Ok(person) = Person::from_body(text) {
            assert!(Person::from_text(&person.to_text()).is_ok());
        }
    }
});
