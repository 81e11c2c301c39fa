//! Fit, file and use of a person, and what is wrong with each.

mod common;

use common::{CHANNELS, Noise, Recorded, SAMPLES, fit, gestures, record, signal, window};
use proptest::prelude::*;
use tendon_gesture::Gesture;
use tendon_people::{
    Adaptation, CalibrationError, Finding, HeldOut, People, PeopleError, Person, PersonName,
    PersonalRecogniser, SignalOffer,
};

fn person() -> Person {
    fit(&record(&gestures(), 2, 1)).expect("a person")
}

#[test]
fn a_person_recognises_their_gestures_with_effort_and_rejects_what_they_never_made() {
    let person = person();
    let set = person.gesture_set();
    let names: Vec<String> = set.iter().map(String::from).collect();
    assert_eq!(names, ["rest", "fist", "point", "wave_out"], "rest is first");
    assert_eq!(person.findings, []);
    assert_eq!(person.expected.held_out, HeldOut::Repetitions);
    assert!(person.expected.accuracy > 0.99, "{}", person.expected.accuracy);
    assert_eq!((person.repetitions(), person.gestures[1].windows), (2, 60));

    let mut recogniser = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    let mut noise = Noise(99);
    for (name, gains) in gestures() {
        let (mut right, mut effort, mut near) = (0, 0.0, 0);
        for _ in 0..50 {
            let strength = if name == Gesture::REST { 1.0 } else { 1.15 };
            let gains = gains.map(|gain| if gain == 1.0 { gain } else { gain * strength });
            let recognition = recogniser.recognise_alone(&window(&mut noise, &gains)).expect("a recognition");
            assert!((recognition.probabilities.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            let gesture = usize::from(set.number(name).expect("a gesture of the person"));
            right += usize::from(recognition.probabilities[gesture] > 0.5);
            effort += recognition.efforts[gesture] / 50.0;
            near += usize::from(recognition.novelty < 1.0);
            assert_eq!(recognition.efforts[0], 0.0, "rest is no effort");
        }
        assert!(right >= 49 && near >= 45, "{name}: {right} right, {near} near");
        assert!(
            if name == Gesture::REST { effort == 0.0 } else { (0.8..=1.0).contains(&effort) },
            "{name}: {effort}"
        );
    }
    let strange = recogniser.recognise_alone(&window(&mut noise, &[0.01, 90.0, 0.01, 90.0]));
    assert!(strange.expect("a recognition").novelty > 1.5);
    let light = recogniser.recognise_alone(&window(&mut noise, &[2.0; CHANNELS])).expect("a recognition");
    assert!(light.efforts[1] > 0.1 && light.efforts[1] < 0.6, "{:?}", light.efforts);
}

#[test]
fn only_a_recogniser_that_adapts_follows_its_person() {
    let person = person();
    let off = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    let mut slow = off.clone().with_adaptation(Adaptation::Slow);
    let mut off = off.with_adaptation(Adaptation::default());
    // A fist as it was never made, but still a fist.
    let mut noise = Noise(7);
    let mut later = || window(&mut noise, &[4.6, 4.2, 5.0, 5.2]);
    let mut novelties = [[0.0; 2]; 2];
    for number in 0..400 {
        let window = later();
        for (way, recogniser) in [&mut off, &mut slow].into_iter().enumerate() {
            let recognition = recogniser.recognise_alone(&window).expect("a recognition");
            assert!(recognition.probabilities[1] > 0.95, "{:?}", recognition.probabilities);
            if !(50..350).contains(&number) {
                novelties[way][usize::from(number >= 350)] += recognition.novelty / 50.0;
            }
            recogniser.adapt();
        }
    }
    let [[off_first, off_last], [slow_first, slow_last]] = novelties;
    assert!((off_last - off_first).abs() < 0.05 * off_first, "{novelties:?}");
    assert!(slow_last < 0.98 * slow_first.min(off_last), "{novelties:?}");
    // What was adapted is gone with the recogniser.
    let mut again = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    let window = later();
    assert_eq!(again.recognise_alone(&window), off.recognise_alone(&window));
}

#[test]
fn one_repetition_is_enough_and_says_that_the_estimate_is_too_good() {
    let person = fit(&record(&gestures(), 1, 1)).expect("a person");
    assert_eq!(person.expected.held_out, HeldOut::PartsOfOneRepetition);
    assert!(person.expected.accuracy > 0.99);
    let windows: usize = person.expected.confusion.iter().flatten().sum();
    // Of 30 windows of 4 gestures, 5 at each border of 4 parts of 7 or 8 overlap, but at most half of a part is left out.
    assert_eq!(windows, 4 * (30 - 3 - 4 - 4));
}

#[test]
fn windows_of_a_stream_are_recognised_as_each_alone() {
    let person = person();
    let mut stream = PersonalRecogniser::new(&person, 50).expect("a recogniser");
    let mut alone = stream.clone();
    let mut noise = Noise(5);
    let signal: Vec<f32> = (0..CHANNELS * 1000).map(|_| noise.next()).collect();
    for at in [0, 50, 100, 150, 200, 400, 450, 0, 50] {
        let window: Vec<f32> =
            signal.chunks_exact(1000).flat_map(|channel| &channel[at..at + SAMPLES]).copied().collect();
        assert_eq!(stream.recognise(&window, at as u64), alone.recognise_alone(&window));
    }
}

#[test]
fn a_person_survives_the_file_to_the_bit() {
    let person = person();
    let text = person.to_text();
    assert!(text.starts_with("format = \"tendon-person\"\nversion = 1\n"));
    assert!(
        text.contains("name = \"anna\"") && text.contains("channels = [\"0\", \"3\", \"5\", \"8\"]"),
        "{text}"
    );
    assert_eq!(Person::from_text(&text).expect("the same"), person);
}

#[test]
fn every_damage_to_a_file_is_told_apart() {
    let text = person().to_text();
    let refused = |text: &str| Person::from_text(text).expect_err("refused").to_string();
    let half = &text[..text.len() / 2];
    for (damaged, said) in [
        (String::new(), "no person file"),
        ("session = \"x\"\n".to_owned(), "no person file"),
        (text.replace("tendon-person", "tendon-prior"), "no person file"),
        (text.replace("version = 1\n", "version = 2\n"), "version 2, and this program reads version 1"),
        (half.to_owned(), "cut short"),
        (text.replace("\"anna\"", "\"berta\"").replacen("bytes = ", "bytes = 1", 1), "cut short"),
        (text.replace("\"anna\"", "\"anne\""), "checksum"),
        (format!("{text}\n"), "checksum"),
    ] {
        assert!(refused(&damaged).contains(said), "{said}: {}", refused(&damaged));
    }
}

/// What the checksum cannot see: a file that was put together wrongly.
#[test]
fn a_body_that_does_not_fit_together_is_refused() {
    let text = person().to_text();
    let body = &text[text.find("name = ").expect("a body")..];
    assert!(Person::from_body(body).is_ok());
    for (from, to) in [
        ("name = \"anna\"", "name = \"Anna\""),
        ("window_samples = 300", "window_samples = 3"),
        ("window_samples = 300", "window_samples = 9007199254740993"),
        ("sample_rate_hz = 2000.0", "sample_rate_hz = 400.0"),
        ("channels = [\"0\", \"3\",", "channels = [\"0\", \"4\","),
        ("channels = [\"0\", ", "channels = ["),
        ("name = \"fist\"", "name = \"paper\""),
        ("name = \"fist\"", "name = \"Fist\""),
        ("name = \"rest\"", "name = \"fist\""),
        ("unit = ", "units = "),
        ("distance_limit = ", "distance_limit = -"),
        ("distance_limit = ", "distance_limit = 1e300 #"),
        ("floor_variance = ", "floor_variance = 1e300 #"),
        ("temperature = ", "temperature = 1e300 #"),
        ("comfortable = ", "comfortable = 1e300 #"),
        ("rest_rms = ", "rest_rms = 1e300 #"),
        ("biases = [", "biases = [1e300, "),
        ("factor = \"", "factor = \"////////7w8"),
        ("feature_count = 136", "feature_count = 135"),
        ("feature_count = 136", "feature_count = 9223372036854775807"),
        ("weights = \"", "weights = \"AAAA"),
        ("largest_rows = 32", "largest_rows = 999"),
        ("held_out = \"repetitions\"", "held_out = \"nothing\""),
    ] {
        let changed = body.replacen(from, to, 1);
        assert_ne!(changed, body, "{from} is in the file");
        let message = Person::from_body(&changed).expect_err(to).to_string();
        assert!(message.contains("calibrate again"), "{from} -> {to}: {message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A forged file is refused, or recognises: it never ends a session at its first window.
    #[test]
    fn what_is_read_recognises_whatever_its_numbers_are(
        at in 0.0..1.0_f64,
        number in prop::sample::select(vec!["1e300", "-1e300", "1e-300", "inf", "nan", "0.0", "1e30", "9e18"]),
        digits in "[A-Za-z0-9+/]{1,12}",
    ) {
        let text = person_text();
        let body = &text[text.find("name = ").expect("a body")..];
        // A number that people can read.
        let places: Vec<(usize, &str)> = body.match_indices(" = ").chain(body.match_indices(", ")).collect();
        let (place, sign) = places[(at * (places.len() - 1) as f64) as usize];
        let begin = place + sign.len();
        let length = body[begin..].find([',', ']', '\n']).unwrap_or(0);
        let readable = format!("{}{number}{}", &body[..begin], &body[begin + length..]);
        // One in base64.
        let begin = body.find("weights = \"").expect("weights");
        let place = begin + 11 + (at * (body.len() - begin - 60) as f64) as usize;
        let coded = format!("{}{digits}{}", &body[..place], &body[place + digits.len()..]);
        for changed in [readable, coded] {
            let Ok(person) = Person::from_body(&changed) else { continue };
            let mut recogniser = PersonalRecogniser::new(&person, 50).expect("a recogniser");
            let mut noise = Noise(3);
            for (_, gains) in gestures() {
                let recognition = recogniser.recognise_alone(&window(&mut noise, &gains)).expect("a recognition");
                let values = recognition.probabilities.iter().chain(recognition.efforts);
                prop_assert!(values.chain([&recognition.novelty]).all(|value| value.is_finite()));
            }
        }
    }

    #[test]
    fn no_text_makes_it_panic(at in 0.0..1.0_f64, noise in "[ -~\n]{0,40}", cut in 0_usize..200) {
        let text = person_text();
        let body = &text[text.find("name = ").expect("a body")..];
        for text in [&text, body] {
            let at = (at * (text.len() - 1) as f64) as usize;
            let changed = format!("{}{noise}{}", &text[..at], &text[(at + cut).min(text.len())..]);
            let _ = Person::from_text(&changed);
            let _ = Person::from_body(&changed);
        }
    }
}

/// A small one, so that it is read quickly.
fn person_text() -> String {
    use std::sync::OnceLock;
    static TEXT: OnceLock<String> = OnceLock::new();
    TEXT.get_or_init(|| person().to_text()).clone()
}

#[test]
fn what_does_not_fit_a_session_is_named_in_words() {
    let person = person();
    let names = ["0", "3", "5", "8"].map(str::to_owned);
    let fit = signal();
    let offer = SignalOffer {
        source: "the session",
        channels: 4,
        channel_names: Some(&names),
        sample_rate_hz: 2000.0,
        unit: "mV",
        window_samples: 300,
        filter: fit.filter.as_ref(),
    };
    assert_eq!(person.differences(&offer), []);
    let said = |offer: &SignalOffer| -> Vec<String> {
        person.differences(offer).iter().map(ToString::to_string).collect()
    };
    let others = ["0", "3", "5", "7"].map(str::to_owned);
    let mut filter = fit.filter.clone().expect("a filter");
    filter.notch_hz = None;
    let all = SignalOffer {
        channel_names: Some(&others),
        sample_rate_hz: 1000.0,
        unit: "count",
        window_samples: 600,
        filter: Some(&filter),
        ..offer
    };
    assert_eq!(
        said(&all),
        [
            "channels: calibrated with 0, 3, 5, 8, the session has 0, 3, 5, 7",
            "sampling rate: calibrated with 2000 Hz, the session has 1000 Hz",
            "unit: calibrated with mV, the session has count",
            "window: calibrated with 300 samples, the session has 600 samples",
            "notch: calibrated with a notch at 60 Hz, the session has no notch",
        ]
    );
    let fewer = SignalOffer { channels: 3, channel_names: None, ..offer };
    assert_eq!(said(&fewer), ["channels: calibrated with 4 (0, 3, 5, 8), the session has 3"]);
    let unknown = SignalOffer { channel_names: None, unit: "", filter: None, ..offer };
    assert_eq!(said(&unknown), [""; 0], "what is not known is not compared");
    let mut counts = person.clone();
    counts.signal.unit = "adc_counts".to_owned();
    assert_eq!(counts.differences(&SignalOffer { unit: "ADC counts", ..offer }), [], "another spelling");
}

fn findings(change: impl Fn(usize, &mut [f32], u32, usize)) -> Vec<Finding> {
    let mut recorded = record(&gestures(), 2, 1);
    let Recorded { samples, labels, repetitions, .. } = &mut recorded;
    for (number, window) in samples.chunks_exact_mut(CHANNELS * SAMPLES).enumerate() {
        change(labels[number], window, repetitions[number], number % 30);
    }
    fit(&recorded).expect("a person").findings
}

#[test]
fn what_went_wrong_is_found_and_said() {
    let mut noise = Noise(7);
    let rest: Vec<f32> = window(&mut noise, &[1.0; CHANNELS]);
    // The place of rest is 1, of `point` 2.
    let not_made = findings(|label, window, repetition, number| {
        if label == 2 {
            window.copy_from_slice(&rest);
            window.rotate_left(17 * (number + 1) + repetition as usize);
        }
    });
    assert!(
        matches!(&not_made[0], Finding::NotMade { gesture } if gesture.name() == "point"),
        "{not_made:?}"
    );
    assert!(not_made[0].is_serious() && not_made[0].to_string().starts_with("point looks like rest"));

    let fell_off = findings(|label, window, repetition, _| {
        if repetition == 1 && label == 2 {
            window[3 * SAMPLES..].iter_mut().for_each(|sample| *sample *= 1e-3);
        }
    });
    let said = fell_off[0].to_string();
    assert!(said.contains("channel 3 (`8`) lost its signal during point, repetition 2"), "{said}");

    let flat = findings(|_, window, _, _| window[..SAMPLES].fill(0.0));
    assert!(flat[0].to_string().contains("channel 0 (`0`) has no signal"), "{}", flat[0]);

    let hum = findings(|_, window, _, _| {
        for (at, sample) in window[..SAMPLES].iter_mut().enumerate() {
            *sample += (std::f32::consts::TAU * 50.0 * at as f32 / 2000.0).sin();
        }
    });
    assert!(hum.iter().any(|finding| finding.to_string().contains("picks up the 50 Hz mains")), "{hum:?}");
}

#[test]
fn gestures_that_look_alike_are_named_with_what_to_do() {
    let mut alike = gestures();
    alike.push(("point_up".parse().expect("a name"), [6.0, 1.45, 1.0, 1.0]));
    let person = fit(&record(&alike, 2, 3)).expect("a person");
    let said: Vec<String> = person.findings.iter().map(ToString::to_string).collect();
    assert!(
        said.iter()
            .any(|said| said.starts_with("point and point_up look alike") && said.contains("further apart")),
        "{said:?}"
    );
    assert!(person.expected.accuracy < 0.95);
}

#[test]
fn a_calibration_that_cannot_be_fitted_says_what_is_missing() {
    let message = |recorded: &Recorded| fit(recorded).expect_err("refused").to_string();
    let all = || record(&gestures(), 1, 1);
    let without_rest: Vec<_> = gestures().into_iter().filter(|(name, _)| *name != Gesture::REST).collect();
    assert!(matches!(fit(&record(&without_rest, 1, 1)), Err(CalibrationError::NoRest)));
    let only_rest: Vec<_> = gestures().into_iter().filter(|(name, _)| *name == Gesture::REST).collect();
    assert!(matches!(fit(&record(&only_rest, 1, 1)), Err(CalibrationError::Gestures(_))));
    let mut missing = all();
    missing.gestures.push("never".parse().expect("a name"));
    assert!(message(&missing).contains("never has 0 windows for calibration"), "{}", message(&missing));
    let mut twice = all();
    twice.gestures[2] = twice.gestures[0];
    assert!(message(&twice).contains("the gesture fist is there twice"), "{}", message(&twice));
    let mut short = all();
    short.samples.pop();
    assert!(matches!(fit(&short), Err(CalibrationError::Shape { .. })));
    let mut strange = all();
    strange.labels[3] = 9;
    assert!(matches!(fit(&strange), Err(CalibrationError::Label { window: 3, label: 9, gestures: 4 })));
    let mut flat = all();
    flat.samples.fill(0.0);
    assert!(message(&flat).contains("rest is flat"));
}

#[test]
fn people_are_kept_by_name_for_their_owner_alone() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let people = People::at(&folder.path().join("people")).expect("a folder of people");
    let person = person();
    let anna = person.name.clone();
    assert_eq!(people.names().expect("a list"), []);
    let nobody = people.find(&anna).expect_err("nobody yet").to_string();
    assert!(nobody.contains("there is no person `anna` (there is nobody yet)"), "{nobody}");
    let file = people.add(&person).expect("kept");
    for path in [file.as_path(), file.parent().expect("a folder"), &folder.path().join("people")] {
        let mode = std::fs::metadata(path).expect("there").permissions().mode();
        assert_eq!(mode & 0o077, 0, "{} is for its owner alone", path.display());
    }
    assert_eq!(people.find(&anna).expect("found"), person);
    let again = people.add(&person).expect_err("refused").to_string();
    assert!(again.contains("there is a person `anna` already") && again.contains("--replace"), "{again}");
    let previous = people.previous_of(&anna);
    assert!(!previous.exists());
    let mut other = person.clone();
    other.made.at = "2026-02-03T04:05:06Z".to_owned();
    people.replace(&other).expect("replaced");
    assert_eq!(Person::read(&previous).expect("the person before"), person);
    assert_ne!(person.checksum(), other.checksum());
    people.replace(&person).expect("replaced");
    assert_eq!(Person::read(&previous).expect("the person before"), other);
    let reserved = people.reserve(&anna).expect("nobody else calibrates");
    let busy = people.reserve(&anna).expect_err("reserved").to_string();
    assert!(busy.contains("`anna` is being calibrated") && busy.contains("another name"), "{busy}");
    drop(reserved);
    people.reserve(&anna).expect("free again");
    // What else lies there is nobody.
    std::fs::create_dir(folder.path().join("people/empty")).expect("a folder");
    std::fs::write(folder.path().join("people/Notes.txt"), "x").expect("a file");
    assert_eq!(people.names().expect("a list"), std::slice::from_ref(&anna));
    let berta: PersonName = "berta".parse().expect("a name");
    let unknown = people.find(&berta).expect_err("nobody").to_string();
    assert!(unknown.contains("there is no person `berta`, only anna"), "{unknown}");

    // A file that others can write to, or that is another person's.
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o666)).expect("changed");
    let untrusted = people.find(&anna).expect_err("refused").to_string();
    assert!(untrusted.contains("mode 0666") && untrusted.contains("chmod 600"), "{untrusted}");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("changed");
    let copy = people.file_of(&berta);
    std::fs::create_dir(copy.parent().expect("a folder")).expect("a folder");
    std::fs::copy(&file, &copy).expect("copied");
    let other = people.find(&berta).expect_err("refused").to_string();
    assert!(other.contains("it is the file of `anna`, not of `berta`"), "{other}");

    let text = std::fs::read_to_string(&file).expect("the file");
    std::fs::write(&file, &text[..text.len() - 9]).expect("cut short");
    assert!(matches!(people.find(&anna), Err(PeopleError::File(_))));
}

#[test]
fn what_changed_of_each_channel_since_the_calibration_is_measured() {
    let person = person();
    let later = record(&gestures(), 1, 5);
    let stronger: Vec<f32> = later
        .samples
        .iter()
        .enumerate()
        .map(|(at, sample)| if at / SAMPLES % CHANNELS == 2 { 3.0 * sample } else { *sample })
        .collect();
    let made = later.labels.iter().map(|&label| later.gestures[label]);
    let shifts = person.shifts(made.zip(stronger.chunks_exact(CHANNELS * SAMPLES)));
    for (channel, shift) in shifts.iter().enumerate() {
        let expected = if channel == 2 { 3.0 } else { 1.0 };
        assert!((shift.rest / expected - 1.0).abs() < 0.03, "{shift:?}");
        assert!((shift.gestures / expected - 1.0).abs() < 0.03, "{shift:?}");
    }
    assert_eq!(shifts[2].name, "5");
}

#[test]
fn what_is_as_weak_as_rest_counts_for_nothing_in_what_is_expected() {
    let recorded = |pauses: bool| {
        let mut recorded = record(&gestures(), 2, 1);
        let mut noise = Noise(11);
        for (number, samples) in recorded.samples.chunks_exact_mut(CHANNELS * SAMPLES).enumerate() {
            // The person begins late: a third of each gesture is rest still.
            if pauses && number % 30 < 10 {
                samples.copy_from_slice(&window(&mut noise, &[1.0; CHANNELS]));
            }
        }
        fit(&recorded).expect("a person").expected
    };
    let prompt = recorded(false);
    assert!(prompt.without_effort_share < 0.01 && prompt.accuracy > 0.99, "{prompt:?}");
    let late = recorded(true);
    assert!((late.without_effort_share - 1.0 / 3.0).abs() < 0.05, "{late:?}");
    // If all windows counted, a third of each gesture would be taken for rest.
    assert!(late.accuracy > 0.9, "{late:?}");
    let counted: usize = late.confusion.iter().flatten().sum();
    assert!(counted < 240 - 50, "{late:?}");
}
