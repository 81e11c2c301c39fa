//! A recording through the whole pipeline of processes, as fast as it goes.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;
use tendon_config::{AcquisitionSettings, Config, Pace, Source};

use crate::emg::simulated;
use crate::{busy, session};

const RECORDING_S: f64 = 60.0;

/// How fast a recording went through.
#[derive(Debug, Serialize)]
pub struct Replay {
    recording_s: f64,
    /// Seconds of recording a second, from the first block to the end of the work on the last.
    x_real_time: f64,
    /// The same with every core saturated by other work.
    x_real_time_saturated: f64,
}

/// Replays a minute of simulated EMG through `tendon run`; `None` where the program has not been built.
pub fn measure(cores: usize) -> anyhow::Result<Option<Replay>> {
    let Some(program) = session::program()? else { return Ok(None) };
    let directory = tempfile::tempdir().context("cannot make a folder for a recording")?;
    let settings = prepare(directory.path(), RECORDING_S)?;
    let settings = settings.to_str().context("the temporary folder's name is not UTF-8")?;
    let idle = x_real_time(&program, settings)?;
    let busy = busy::saturate(cores)?;
    let saturated = x_real_time(&program, settings)?;
    drop(busy);
    println!("\nReplay at full speed, {RECORDING_S} s of recording");
    println!("  no load added         {idle:.0} times real time");
    println!("  every core saturated  {saturated:.0} times real time");
    Ok(Some(Replay { recording_s: RECORDING_S, x_real_time: idle, x_real_time_saturated: saturated }))
}

/// Writes `recording_s` seconds of simulated EMG into `directory`, and the settings for their replay at full speed.
pub fn prepare(directory: &Path, recording_s: f64) -> anyhow::Result<PathBuf> {
    let recording = directory.join("recording.csv");
    let settings = directory.join("tendon.toml");
    let mut config = Config { session: "bench-replay".parse()?, ..Config::default() };
    write_recording(&config, &recording, recording_s)?;
    config.acquisition.source = Source::Replay;
    let replay = &mut config.acquisition.replay;
    replay.path = Some(recording);
    replay.sample_rate_hz = Some(config.acquisition.sample_rate_hz);
    replay.pace = Pace::Full;
    std::fs::write(&settings, config.to_toml()).context("cannot write the settings of the replay")?;
    Ok(settings)
}

fn x_real_time(program: &PathBuf, settings: &str) -> anyhow::Result<f64> {
    session::run(program, &["--config", settings])?
        .replay_x_real_time
        .context("the report of `tendon run` lacks replay_x_real_time")
}

/// Writes a table of simulated EMG, one line a sample.
fn write_recording(config: &Config, path: &Path, recording_s: f64) -> anyhow::Result<()> {
    let AcquisitionSettings { channels, sample_rate_hz, .. } = config.acquisition;
    let (mut emg, mut performance) = simulated(channels)?;
    let mut text = String::new();
    let mut frame = vec![0.0_f32; channels];
    for _ in 0..(recording_s * sample_rate_hz) as usize {
        emg.fill_block(&mut performance, &mut frame);
        for (channel, sample) in frame.iter().enumerate() {
            let separator = if channel == 0 { "" } else { "," };
            write!(text, "{separator}{sample}").expect("a String grows as needed");
        }
        text.push('\n');
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
