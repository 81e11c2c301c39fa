//! Strategies on continuous recordings of people made up here: noise whose amplitudes tell the gesture.
#![allow(clippy::unwrap_used, reason = "helpers of tests may do what tests may")]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use tendon_classifier::Adaptation;
use tendon_dataset::{DatasetSettings, Layout, list};
use tendon_evaluation::{
    Calibrating, PersonRecordings, calibrate_person, dataset_settings, gather_cohort, score_personal,
    with_trials,
};
use tendon_features::MethodSettings;
use tendon_gesture::{DecisionSettings, Gesture, Strategy};
use tendon_pipeline::PipelineSettings;
use tendon_recordings::Channel;
use tendon_signal::{FilterSettings, OnsetMethod, OnsetSettings, SignalSettings, WindowSettings};

const RATE_HZ: f64 = 1000.0;
/// Samples of a trial, and of the rest after it that has no cue.
const TRIAL: usize = 3000;
const PAUSE: usize = 2500;

fn pipeline_settings() -> PipelineSettings {
    PipelineSettings {
        channels: 4,
        sample_rate_hz: RATE_HZ,
        signal: SignalSettings {
            filter: FilterSettings { band_pass_hz: [5.0, 450.0], ..FilterSettings::default() },
            windows: WindowSettings { window_samples: 150, increment_samples: 25 },
            ..SignalSettings::default()
        },
        decision: DecisionSettings { strategy: Strategy::Personal, ..DecisionSettings::default() },
    }
}

fn settings() -> DatasetSettings {
    DatasetSettings {
        recording_rate_hz: Some(RATE_HZ),
        ..dataset_settings(&pipeline_settings(), &[0, 1, 2, 3].map(Channel::Index))
    }
}

/// Noise with an amplitude for each gesture and channel; a gesture begins half a second after its cue.
struct Recorder {
    table: String,
    samples: usize,
    random: u32,
    /// The newest values of each channel.
    newest: [[f64; 3]; 4],
}

impl Recorder {
    /// White noise would be that of an electrode which is off: muscles are smoother, so each value is a mean of three.
    fn noise(&mut self, channel: usize) -> f64 {
        self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let newest = &mut self.newest[channel];
        newest.rotate_right(1);
        newest[0] = f64::from(self.random >> 8) / f64::from(1 << 24) - 0.5;
        newest.iter().sum::<f64>() / 3.0
    }

    fn make(&mut self, gesture: Gesture, samples: usize) {
        let number = usize::from(gesture.paper_number().unwrap());
        for _ in 0..samples {
            let line: Vec<String> = (0..4)
                .map(|channel| {
                    let strong = if number == 0 { 0.0 } else { ((number * (channel + 2)) % 7) as f64 };
                    format!("{:.3}", (1.0 + 4.0 * strong) * self.noise(channel))
                })
                .collect();
            self.table += &line.join(",");
            self.table.push('\n');
        }
        self.samples += samples;
    }
}

/// Writes a session of a person into `folder`: a file with `repetitions` of rest and the five gestures.
fn record(folder: &Path, labels: &mut String, person: u16, session: u32, repetitions: u32) {
    let random = 7 * u32::from(person) + session;
    let mut recorder = Recorder { table: String::new(), samples: 0, random, newest: [[0.0; 3]; 4] };
    let file = format!("{person}-{session}.csv");
    for repetition in 0..repetitions {
        for gesture in Gesture::PAPER {
            let start = recorder.samples;
            recorder.make(Gesture::REST, 500);
            recorder.make(gesture, TRIAL - 500);
            let end = recorder.samples;
            writeln!(labels, "{file},{person},{session},{repetition},{gesture},{start},{end}").unwrap();
            recorder.make(Gesture::REST, PAUSE);
        }
    }
    fs::write(folder.join(file), recorder.table).unwrap();
}

const HEADER: &str = "file,person,session,repetition,gesture,start_sample,end_sample\n";

fn people_in(folder: &Path, labels: &str) -> Vec<PersonRecordings> {
    fs::write(folder.join("labels.csv"), labels).unwrap();
    let found = list(&settings(), &[folder.to_owned()]).unwrap();
    let (people, skipped) = with_trials(&settings(), found.recordings);
    assert_eq!(skipped, []);
    people
}

#[test]
fn a_calibrated_person_steers_in_the_repetitions_that_did_not_calibrate() {
    let folder = tempfile::tempdir().unwrap();
    let mut labels = HEADER.to_owned();
    for person in 1..=2 {
        record(folder.path(), &mut labels, person, 1, 2);
        record(folder.path(), &mut labels, person, 2, 1);
    }
    // Of the third person there is only one session, of two repetitions.
    record(folder.path(), &mut labels, 3, 1, 2);
    let mut people = people_in(folder.path(), &labels);
    let dataset = DatasetSettings {
        onset: OnsetSettings { method: OnsetMethod::Fixed, ..OnsetSettings::default() },
        fallback_ms: 1200.0,
        rest_start_ms: 1200.0,
        ..settings()
    };
    let method = MethodSettings::default();
    let paths = [folder.path().to_owned()];
    let cohort = gather_cohort(&paths, &dataset, &method, &mut Vec::new(), &mut |_, _| {}).unwrap();
    let calibrating =
        Calibrating { dataset: &dataset, method: &method, cohort: &cohort, layout: Layout::Labelled };
    let mut recognisers = Vec::new();
    for person in &mut people {
        person.hold_back(Some(1)).unwrap();
        let recogniser = calibrate_person(person, &calibrating).unwrap();
        assert_eq!(recogniser.repetitions(), 1, "one repetition calibrates, whatever there is");
        let own = person.person().to_string();
        let others = &recogniser.made.prior_people;
        assert!(!others.is_empty() && others.iter().all(|other| !other.ends_with(&own)), "{others:?}");
        recognisers.push(recogniser);
    }
    let scores = score_personal(
        &pipeline_settings(),
        Adaptation::Off,
        &settings(),
        &people,
        &recognisers,
        &mut |_, _| {},
    )
    .unwrap();
    // The second session of two people; the second repetition of the third: five movements each.
    assert_eq!(scores.repetitions, 3);
    let answered = scores.onset_to_first_correct_command_ms;
    assert_eq!(answered.count + scores.never_answered.unwrap() + scores.movements_without_onset, 15);
    assert!(answered.count >= 12 && scores.never_answered == Some(0), "{scores}");
    assert!(scores.correct_share.unwrap() > 0.8, "{scores}");
    assert!(scores.wrong_direction_share.unwrap() < 0.05, "{scores}");
    assert!(scores.rest_taken_for_movement_share.unwrap() < 0.05, "{scores}");
    // Rest: a cue of 3 s from 0.5 s on, 95 windows of 150 ms; and of each of five pauses of 2.5 s what is left after 1.2 s,
    // 47 windows. The activity detector of the third person needs the rest of both repetitions: 35 windows are left.
    let windows = 2 * (95 + 5 * 47) + 35 + 5 * 47;
    assert!((scores.rest_scored_s - 0.025 * f64::from(windows)).abs() < 1e-9, "{}", scores.rest_scored_s);
}

#[test]
fn what_calibrates_is_never_scored_and_something_must_be_left() {
    let folder = tempfile::tempdir().unwrap();
    let mut labels = HEADER.to_owned();
    record(folder.path(), &mut labels, 4, 1, 2);
    let mut people = people_in(folder.path(), &labels);
    let error = people[0].hold_back(Some(2)).unwrap_err().to_string();
    assert!(
        error.contains("person 4 has nothing left to score after 2") && error.contains("take fewer"),
        "{error}"
    );
    // By default, as many calibrate as leave something to score.
    people[0].hold_back(None).unwrap();

    let mut labels = HEADER.to_owned();
    record(folder.path(), &mut labels, 5, 1, 1);
    let error = people_in(folder.path(), &labels)[0].hold_back(None).unwrap_err().to_string();
    assert!(error.contains("person 5 has nothing left"), "{error}");
}
