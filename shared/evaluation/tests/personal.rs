//! Recognisers calibrated to each person: on people made up here, and on real recordings where they are.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may do what tests may")]

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use tendon_dataset::DatasetSettings;
use tendon_emg_simulation::{ContractionSettings, Performance, Profile, SimulatedEmg, SimulationSettings};
use tendon_evaluation::{
    PersonalError, PersonalScores, PersonalSettings, UnlabelledSettings, gather_cohort, score_people,
    score_unlabelled,
};
use tendon_features::MethodSettings;
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_recordings::{Channel, RecordedSession, RecordedTrial};
use tendon_signal::{OnsetMethod, OnsetSettings, WindowSettings};

const CHANNELS: usize = 4;
const TRIAL_SAMPLES: usize = 2000;

fn settings(repetitions: u32) -> PersonalSettings {
    PersonalSettings {
        dataset: DatasetSettings {
            channels: (0..CHANNELS).map(Channel::Index).collect(),
            recording_rate_hz: Some(1000.0),
            sample_rate_hz: 1000.0,
            filter: None,
            windows: WindowSettings { window_samples: 300, increment_samples: 75 },
            onset: OnsetSettings { method: OnsetMethod::Fixed, ..OnsetSettings::default() },
            fallback_ms: 0.0,
            rest_start_ms: 0.0,
            ..DatasetSettings::default()
        },
        method: MethodSettings::default(),
        repetitions,
    }
}

/// Noise of which each gesture has its own amplitudes, each person an own gain, and each session a little of its own.
struct Recorder {
    folder: PathBuf,
    labels: String,
    random: u32,
}

impl Recorder {
    fn new(folder: &Path) -> Recorder {
        let labels = "file,person,session,repetition,gesture,start_sample,end_sample\n".to_owned();
        Recorder { folder: folder.to_owned(), labels, random: 1 }
    }

    fn noise(&mut self) -> f64 {
        self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.random >> 8) / f64::from(1 << 24) - 0.5
    }

    fn record(&mut self, person: u16, session: u32, repetitions: u32, gestures: &[Gesture]) {
        let file = format!("{person}-{session}.csv");
        let mut table = String::new();
        let mut sample = 0;
        for repetition in 0..repetitions {
            for &gesture in gestures {
                for _ in 0..TRIAL_SAMPLES {
                    let line: Vec<String> = (0..CHANNELS)
                        .map(|channel| {
                            let number = usize::from(gesture.paper_number().unwrap());
                            let strong =
                                if number == 0 { 0.0 } else { ((number * (channel + 2)) % 7) as f64 };
                            let gain = 1.0 + 0.3 * f64::from(person) + 0.1 * f64::from(session);
                            format!("{:.3}", gain * (1.0 + 4.0 * strong) * self.noise())
                        })
                        .collect();
                    table += &line.join(",");
                    table.push('\n');
                }
                let end = sample + TRIAL_SAMPLES;
                writeln!(
                    self.labels,
                    "{file},{person},{session},{repetition},{},{sample},{end}",
                    gesture.name()
                )
                .unwrap();
                sample = end;
            }
        }
        fs::write(self.folder.join(&file), table).unwrap();
    }

    fn score(self, repetitions: u32) -> Result<PersonalScores, PersonalError> {
        fs::write(self.folder.join("labels.csv"), &self.labels).unwrap();
        let scored = score_people(&[self.folder], &settings(repetitions), &[], None, &mut |_, _| {});
        scored.map(|(scores, _)| scores)
    }
}

#[test]
fn people_are_calibrated_on_their_first_session_and_scored_on_their_last() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::new(folder.path());
    for person in 1..=3 {
        recorder.record(person, 1, 2, &Gesture::PAPER);
        recorder.record(person, 2, 1, &Gesture::PAPER);
    }
    let scores = recorder.score(1).unwrap();
    assert_eq!(scores.people, [1, 2, 3].map(PersonId::Number).into());
    assert_eq!(scores.prior_people, 2);
    // 2 s hold 23 windows of 300 ms; only the second session is scored, whose repetition is the third of all, from 0.
    assert_eq!(scores.evaluation.windows, 3 * 6 * 23);
    assert_eq!(scores.evaluation.per_repetition.keys().copied().collect::<Vec<u8>>(), [2]);
    assert!(scores.evaluation.accuracy > 0.95, "{}", scores.evaluation);
}

/// Records two repetitions of a stranger who comes with the simulation, as `tendon calibrate NAME` does.
fn record_stranger(folder: &Path, name: &str, stranger: &str) {
    let profile = Profile::of_stranger(stranger).unwrap();
    let simulation = SimulationSettings { channels: CHANNELS, sample_rate_hz: 1000.0, ..Default::default() };
    let mut emg = SimulatedEmg::new(&profile, &simulation).unwrap();
    let mut performance = Performance::at_rest(emg.gestures(), ContractionSettings::default(), 1000.0);
    let channels = (0..CHANNELS).map(|channel| format!("channel_{channel}")).collect();
    let session = RecordedSession::new(name.parse().unwrap(), "2026-01-02T03:04:05Z", channels, 1000.0);
    let mut recorder = tendon_recordings::Recorder::create(folder, session).unwrap();
    let mut sample = 0;
    let mut block = vec![0.0; CHANNELS * 500];
    for repetition in 0..2 {
        for gesture in Gesture::PAPER {
            performance.set_gesture(gesture, 1.0);
            for _ in 0..4 {
                emg.fill_block(&mut performance, &mut block);
                recorder.push(sample, &block).unwrap();
                sample += 500;
            }
            let (start_sample, end_sample, asked) = (sample - 1500, sample, String::new());
            let trial = RecordedTrial { gesture, repetition, asked, start_sample, end_sample };
            assert!(recorder.label(trial).unwrap());
        }
    }
    recorder.flush().unwrap();
}

#[test]
fn two_people_whom_tendon_recorded_are_scored_as_two_and_each_without_their_own_prior() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["anna", "ben"].map(|name| folder.path().join(name));
    record_stranger(&paths[0], "anna", "stranger-19");
    record_stranger(&paths[1], "ben", "stranger-22");
    let mut settings = settings(1);
    settings.dataset.channels =
        (0..CHANNELS).map(|channel| Channel::Name(format!("channel_{channel}"))).collect();
    let (scores, _) = score_people(&paths, &settings, &[], None, &mut |_, _| {}).unwrap();
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    assert_eq!((people, scores.prior_people), (vec!["anna".to_owned(), "ben".to_owned()], 1));
    let text = serde_json::to_string(&scores).unwrap();
    assert_eq!(text.matches("\"people\":").count(), 1, "{text}");
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["people"], serde_json::json!(["anna", "ben"]));
    assert!(json["people_spread"]["mean"].as_f64() > Some(0.5), "{json}");
    assert!(json["per_person"]["anna"].is_object() && json["per_person"]["ben"].is_object(), "{json}");
    let (scores, _) =
        score_people(&paths, &settings, &["ben".parse().unwrap()], None, &mut |_, _| {}).unwrap();
    assert_eq!(scores.people.iter().map(ToString::to_string).collect::<Vec<_>>(), ["ben"]);
    let cohort = gather_cohort(&paths, &settings.dataset, &settings.method, &mut Vec::new(), &mut |_, _| {});
    let members: Vec<String> = cohort.unwrap().members().map(ToString::to_string).collect();
    assert_eq!(members, ["anna", "ben"]);
}

#[test]
fn of_a_person_with_one_session_what_did_not_calibrate_is_scored() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::new(folder.path());
    recorder.record(7, 1, 3, &Gesture::PAPER);
    let scores = recorder.score(2).unwrap();
    assert_eq!((scores.prior_people, scores.evaluation.windows), (0, 6 * 23));
    assert!(scores.evaluation.accuracy > 0.95, "{}", scores.evaluation);
}

#[test]
fn who_cannot_be_calibrated_is_left_out_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::new(folder.path());
    for session in 1..=2 {
        recorder.record(1, session, 1, &Gesture::PAPER);
        recorder.record(2, session, 1, &Gesture::PAPER_ACTIVE);
        recorder.record(3, session, 1, &[Gesture::REST]);
    }
    let scores = recorder.score(1).unwrap();
    assert_eq!(scores.people, [PersonId::Number(1)].into());
    let reasons: Vec<String> = scores.skipped.iter().map(ToString::to_string).collect();
    let reasons = reasons.join("\n");
    assert!(reasons.contains("person 2: ") && reasons.contains("rest"), "{reasons}");
    assert!(reasons.contains("person 3: "), "{reasons}");

    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::new(folder.path());
    recorder.record(2, 1, 1, &Gesture::PAPER_ACTIVE);
    let error = recorder.score(1).unwrap_err().to_string();
    assert!(error.contains("nobody can be calibrated") && error.contains("person 2"), "{error}");
}

/// One repetition of the six gestures lasts 12 s.
#[test]
fn without_labels_a_stretch_of_use_calibrates_what_others_made_alike() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::new(folder.path());
    for person in 1..=4 {
        recorder.record(person, 1, 2, &Gesture::PAPER);
        recorder.record(person, 2, 1, &Gesture::PAPER);
    }
    fs::write(folder.path().join("labels.csv"), &recorder.labels).unwrap();
    let paths = [folder.path().to_owned()];
    let PersonalSettings { dataset, method, .. } = settings(1);
    let settings = UnlabelledSettings { dataset, method, stretch_s: 12.0 };

    let (scores, _) =
        score_unlabelled(&paths, &settings, &[2].map(PersonId::Number), &mut |_, _| {}).unwrap();
    assert_eq!((scores.scores.people.clone(), scores.scores.prior_people), ([PersonId::Number(2)].into(), 3));
    assert_eq!(scores.scores.evaluation.windows, 6 * 23, "the last session");
    assert!(scores.scores.evaluation.accuracy > 0.95, "{}", scores.scores.evaluation);
    let [person] = &scores.unlabelled[..] else { panic!("one person") };
    assert!(person.right_labels > 0.9 && person.sureness > 0.5, "{person:?}");
    assert_eq!(person.all_stretches.len(), 3, "two in the first session, one in the second");

    let (scores, _) =
        score_unlabelled(&paths, &settings, &[1, 2].map(PersonId::Number), &mut |_, _| {}).unwrap();
    assert_eq!(scores.scores.prior_people, 2, "nobody who is scored tells of others");
    let everybody = score_unlabelled(&paths, &settings, &[1, 2, 3].map(PersonId::Number), &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(everybody.contains("1 other people are too few"), "{everybody}");
    let everybody = score_unlabelled(&paths, &settings, &[1, 2, 3, 4].map(PersonId::Number), &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(everybody.contains("0 other people are too few"), "{everybody}");
    let short = UnlabelledSettings { stretch_s: 2.0, ..settings };
    let error =
        score_unlabelled(&paths, &short, &[2].map(PersonId::Number), &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("person 2") && error.contains("too few to find 6 gestures"), "{error}");
}

/// The bars of the personal recogniser are far above this; three people make a poor prior.
#[test]
fn real_people_are_well_recognised_after_one_repetition() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/3dc");
    let paths: Vec<PathBuf> = [1, 5, 11].map(|person| folder.join(format!("Participant{person}"))).into();
    if !paths.iter().all(|path| path.exists()) {
        println!("skipped: recordings not found");
        return;
    }
    let dataset = DatasetSettings {
        onset: OnsetSettings { method: OnsetMethod::Fixed, ..OnsetSettings::default() },
        fallback_ms: 1200.0,
        rest_start_ms: 1200.0,
        ..DatasetSettings::default()
    };
    let settings = PersonalSettings { dataset, method: MethodSettings::default(), repetitions: 1 };
    let (scores, _) = score_people(&paths, &settings, &[], None, &mut |_, _| {}).unwrap();
    assert!(scores.evaluation.people_spread.mean > 0.92, "{}", scores.evaluation);
    assert!(scores.longest_fit_s < 60.0);
}
