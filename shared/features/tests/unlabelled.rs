//! Recognition without labels against NumPy, SciPy and scikit-learn: `golden/make_unlabelled.py` made the vectors.

use serde::Deserialize;
use tendon_features::{Class, FitError, GestureMap, PlacedGestures, Training, UnlabelledError};

#[derive(Deserialize)]
struct Golden {
    classes: Vec<String>,
    feature_count: usize,
    people: Vec<Person>,
    stream: Vec<f64>,
    levels: Vec<f64>,
    recognised: Reference,
}

#[derive(Deserialize)]
struct Person {
    turn: i8,
    features: Vec<f64>,
    labels: Vec<usize>,
}

#[derive(Deserialize)]
struct Reference {
    labels: Vec<usize>,
    probabilities: Vec<f64>,
    sureness: f64,
}

impl Golden {
    fn read() -> Golden {
        serde_json::from_str(include_str!("golden/unlabelled.json")).expect("the golden file")
    }

    fn people(&self) -> Vec<PlacedGestures> {
        self.people.iter().map(|person| self.person(person, &self.classes)).collect()
    }

    fn person(&self, person: &Person, names: &[String]) -> PlacedGestures {
        let classes: Vec<Class> =
            names.iter().map(|name| Class { name: name.clone(), weight: 1.0 }).collect();
        let training = Training {
            classes: &classes,
            feature_count: self.feature_count,
            features: &person.features,
            labels: &person.labels,
            increment_s: 0.075,
            blocks: &vec![0; person.labels.len()],
        };
        PlacedGestures::new(person.turn, &training).expect("valid windows")
    }
}

#[test]
fn a_stream_is_recognised_as_in_numpy() {
    let golden = Golden::read();
    let map = GestureMap::new(&golden.people(), "rest").expect("a map");
    assert_eq!(map.classes(), ["rest", "grip", "flexion", "ulnar"]);
    let recognised = map.recognise(&golden.stream, &golden.levels).expect("recognised");
    assert_eq!(recognised.labels, golden.recognised.labels);
    assert!((recognised.sureness - golden.recognised.sureness).abs() < 1e-9, "{}", recognised.sureness);
    assert_eq!(recognised.probabilities.len(), golden.recognised.probabilities.len());
    for (ours, reference) in recognised.probabilities.iter().zip(&golden.recognised.probabilities) {
        assert!((ours - reference).abs() < 1e-9, "{ours}, {reference}");
    }
}

#[test]
fn the_order_of_classes_and_people_makes_no_difference() {
    let golden = Golden::read();
    let reversed = |person: &Person| {
        let names: Vec<String> = golden.classes.iter().rev().cloned().collect();
        let labels = person.labels.iter().map(|label| names.len() - 1 - label).collect();
        let person = Person { turn: person.turn, features: person.features.clone(), labels };
        golden.person(&person, &names)
    };
    let mut people: Vec<PlacedGestures> = golden.people.iter().map(reversed).collect();
    people.reverse();
    let map = GestureMap::new(&people, "rest").expect("a map");
    let named = |map: &GestureMap| {
        let recognised = map.recognise(&golden.stream, &golden.levels).expect("recognised");
        recognised.labels.iter().map(|&label| map.classes()[label].clone()).collect::<Vec<_>>()
    };
    assert_eq!(named(&map), named(&GestureMap::new(&golden.people(), "rest").expect("a map")));
}

#[test]
fn a_gesture_that_somebody_did_not_make_is_left_out() {
    let golden = Golden::read();
    let mut people = golden.people();
    let names = ["grip", "rest", "flexion", "point"].map(String::from);
    people.push(golden.person(&golden.people[0], &names));
    let map = GestureMap::new(&people, "rest").expect("a map");
    assert_eq!(map.classes(), ["rest", "grip", "flexion"]);
}

#[test]
fn what_makes_no_map_is_said() {
    let golden = Golden::read();
    let people = golden.people();
    let refused = |people: &[PlacedGestures], rest| GestureMap::new(people, rest).expect_err("refused");
    assert_eq!(refused(&[], "rest"), UnlabelledError::TooFewPeople(0));
    assert_eq!(refused(&people, "relax"), UnlabelledError::NoRest);
    assert!(
        matches!(refused(&people[1..3], "rest"), UnlabelledError::TooFewPeople(1)),
        "one person in each place"
    );
    let turned: Vec<PlacedGestures> = golden
        .people
        .iter()
        .filter(|person| person.turn == -2)
        .map(|p| golden.person(p, &golden.classes))
        .collect();
    assert!(matches!(refused(&turned, "rest"), UnlabelledError::TooFewWindows { windows: 0, .. }));
    let others = ["rest", "point", "pinch", "fist"].map(String::from);
    let mut mixed = people;
    mixed.push(golden.person(&golden.people[0], &others));
    assert_eq!(refused(&mixed, "rest"), UnlabelledError::NothingInCommon);
}

#[test]
fn what_is_no_stream_is_said() {
    let golden = Golden::read();
    let map = GestureMap::new(&golden.people(), "rest").expect("a map");
    let (windows, length) = (18, golden.feature_count);
    let short = map.recognise(&golden.stream[..windows * length], &golden.levels[..windows]);
    assert_eq!(short, Err(UnlabelledError::StreamTooShort { windows, gestures: 4 }));
    let empty = map.recognise(&[], &[]);
    assert_eq!(empty, Err(UnlabelledError::StreamTooShort { windows: 0, gestures: 4 }));
    let torn = map.recognise(&golden.stream[1..], &golden.levels);
    assert!(matches!(torn, Err(UnlabelledError::Windows(FitError::Length { .. }))));
    let mut damaged = golden.stream.clone();
    damaged[3 * length] = f64::NAN;
    let damaged = map.recognise(&damaged, &golden.levels);
    assert_eq!(damaged, Err(UnlabelledError::Windows(FitError::NotFinite { window: 3 })));
}
