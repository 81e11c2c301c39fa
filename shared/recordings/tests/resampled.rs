//! Resampling at a rate that is no whole number, beside SciPy's.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::fmt::Write;

use serde::Deserialize;
use tendon_recordings::{Channel, RecordingSettings, ReplayStream};

/// Largest error over the signal. SciPy's own low-pass comes to -61 dB.
const TOLERANCE_DB: f64 = -80.0;

/// What `golden/make_resampled.py` writes.
#[derive(Deserialize)]
struct Golden {
    rate_hz: f64,
    edge: usize,
    input: Vec<f64>,
    expected: Vec<f64>,
}

#[test]
fn noise_at_1925_926_hz_comes_out_as_by_scipy_with_a_long_low_pass() {
    let golden: Golden = serde_json::from_str(include_str!("golden/resampled.json")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("emg.csv");
    let mut text = String::new();
    golden.input.iter().for_each(|sample| writeln!(text, "{sample}").unwrap());
    std::fs::write(&path, text).unwrap();
    let channels = vec![Channel::Index(0)];
    let settings =
        RecordingSettings { channels, sample_rate_hz: Some(golden.rate_hz), ..RecordingSettings::default() };
    let mut stream = ReplayStream::open(&path, &settings, 2000.0, 10).unwrap();
    let mut output = Vec::new();
    let mut block = [0.0; 10];
    while stream.next_block(&mut block).unwrap().is_some() {
        output.extend(block.map(f64::from));
    }
    let inner = golden.edge..golden.expected.len() - golden.edge;
    assert!(output.len() >= inner.end, "{} samples", output.len());
    let power = |samples: &mut dyn Iterator<Item = f64>| samples.map(|sample| sample * sample).sum::<f64>();
    let expected = &golden.expected[inner.clone()];
    let errors = output[inner].iter().zip(expected).map(|(sample, expected)| sample - expected);
    let ratio = power(&mut errors.into_iter()) / power(&mut expected.iter().copied());
    let error_db = 10.0 * ratio.log10();
    println!("error {error_db:.1} dB");
    assert!(error_db < TOLERANCE_DB, "{error_db} dB");
}
