//! Person files, with and without the head that holds the checksum: reading one ends and never panics, and what was read
//! can be written and read back.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tendon_people::Person;

fuzz_target!(|text: &str| {
    let _ = Person::from_text(text);
    let Ok(person) = Person::from_body(text) else { return };
    assert!(Person::from_text(&person.to_text()).is_ok());
});
