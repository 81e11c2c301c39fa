//! The stages' work alone, in this process, without transport: what a stage adds even on an ideal machine.
//!
//! The clock is read before and after each piece of work; the first row shows what that alone takes.

use std::convert::Infallible;
use std::hint::black_box;

use anyhow::Context;
use hdrhistogram::Histogram;
use serde::Serialize;
use tendon_arm::{STEP_NS, SimulatedArm, Twist};
use tendon_classifier::Recogniser;
use tendon_config::Config;
use tendon_features::{Class, Discriminant, LaggedLogCovariance, MethodSettings, Training};
use tendon_gesture::{Decider, Evidence, Gesture};
use tendon_messages::Stage;
use tendon_report::{LatencySummary, duration_histogram};
use tendon_signal::SignalChain;
use tendon_transport::now_ns;

use crate::busy;
use crate::emg::simulated;

/// Blocks of a minute at 200 Hz; other work is repeated as often, inference a tenth of it.
const REPETITIONS: usize = 12_000;

/// How long a piece of a stage's work takes.
#[derive(Debug, Serialize)]
pub struct Work {
    /// The stage; `None` for the clock.
    stage: Option<&'static str>,
    task: &'static str,
    /// Where it depends on them.
    channels: Option<usize>,
    /// Whether every core ran a busy loop beside.
    saturated: bool,
    #[serde(flatten)]
    work: LatencySummary,
}

/// Measures and prints the work of every stage.
pub fn measure(cores: usize) -> anyhow::Result<Vec<Work>> {
    let mut rows = measure_beside("no load added", false)?;
    let busy = busy::saturate(cores)?;
    rows.extend(measure_beside("every core saturated", true)?);
    drop(busy);
    Ok(rows)
}

fn measure_beside(load: &str, saturated: bool) -> anyhow::Result<Vec<Work>> {
    let mut rows = vec![clock()];
    for channels in [4, 64] {
        rows.extend(signal(channels)?);
    }
    rows.push(inference()?);
    for channels in [4, 8, 10, 64] {
        rows.extend(personal_inference(channels)?);
    }
    rows.push(decision()?);
    rows.push(arm()?);
    rows.iter_mut().for_each(|row| row.saturated = saturated);
    println!("\nWork alone, {load}");
    println!("  {:<12} {:<24} {:>8}  {}", "stage", "task", "channels", crate::COLUMNS);
    for Work { stage, task, channels, work, .. } in &rows {
        let channels = channels.map(|channels| channels.to_string()).unwrap_or_default();
        println!("  {:<12} {task:<24} {channels:>8}  {}", stage.unwrap_or(""), crate::columns(work));
    }
    Ok(rows)
}

/// Times the repetitions of one piece of work.
struct Stopwatch(Histogram<u64>);

impl Stopwatch {
    fn new() -> Stopwatch {
        Stopwatch(duration_histogram())
    }

    fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let start_ns = now_ns();
        let result = black_box(work());
        self.0.saturating_record(now_ns() - start_ns);
        result
    }

    fn work(self, stage: Stage, task: &'static str, channels: Option<usize>) -> Work {
        Work {
            stage: Some(stage.name()),
            task,
            channels,
            saturated: false,
            work: LatencySummary::of(&self.0),
        }
    }
}

fn clock() -> Work {
    let mut stopwatch = Stopwatch::new();
    (0..REPETITIONS).for_each(|_| stopwatch.time(|| ()));
    Work {
        stage: None,
        task: "reading the clock",
        channels: None,
        saturated: false,
        work: LatencySummary::of(&stopwatch.0),
    }
}

/// Simulates a minute of blocks and takes them through dsp.
fn signal(channels: usize) -> anyhow::Result<[Work; 3]> {
    let config = Config::default();
    let acquisition = &config.acquisition;
    let (mut emg, mut performance) = simulated(channels)?;
    let mut blocks = vec![vec![0.0_f32; channels * acquisition.block_samples]; REPETITIONS];
    let mut simulate = Stopwatch::new();
    for block in &mut blocks {
        simulate.time(|| emg.fill_block(&mut performance, block));
    }

    let mut chain = SignalChain::new(&config.dsp, channels, acquisition.sample_rate_hz)?;
    let mut window = vec![0.0; chain.window_len()];
    let mut process = Stopwatch::new();
    for block in &blocks {
        process.time(|| {
            chain.push_block(block, |chain, _, _| {
                chain.write_window(&mut window);
                Ok::<(), Infallible>(())
            })
        })?;
    }
    let mut write_window = Stopwatch::new();
    (0..REPETITIONS).for_each(|_| write_window.time(|| chain.write_window(black_box(&mut window))));

    let channels = Some(channels);
    Ok([
        simulate.work(Stage::Acquisition, "simulate a block", channels),
        process.work(Stage::Dsp, "process a block", channels),
        write_window.work(Stage::Dsp, "write a window", channels),
    ])
}

fn inference() -> anyhow::Result<Work> {
    let config = Config::default();
    let library = tendon_classifier::runtime_library(None)?;
    let mut recogniser = Recogniser::load(&library, &config.decision, None, None)?;
    let (mut emg, mut performance) = simulated(config.acquisition.channels)?;
    let mut window = vec![0.0; config.window_length()];
    let mut stopwatch = Stopwatch::new();
    for number in 0..REPETITIONS as u64 / 10 {
        emg.fill_block(&mut performance, &mut window);
        stopwatch.time(|| recogniser.recognise(black_box(&window), number, 0.0).map(drop))?;
    }
    Ok(stopwatch.work(Stage::Inference, "classify a window", Some(config.acquisition.channels)))
}

/// Fits a discriminant to windows with labels in turns, and takes the windows through it.
fn personal_inference(channels: usize) -> anyhow::Result<[Work; 3]> {
    const WINDOWS_PER_CLASS: usize = 20;
    let config = Config::default();
    let settings = MethodSettings::default();
    let (mut emg, mut performance) = simulated(channels)?;
    let window_length = config.window_length() / config.acquisition.channels * channels;
    let mut windows = vec![vec![0.0; window_length]; Gesture::PAPER.len() * WINDOWS_PER_CLASS];
    windows.iter_mut().for_each(|window| emg.fill_block(&mut performance, window));

    let mut covariance =
        LaggedLogCovariance::new(&settings, channels, config.acquisition.sample_rate_hz, 1.0)?;
    let feature_count = covariance.feature_count();
    let mut features = vec![0.0; windows.len() * feature_count];
    for (window, features) in windows.iter().zip(features.chunks_exact_mut(feature_count)) {
        covariance.compute(window, features)?;
    }
    let classes = Gesture::PAPER.map(|gesture| Class { name: gesture.name().to_owned(), weight: 1.0 });
    let labels: Vec<usize> = (0..windows.len()).map(|window| window % classes.len()).collect();
    let training = Training {
        classes: &classes,
        feature_count,
        features: &features,
        labels: &labels,
        increment_s: 0.075,
        blocks: &labels,
    };
    let discriminant = Discriminant::fit(&training, None, &settings)?;

    let (mut compute, mut posterior, mut distance) = (Stopwatch::new(), Stopwatch::new(), Stopwatch::new());
    let mut features = vec![0.0; feature_count];
    let mut whitened = vec![0.0; feature_count];
    let mut probabilities = [0.0; Gesture::PAPER.len()];
    for window in windows.iter().cycle().take(REPETITIONS / 10) {
        compute.time(|| covariance.compute(black_box(window), &mut features))?;
        posterior.time(|| discriminant.posterior(black_box(&features), &mut probabilities))?;
        distance.time(|| discriminant.distance(black_box(&features), &mut whitened))?;
    }
    let channels = Some(channels);
    Ok([
        compute.work(Stage::Inference, "features of a window", channels),
        posterior.work(Stage::Inference, "posterior of features", channels),
        distance.work(Stage::Inference, "distance of features", channels),
    ])
}

fn decision() -> anyhow::Result<Work> {
    let mut decider = Decider::new(&Config::default().decision)?;
    let mut stopwatch = Stopwatch::new();
    for repetition in 0..REPETITIONS {
        let mut probabilities = [0.04; Gesture::PAPER.len()];
        // A gesture holds for ten windows.
        probabilities[repetition / 10 % Gesture::PAPER.len()] = 0.8;
        let captured_ns = repetition as u64 * 75_000_000;
        let evidence = Evidence {
            probabilities: &probabilities,
            efforts: &[1.0; Gesture::PAPER.len()],
            novelty: 0.0,
            moving: true,
            intact: true,
            captured_ns,
        };
        stopwatch.time(|| decider.decide(black_box(&evidence)));
    }
    Ok(stopwatch.work(Stage::Decision, "decide upon a window", None))
}

fn arm() -> anyhow::Result<Work> {
    let mut arm = SimulatedArm::new(Config::default().robot.arm, 0)?;
    let mut stopwatch = Stopwatch::new();
    for repetition in 0..REPETITIONS {
        let seconds = repetition as u64 * STEP_NS / 1_000_000_000;
        // A second one way, a second back.
        let speed_mm_per_s = if seconds.is_multiple_of(2) { 50.0 } else { -50.0 };
        let twist = Twist { linear_mm_per_s: [0.0, speed_mm_per_s, 0.0], angular_rad_per_s: [0.0; 3] };
        let time_ns = (repetition as u64 + 1) * STEP_NS;
        stopwatch
            .time(|| arm.command(twist, time_ns).map(|()| arm.state()))
            .context("a finite twist was refused")?;
    }
    Ok(stopwatch.work(Stage::Robot, "command, step, state", None))
}
