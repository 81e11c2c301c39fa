//! Recognising a window allocates nothing. Alone in its file: the allocator counts for the whole process.

mod common;

use common::{Noise, fit, gestures, record, window};
use tendon_counting_allocator::allocations;
use tendon_people::PersonalRecogniser;

#[test]
fn a_window_allocates_nothing() {
    let before = allocations();
    let person = fit(&record(&gestures(), 1, 1)).expect("a person");
    let mut recogniser = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    assert!(allocations() > before, "the counter counts");
    let mut noise = Noise(1);
    let window = window(&mut noise, &[2.0; 4]);
    let before = allocations();
    let mut recognised = 0;
    for first_sample in [0, 50, 100, 150, 500] {
        recognised += usize::from(recogniser.recognise(&window, first_sample).is_ok());
        recognised += usize::from(recogniser.recognise_alone(&window).is_ok());
        assert!(recogniser.recognise(&window[1..], first_sample).is_err());
    }
    assert_eq!(allocations() - before, 0);
    assert_eq!(recognised, 10);
}
