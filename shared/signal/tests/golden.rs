//! Everything that has a reference in SciPy or NumPy against it: `golden/make_golden.py` made the vectors.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use tendon_signal::{
    ActivitySettings, Baseline, EmgFilter, Envelope, FilterSettings, Onset, OnsetMethod, OnsetSettings,
    Resampler, Section, butterworth_band_pass, butterworth_high_pass, find_onset, notch,
};

fn golden<T: DeserializeOwned>(name: &str) -> T {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).expect("the golden file")).expect("its format")
}

/// Section by section and coefficient by coefficient, to 1e-9 of the coefficient (of 1 where it is 0).
fn assert_same_sections(ours: &[Section], scipy: &[[f64; 6]], what: &str) {
    assert_eq!(ours.len(), scipy.len(), "{what}");
    for (ours, scipy) in ours.iter().zip(scipy) {
        let ours = [ours.b[0], ours.b[1], ours.b[2], 1.0, ours.a[0], ours.a[1]];
        for (ours, scipy) in ours.iter().zip(scipy) {
            let scale = if *scipy == 0.0 { 1.0 } else { scipy.abs() };
            assert!((ours - scipy).abs() <= 1e-9 * scale, "{what}: {ours} is not {scipy}");
        }
    }
}

/// To `tolerance` of the reference's peak.
fn assert_close(ours: &[f32], reference: &[f64], tolerance: f64, what: &str) {
    assert_eq!(ours.len(), reference.len(), "{what}");
    let peak = reference.iter().fold(0.0_f64, |peak, value| peak.max(value.abs()));
    assert!(peak > 0.0, "{what}: an empty reference");
    for (at, (&ours, reference)) in ours.iter().zip(reference).enumerate() {
        let error = (f64::from(ours) - reference).abs() / peak;
        assert!(
            error <= tolerance,
            "{what}: sample {at} is {ours}, not {reference}: off by {error:e} of the peak"
        );
    }
}

#[test]
fn sections_are_those_of_scipy() {
    #[derive(Deserialize)]
    struct Design {
        notches: Vec<Notch>,
        filters: Vec<Filter>,
    }
    #[derive(Deserialize)]
    struct Notch {
        sample_rate_hz: f64,
        frequency_hz: f64,
        quality: f64,
        sos: Vec<[f64; 6]>,
    }
    #[derive(Deserialize)]
    struct Filter {
        sample_rate_hz: f64,
        order: usize,
        low_hz: f64,
        high_hz: Option<f64>,
        sos: Vec<[f64; 6]>,
    }

    let design: Design = golden("design.json");
    assert_eq!((design.notches.len(), design.filters.len()), (8, 47));
    for Notch { sample_rate_hz, frequency_hz, quality, sos } in design.notches {
        let section = notch(frequency_hz, quality, sample_rate_hz).expect("a notch");
        assert_same_sections(&[section], &sos, &format!("notch {frequency_hz} Hz at {sample_rate_hz} Hz"));
    }
    for Filter { sample_rate_hz, order, low_hz, high_hz, sos } in design.filters {
        let sections = match high_hz {
            Some(high_hz) => butterworth_band_pass(order, low_hz, high_hz, sample_rate_hz),
            None => butterworth_high_pass(order, low_hz, sample_rate_hz),
        };
        let what = format!("order {order}, {low_hz} to {high_hz:?} Hz at {sample_rate_hz} Hz");
        assert_same_sections(&sections.expect("a filter"), &sos, &what);
    }
}

#[derive(Deserialize)]
struct Streaming {
    sample_rate_hz: f64,
    notch_hz: f64,
    input: Vec<f32>,
    filtered: Vec<f64>,
    envelope: Vec<f64>,
    median: f64,
    sigma: f64,
    threshold: f64,
}

#[derive(Deserialize)]
struct Cases<T> {
    cases: Vec<T>,
}

#[test]
fn streaming_in_ragged_blocks_is_sosfilt_and_numpy() {
    let Cases { cases } = golden::<Cases<Streaming>>("streaming.json");
    assert_eq!(cases.len(), 4);
    for case in cases {
        let what = format!("{} Hz", case.sample_rate_hz);
        let settings = FilterSettings { notch_hz: Some(case.notch_hz), ..FilterSettings::default() };
        let mut filter = EmgFilter::new(&settings, 2, case.sample_rate_hz).expect("a filter");
        let mut signal = case.input.clone();
        let mut rest = signal.as_mut_slice();
        for length in [1, 7, 0, 64, 65, 130, 10, 3].into_iter().cycle() {
            let (block, after) = rest.split_at_mut(length.min(rest.len()));
            assert_eq!(filter.process(1, block), 0);
            rest = after;
            if rest.is_empty() {
                break;
            }
        }
        assert_close(&signal, &case.filtered, 1e-5, &what);

        let mut envelope = Envelope::new(25.0, case.sample_rate_hz).expect("an envelope");
        let mut envelope: Vec<f32> = signal.iter().map(|&sample| envelope.push(sample)).collect();
        assert_close(&envelope, &case.envelope, 1e-5, &what);

        let baseline = Baseline::of(&mut envelope);
        let k = ActivitySettings::default().threshold_sigma as f32;
        assert_close(
            &[baseline.median, baseline.sigma, baseline.threshold(k)],
            &[case.median, case.sigma, case.threshold],
            1e-5,
            &what,
        );
    }
}

#[test]
fn onsets_are_those_of_numpy() {
    #[derive(Deserialize)]
    struct Case {
        sample_rate_hz: f64,
        channels: usize,
        signal: Vec<f32>,
        onset: Option<usize>,
        onset_by_peaks: Option<usize>,
    }
    let Cases { cases } = golden::<Cases<Case>>("onset.json");
    assert!(cases.iter().any(|case| case.onset.is_some()) && cases.iter().any(|case| case.onset.is_none()));
    for (number, case) in cases.iter().enumerate() {
        let margin = (0.05 * case.sample_rate_hz).round() as usize;
        let expected = |sample: Option<usize>| {
            sample.map(|sample| Onset { sample, start_sample: sample.saturating_sub(margin) })
        };
        let by_peaks = OnsetSettings { method: OnsetMethod::PeakPercentile, ..OnsetSettings::default() };
        for (settings, sample) in [(OnsetSettings::default(), case.onset), (by_peaks, case.onset_by_peaks)] {
            let onset = find_onset(&settings, &case.signal, case.channels, case.sample_rate_hz);
            assert_eq!(onset, Ok(expected(sample)), "case {number}, {:?}", settings.method);
        }
    }
}

#[test]
fn resampling_in_ragged_blocks_is_upfirdn() {
    #[derive(Deserialize)]
    struct Case {
        up: usize,
        down: usize,
        input: Vec<f32>,
        output: Vec<f64>,
    }
    let Cases { cases } = golden::<Cases<Case>>("resample.json");
    assert_eq!(cases.len(), 4);
    for Case { up, down, input, output } in cases {
        // Not in lowest terms: the resampler has to reduce it.
        let mut resampler = Resampler::new(3 * up, 3 * down, 1).expect("a resampler");
        let mut ours = Vec::new();
        for block in input.chunks(13) {
            let before = ours.len();
            resampler.process(block, &mut ours);
            assert!(ours.len() - before <= resampler.max_output_samples(block.len()));
        }
        assert_eq!(ours.len(), (input.len() * up).div_ceil(down));
        // upfirdn goes on with zeros until the last input has left the filter.
        assert_close(&ours, &output[..ours.len()], 1e-6, &format!("{up}/{down}"));
        let longest = up.max(down) as f64;
        assert_eq!(resampler.delay_samples(), 10.0 * longest / down as f64);
    }
}
