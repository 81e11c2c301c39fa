//! `tendon-lsl-emulator`: an amplifier on the Lab Streaming Layer that needs no hardware. A simulated person makes gestures;
//! on request samples are lost, and what was lost is said at the end.
//!
//! ```text
//! simulated amplifier ─ chunks, each when its newest sample is due, stamped by count ─▶ Outlet
//! ```
#![forbid(unsafe_code)]
#![allow(clippy::print_stdout, reason = "what it did is for people and tests")]

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, ensure};
use clap::Parser;
use signal_hook::consts::{SIGINT, SIGTERM};
use tendon_emg_simulation::{
    ContractionSettings, Performance, Profile, Repeat, Script, SimulatedEmg, SimulationSettings,
};
use tendon_lsl::{ChannelFacts, Lsl, Outlet, StreamDescription};

/// Channels of the simulated muscles; further ones repeat them.
const MUSCLES: usize = 4;
/// Gestures before the sequence begins anew.
const GESTURES: usize = 1000;

/// An amplifier on the Lab Streaming Layer that needs no hardware: a simulated person makes gestures until it is stopped.
#[derive(Debug, Parser)]
#[command(version, name = "tendon-lsl-emulator")]
struct Arguments {
    /// Name of the stream.
    #[arg(long, default_value = "Tendon emulator")]
    name: String,
    /// Source id of the stream.
    #[arg(long, default_value = "tendon-lsl-emulator")]
    source_id: String,
    /// Channels; the unit is ADC counts, as of the models that come with Tendon.
    #[arg(long, default_value_t = 4)]
    channels: usize,
    /// Sampling rate, Hz.
    #[arg(long, default_value_t = 2000.0)]
    rate_hz: f64,
    /// Samples of each channel in a chunk; by default those of a block.
    #[arg(long, default_value_t = 10)]
    chunk: usize,
    /// Gestures, such as "rest 6s, grip 2s", repeated; by default random ones.
    #[arg(long)]
    script: Option<Script>,
    /// Lose so many samples in every second.
    #[arg(long, default_value_t = 0)]
    lose: usize,
    /// End by itself after so many seconds.
    #[arg(long)]
    duration_s: Option<f64>,
    /// liblsl; by default LSL_LIBRARY, then what scripts/fetch-libraries fetched.
    #[arg(long)]
    library: Option<PathBuf>,
}

fn main() -> ExitCode {
    match emulate(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tendon-lsl-emulator: error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn emulate(arguments: &Arguments) -> anyhow::Result<()> {
    let Arguments { channels, rate_hz, chunk, lose, .. } = *arguments;
    ensure!((1..=1024).contains(&channels), "--channels {channels}: take 1 to 1024");
    ensure!((10.0..=100_000.0).contains(&rate_hz), "--rate-hz {rate_hz}: take 10 to 100000");
    ensure!((1..=4096).contains(&chunk), "--chunk {chunk}: take 1 to 4096");
    let lsl = Lsl::load(&tendon_lsl::find_library(arguments.library.as_deref())?)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot handle signals")?;
    }
    let muscles = channels.min(MUSCLES);
    let simulation =
        SimulationSettings { channels: muscles, sample_rate_hz: rate_hz, ..SimulationSettings::default() };
    let mut emg = SimulatedEmg::new(&Profile::default(), &simulation)?;
    let script = match &arguments.script {
        Some(script) => script.clone(),
        None => Script::random(emg.gestures(), 0, GESTURES),
    };
    script.check(emg.gestures()).context("--script")?;
    let contraction = ContractionSettings::default();
    let mut person = Performance::of_script(emg.gestures(), script, Repeat::Forever, contraction, rate_hz);
    let mut outlet = Outlet::new(lsl, &description(arguments))?;
    println!("streaming \"{}\": {channels} channels at {rate_hz} Hz, ADC counts", arguments.name);

    let began_s = lsl.clock_s();
    let (mut sample, mut sent, mut lost) = (0_usize, 0_usize, 0_usize);
    let mut next_loss = rate_hz;
    let mut block = vec![0.0; muscles * chunk];
    let mut instants = vec![0.0; channels * chunk];
    let is_over =
        |sample: usize| arguments.duration_s.is_some_and(|duration_s| sample as f64 >= duration_s * rate_hz);
    while !stop.load(Ordering::Relaxed) && !is_over(sample) {
        emg.fill_block(&mut person, &mut block);
        for (instant, values) in instants.chunks_exact_mut(channels).enumerate() {
            for (channel, value) in values.iter_mut().enumerate() {
                *value = block[channel % muscles * chunk + instant];
            }
        }
        sample += chunk;
        let newest_s = began_s + (sample - 1) as f64 / rate_hz;
        let wait_s = (newest_s - lsl.clock_s()).max(0.0);
        std::thread::sleep(Duration::from_secs_f64(wait_s));
        outlet.push(&instants, newest_s);
        sent += chunk;
        if lose > 0 && sample as f64 >= next_loss {
            next_loss += rate_hz;
            // Made and never sent, between two chunks.
            sample += lose;
            lost += lose;
        }
    }
    println!("sent {sent} lost {lost}");
    Ok(())
}

fn description(arguments: &Arguments) -> StreamDescription {
    let channel = |number: usize| ChannelFacts {
        label: format!("EMG {number}"),
        unit: "ADC counts".to_owned(),
        content_type: "EMG".to_owned(),
    };
    StreamDescription {
        name: arguments.name.clone(),
        content_type: "EMG".to_owned(),
        source_id: arguments.source_id.clone(),
        sample_rate_hz: arguments.rate_hz,
        channels: (1..=arguments.channels).map(channel).collect(),
    }
}
