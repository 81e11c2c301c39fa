//! Fitting, cross-validation and the prior: what is refused, and what must hold.

use tendon_features::{
    Class, Cohort, CrossValidation, Discriminant, FeatureLayout, FitError, LaggedLogCovariance, MemberId,
    MethodSettings, Prior, PriorError, Training, WithinClassScatter, recognised_in_new_repetitions,
};
use tendon_identity::PersonId;

/// Windows of three features about the means 0, 3 and 6, in turns of the classes.
struct Session {
    classes: Vec<Class>,
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
}

impl Session {
    fn new(windows: usize, seed: u32) -> Session {
        let mut random = seed;
        let mut noise = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(random >> 8) / f64::from(1 << 24) - 0.5
        };
        let labels: Vec<usize> = (0..windows).map(|window| window % 3).collect();
        let features = labels.iter().flat_map(|&label| {
            let common = noise();
            [3.0 * label as f64 + common, common + noise(), noise()]
        });
        Session {
            classes: ["rest", "fist", "wave"]
                .map(|name| Class { name: name.to_owned(), weight: 1.0 })
                .to_vec(),
            features: features.collect(),
            blocks: (0..windows).map(|window| window * 4 / windows).collect(),
            labels,
        }
    }

    fn training(&self) -> Training<'_> {
        Training {
            classes: &self.classes,
            feature_count: 3,
            features: &self.features,
            labels: &self.labels,
            increment_s: 0.075,
            blocks: &self.blocks,
        }
    }

    fn refused(&self) -> FitError {
        Discriminant::fit(&self.training(), None, &MethodSettings::default()).expect_err("refused")
    }
}

fn layout() -> FeatureLayout {
    FeatureLayout {
        channels: 2,
        delays_ms: vec![0.0],
        lowest_rate_hz: 1000.0,
        highest_rate_hz: 2000.0,
        piece_ms: 75.0,
    }
}

fn prior() -> Prior {
    let scatter = WithinClassScatter::new(&Session::new(90, 7).training()).expect("a scatter");
    Prior::pool(layout(), [("other", &scatter)]).expect("a prior")
}

#[test]
fn training_that_does_not_do_is_refused_by_name() {
    let session = || Session::new(60, 1);

    let mut few = session();
    few.labels.iter_mut().filter(|label| **label == 2).skip(4).for_each(|label| *label = 0);
    assert_eq!(few.refused(), FitError::TooFewWindows { class: "wave".to_owned(), windows: 4, needed: 5 });

    let mut one = session();
    one.classes.truncate(1);
    assert_eq!(one.refused(), FitError::TooFewClasses(1));

    let mut weightless = session();
    weightless.classes[1].weight = 0.0;
    assert_eq!(weightless.refused(), FitError::Weight { class: "fist".to_owned(), weight: 0.0 });

    let mut unknown = session();
    unknown.labels[5] = 3;
    assert_eq!(unknown.refused(), FitError::Label { window: 5, label: 3, classes: 3 });

    let mut bad = session();
    bad.features[3 * 5 + 1] = f64::NAN;
    assert_eq!(bad.refused(), FitError::NotFinite { window: 5 });

    let mut short = session();
    short.features.pop();
    assert_eq!(short.refused(), FitError::Shape { values: 179, labels: 60, blocks: 60, length: 3 });

    let mut flat = session();
    let labels = flat.labels.clone();
    flat.features.chunks_exact_mut(3).zip(labels).for_each(|(window, label)| window.fill(label as f64));
    assert_eq!(flat.refused(), FitError::Singular);

    let settings = MethodSettings { ridge: -1.0, ..MethodSettings::default() };
    let error = Discriminant::fit(&session().training(), None, &settings).expect_err("refused");
    assert!(error.to_string().contains("ridge"), "{error}");
}

#[test]
fn a_gesture_in_one_block_only_cannot_be_held_out() {
    let mut session = Session::new(60, 1);
    let labels = session.labels.clone();
    session.blocks.iter_mut().zip(labels).filter(|(_, label)| *label == 1).for_each(|(block, _)| *block = 2);
    let error = CrossValidation::new(&session.training(), None, &MethodSettings::default());
    assert_eq!(error.expect_err("refused"), FitError::CannotHoldOut { class: "fist".to_owned(), block: 2 });
}

#[test]
fn windows_that_do_not_fit_are_refused() {
    let discriminant =
        Discriminant::fit(&Session::new(60, 1).training(), None, &MethodSettings::default()).expect("a fit");
    let mut posterior = [0.0; 3];
    assert_eq!(
        discriminant.posterior(&[0.0; 2], &mut posterior),
        Err(FitError::Length { what: "features", given: 2, needed: 3 })
    );
    assert_eq!(
        discriminant.posterior(&[0.0; 3], &mut posterior[1..]),
        Err(FitError::Length { what: "scores", given: 2, needed: 3 })
    );
    for bad in [f64::NAN, f64::INFINITY] {
        let features = [0.0, bad, 0.0];
        assert_eq!(discriminant.posterior(&features, &mut posterior), Err(FitError::NotFinite { window: 0 }));
        let distance = discriminant.distance(&features, &mut [0.0; 3]);
        assert_eq!(distance, Err(FitError::NotFinite { window: 0 }));
    }
    for temperature in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = discriminant.clone().with_temperature(temperature).expect_err("refused");
        assert!(matches!(error, FitError::Temperature(_)));
    }
}

#[test]
fn a_gesture_is_recognised_however_many_windows_it_has() {
    let mut session = Session::new(60, 1);
    // Ten times as much rest.
    let rest = Session::new(600, 2);
    for (window, (label, block)) in rest
        .features
        .chunks_exact(3)
        .zip(rest.labels.iter().zip(&rest.blocks))
        .filter(|(_, (label, _))| **label == 0)
    {
        session.features.extend_from_slice(window);
        session.labels.push(*label);
        session.blocks.push(*block);
    }
    let settings = MethodSettings::default();
    let validation = CrossValidation::new(&session.training(), None, &settings).expect("a validation");
    let confusion = validation.confusion(|_| true);
    for (class, row) in confusion.iter().enumerate() {
        assert_eq!(row.iter().sum::<usize>(), row[class], "{confusion:?}");
    }
    // Everything is right, so nothing speaks for a temperature above the lowest.
    assert!((validation.temperature(&settings) - settings.temperature_range[0]).abs() < 1e-4);

    let discriminant = Discriminant::fit(&session.training(), None, &settings).expect("a fit");
    // Halfway between the means of rest and fist, both are as likely.
    let mean = |class: usize| -> Vec<f64> {
        let windows: Vec<&[f64]> = session
            .features
            .chunks_exact(3)
            .zip(&session.labels)
            .filter_map(|(window, label)| (*label == class).then_some(window))
            .collect();
        (0..3).map(|i| windows.iter().map(|window| window[i]).sum::<f64>() / windows.len() as f64).collect()
    };
    let halfway: Vec<f64> = mean(0).iter().zip(mean(1)).map(|(rest, fist)| 0.5 * (rest + fist)).collect();
    let mut posterior = [0.0; 3];
    discriminant.posterior(&halfway, &mut posterior).expect("a posterior");
    assert!((posterior[0] - posterior[1]).abs() < 1e-9, "{posterior:?}");
    assert!((posterior.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    // A mean is at distance 0, and what was never made is far away.
    let mut whitened = [0.0; 3];
    assert!(discriminant.distance(&mean(1), &mut whitened).expect("a distance") < 1e-6);
    let far = discriminant.distance(&[0.0, 0.0, 50.0], &mut whitened).expect("a distance");
    assert!(far > 10.0 * validation.distance_at(1.0), "{far}");
}

#[test]
fn a_fit_survives_a_file_and_a_damaged_one_is_refused() {
    let session = Session::new(60, 1);
    let discriminant = Discriminant::fit(&session.training(), Some(&prior()), &MethodSettings::default())
        .and_then(|discriminant| discriminant.with_temperature(3.0))
        .expect("a fit");
    let text = serde_json::to_string(&discriminant).expect("JSON");
    let read: Discriminant = serde_json::from_str(&text).expect("the same");
    let (mut ours, mut theirs) = ([0.0; 3], [0.0; 3]);
    discriminant.posterior(&[1.0, 2.0, 3.0], &mut ours).expect("a posterior");
    read.posterior(&[1.0, 2.0, 3.0], &mut theirs).expect("a posterior");
    ours.iter().zip(&theirs).for_each(|(ours, theirs)| assert!((ours - theirs).abs() < 1e-12));

    let mut damaged: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    damaged["biases"].as_array_mut().expect("a list").pop();
    let error = serde_json::from_value::<Discriminant>(damaged).expect_err("refused").to_string();
    assert!(error.contains("biases: 2 values were given, 3 are needed"), "{error}");
}

/// Three people; the third made every gesture only once.
fn cohort() -> Cohort {
    let mut cohort = Cohort::new(layout());
    for number in 1..=3 {
        let mut session = Session::new(90, 7 * u32::from(number));
        if number == 3 {
            session.blocks.fill(0);
        }
        let id = MemberId { data_set: "3DC".to_owned(), person: PersonId::Number(number) };
        cohort.add(id, &[session.training()], &session.training()).expect("a member");
    }
    cohort
}

#[test]
fn a_cohort_survives_a_file_and_leaves_out_whom_it_should() {
    let cohort = cohort();
    let read = Cohort::from_bytes(&cohort.to_bytes().expect("bytes")).expect("a cohort");
    assert_eq!(read.layout(), cohort.layout());
    assert_eq!(read.members().map(ToString::to_string).collect::<Vec<_>>(), ["3DC 1", "3DC 2", "3DC 3"]);
    let prior = |cohort: &Cohort, left_out: u16| {
        cohort.prior(|member| member.person != left_out).expect("a prior").expect("enough people")
    };
    let (ours, theirs) = (prior(&read, 2), prior(&cohort, 2));
    assert_eq!(ours.people(), ["3DC 1", "3DC 3"]);
    assert_eq!((ours.windows(), theirs.windows()), (180, 180));
    assert!(ours.population().is_none(), "one person with repetitions does not say how people differ");
    assert!(prior(&read, 3).population().is_some());
    for (read, written) in ours.covariance().iter().zip(theirs.covariance().iter()) {
        assert!((read - written).abs() <= 1e-6, "{read} is not {written}");
    }
    assert!(read.prior(|_| false).expect("nobody").is_none());
}

#[test]
fn a_damaged_cohort_is_refused() {
    let bytes = cohort().to_bytes().expect("bytes");
    let refused = |bytes: &[u8]| Cohort::from_bytes(bytes).expect_err("refused");
    assert!(matches!(refused(b""), PriorError::Header(_)));
    assert!(matches!(refused(b"\x89PNG\n"), PriorError::Header(_)));
    for cut in 0..bytes.len() {
        refused(&bytes[..cut]);
    }
    assert!(matches!(refused(&bytes[..bytes.len() - 1]), PriorError::Size { .. }));
    let mut flipped = bytes.clone();
    *flipped.last_mut().expect("bytes") ^= 1;
    assert!(matches!(refused(&flipped), PriorError::Checksum));

    let line = bytes.iter().position(|&byte| byte == b'\n').expect("a line");
    let changed = |from: &str, to: &str| {
        let header = String::from_utf8(bytes[..line].to_vec()).expect("text");
        assert!(header.contains(from), "{header}");
        [header.replace(from, to).as_bytes(), &bytes[line..]].concat()
    };
    let version = refused(&changed("\"version\":2", "\"version\":3,\"more\":0"));
    assert!(matches!(version, PriorError::Version { found: 3, expected: 2 }));
    assert!(matches!(refused(&changed("tendon-prior", "tendon-person")), PriorError::Format(_)));
    let channels = refused(&changed("\"channels\":2", "\"channels\":18446744073709551615"));
    assert!(matches!(channels, PriorError::Layout { field: "channels" }));
    assert!(matches!(refused(&changed("\"channels\":2", "\"channels\":3")), PriorError::Size { .. }));
    let repetitions = refused(&changed("\"repetitions\":12", "\"repetitions\":18446744073709551615"));
    assert!(matches!(repetitions, PriorError::Size { .. }));
}

#[test]
fn a_prior_for_other_features_is_refused_by_name() {
    let settings = MethodSettings { delays_ms: vec![0.0], ..MethodSettings::default() };
    let features = |settings: &MethodSettings, channels, rate_hz| {
        LaggedLogCovariance::new(settings, channels, rate_hz, 1.0).expect("valid")
    };
    let prior = prior();
    prior.check(&features(&settings, 2, 1259.0)).expect("it fits");
    let refused = |features| prior.check(&features).expect_err("refused");
    assert!(matches!(
        refused(features(&settings, 3, 2000.0)),
        PriorError::Channels { prior: 2, features: 3 }
    ));
    assert!(matches!(refused(features(&MethodSettings::default(), 2, 2000.0)), PriorError::Delays { .. }));
    assert!(matches!(refused(features(&settings, 2, 4000.0)), PriorError::Rate { .. }));
    let pieces = MethodSettings { piece_ms: 50.0, ..settings.clone() };
    assert!(matches!(
        refused(features(&pieces, 2, 2000.0)),
        PriorError::Pieces { prior: 75.0, features: 50.0 }
    ));

    let mut other = Session::new(60, 1);
    other.features.truncate(60 * 2);
    let training = Training { feature_count: 2, ..other.training() };
    assert_eq!(
        Discriminant::fit(&training, Some(&prior), &settings).expect_err("refused"),
        FitError::Length { what: "features of the prior", given: 3, needed: 2 }
    );
    let few = WithinClassScatter::new(&Session::new(3, 1).training()).expect("a scatter");
    assert!(matches!(
        Prior::pool(layout(), [("other", &few)]),
        Err(PriorError::TooFewWindows { windows: 3, length: 3 })
    ));
}

#[test]
fn in_repetitions_that_differ_more_than_gestures_do_less_is_recognised() {
    let session = Session::new(60, 1);
    let training = session.training();
    let discriminant = Discriminant::fit(&training, None, &MethodSettings::default()).expect("a fit");
    let recognised = |spread: f64| {
        let mut cohort = Cohort::new(layout());
        for number in 1..=4 {
            let mut other = Session::new(90, 7 * u32::from(number));
            // Every repetition of these people is shifted, along the line on which the classes lie.
            let blocks = other.blocks.clone();
            for (window, block) in other.features.chunks_exact_mut(3).zip(blocks) {
                window[0] += spread * (block as f64 - 1.5) * if number % 2 == 0 { 1.0 } else { -1.0 };
            }
            let id = MemberId { data_set: String::new(), person: PersonId::Number(number) };
            cohort.add(id, &[other.training()], &other.training()).expect("a member");
        }
        let prior = cohort.prior(|_| true).expect("a prior").expect("enough people");
        let population = prior.population().expect("repetitions");
        let confusion = recognised_in_new_repetitions(&training, &discriminant, population).expect("scores");
        assert!(confusion.iter().all(|row| row.iter().sum::<usize>() == 20 * 50));
        (0..3).map(|class| confusion[class][class]).sum::<usize>() as f64 / 3000.0
    };
    let (alike, different) = (recognised(0.0), recognised(2.0));
    assert!(alike > 0.95 && different < 0.9, "{alike} {different}");
    assert_eq!(different, recognised(2.0), "the same every time");
}

#[test]
fn a_discriminant_follows_a_step_that_all_classes_take() {
    let session = Session::new(600, 3);
    let fitted = Discriminant::fit(&session.training(), None, &MethodSettings::default()).unwrap();
    let step = [2.0, -1.5, 0.7];
    let moved: Vec<f64> =
        session.features.iter().zip(step.iter().cycle()).map(|(x, step)| x + step).collect();
    let windows = || session.labels.iter().copied().zip(moved.chunks_exact(3));
    let followed = fitted.clone().moved_to(windows()).unwrap();
    let (mut before, mut after) = (vec![0.0; 3], vec![0.0; 3]);
    for (old, new) in session.features.chunks_exact(3).zip(moved.chunks_exact(3)) {
        fitted.posterior(old, &mut before).unwrap();
        followed.posterior(new, &mut after).unwrap();
        assert!(before.iter().zip(&after).all(|(before, after)| (before - after).abs() < 1e-9));
    }
    // Nothing moves if nothing has.
    let same = fitted.clone().moved_to(session.labels.iter().copied().zip(session.features.chunks_exact(3)));
    let mut again = vec![0.0; 3];
    same.unwrap().posterior(&session.features[..3], &mut again).unwrap();
    fitted.posterior(&session.features[..3], &mut before).unwrap();
    assert!(before.iter().zip(&again).all(|(before, again)| (before - again).abs() < 1e-9));
    // One class is enough to see the step of all.
    let rest = windows().filter(|(class, _)| *class == 0);
    fitted.clone().moved_to(rest).unwrap().posterior(&moved[3..6], &mut after).unwrap();
    assert!(after[1] > 0.9, "{after:?}");
    assert!(matches!(fitted.moved_to(std::iter::empty()), Err(FitError::TooFewClasses(0))));
}
