//! Scores against scikit-learn's, to the last digit (the loss, a long sum, to 1e-12).
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use serde_json::Value;
use tendon_evaluation::{Answer, ClassScores, Evaluation, Origin, Tally};
use tendon_gesture::{Class, Gesture};
use tendon_identity::PersonId;

fn cases() -> Vec<Value> {
    serde_json::from_str(include_str!("golden/scores.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn evaluate(case: &Value) -> Evaluation {
    let probabilities: Vec<Vec<f64>> =
        case["probabilities"].as_array().unwrap().iter().map(numbers).collect();
    let gestures = &Gesture::PAPER[..probabilities[0].len()];
    let classes: Vec<Class> = gestures.iter().copied().map(Class::Gesture).collect();
    let mut tally = Tally::new(&classes);
    for (truth, probabilities) in numbers(&case["truth"]).iter().zip(&probabilities) {
        let probabilities: Vec<f32> = probabilities.iter().map(|value| *value as f32).collect();
        let truth = tally.class_of(gestures[*truth as usize]).unwrap();
        let answer = Answer { probabilities: &probabilities, work_ns: 1000 };
        tally.record(truth, Origin { person: PersonId::Number(1), repetition: 0 }, answer);
    }
    Evaluation::of(&tally)
}

fn triple(report: &ClassScores) -> Vec<f64> {
    vec![report.precision, report.recall, report.f1]
}

#[test]
fn every_score_is_scikit_learns_to_the_last_digit() {
    let cases = cases();
    assert_eq!(cases.len(), 3);
    for (index, case) in cases.iter().enumerate() {
        let evaluation = evaluate(case);
        assert_eq!(evaluation.classes.len(), case["per_class"].as_array().unwrap().len(), "case {index}");
        assert_eq!(evaluation.accuracy, case["accuracy"].as_f64().unwrap(), "case {index}");
        assert!((evaluation.loss - case["loss"].as_f64().unwrap()).abs() < 1e-12, "case {index}");
        for (class, expected) in evaluation.classes.iter().zip(case["per_class"].as_array().unwrap()) {
            let expected = numbers(expected);
            let report = &evaluation.per_class[class];
            assert_eq!(triple(report), expected[..3], "case {index}, {class}");
            assert_eq!(report.support as f64, expected[3], "case {index}, {class}");
        }
        assert_eq!(triple(&evaluation.macro_average), numbers(&case["macro"]), "case {index}");
        assert_eq!(triple(&evaluation.weighted_average), numbers(&case["weighted"]), "case {index}");
        let confusion: Vec<Vec<f64>> = case["confusion"].as_array().unwrap().iter().map(numbers).collect();
        let counts: Vec<Vec<f64>> =
            evaluation.confusion.iter().map(|row| row.iter().map(|count| *count as f64).collect()).collect();
        assert_eq!(counts, confusion, "case {index}");
    }
}

#[test]
fn windows_the_classifier_does_not_know_are_counted_and_named() {
    let mut tally = Tally::new(&Gesture::PAPER_ACTIVE.map(Class::Gesture));
    assert_eq!(tally.class_of(Gesture::REST), None);
    let truth = tally.class_of(Gesture::GRIP).unwrap();
    let answer = Answer { probabilities: &[0.1, 0.1, 0.1, 0.1, 0.6], work_ns: 200_000 };
    tally.record(truth, Origin { person: PersonId::Number(19), repetition: 7 }, answer);
    let evaluation = Evaluation::of(&tally);
    assert_eq!(evaluation.windows_left_out["rest"], 1);
    assert_eq!((evaluation.windows, evaluation.accuracy), (1, 1.0));
    assert_eq!(evaluation.per_person[&PersonId::Number(19)].correct, 1);
    let table = evaluation.to_string();
    for part in
        ["accuracy 1.0000", "left out: 1 windows of rest", "person 19", "repetition 7", "200 us (p50)"]
    {
        assert!(table.contains(part), "`{part}` is not in:\n{table}");
    }
}
