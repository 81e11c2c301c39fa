//! Recognising a window allocates nothing. Alone in its file: the allocator counts for the whole process.

mod common;

use common::{Noise, fit, gestures, record, window};
use tendon_counting_allocator::allocations;
use tendon_people::{Adaptation, PersonalRecogniser};

#[test]
fn a_window_allocates_nothing() {
    let before = allocations();
    let person = fit(&record(&gestures(), 1, 1)).expect("a person");
    let recogniser = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    let mut recogniser = recogniser.with_adaptation(Adaptation::Slow);
    assert!(allocations() > before, "the counter counts");
    let mut noise = Noise(1);
    // Fist, so surely that it is adapted to.
    let window = window(&mut noise, &[4.5; 4]);
    let calibrated = recogniser.recognise_alone(&window).expect("a recognition").novelty;
    let before = allocations();
    let mut recognised = 0;
    for first_sample in [0, 50, 100, 150, 500] {
        recognised += usize::from(recogniser.recognise(&window, first_sample).is_ok());
        recogniser.adapt();
        recognised += usize::from(recogniser.recognise_alone(&window).is_ok());
        recogniser.adapt();
        assert!(recogniser.recognise(&window[1..], first_sample).is_err());
    }
    assert_eq!(allocations() - before, 0);
    assert_eq!(recognised, 10);
    let adapted = recogniser.recognise_alone(&window).expect("a recognition").novelty;
    assert!(adapted < calibrated, "it adapted: {adapted} {calibrated}");
}
