//! A recording through the whole pipeline of processes, as fast as it goes.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde::Serialize;
use tendon_config::{AcquisitionSettings, Config, Pace, Source};
use tendon_latency::Report;
use tendon_recordings::Channel;

use crate::emg::simulated;

const RECORDING_S: f64 = 60.0;

/// How fast a recording went through.
#[derive(Debug, Serialize)]
pub struct Replay {
    recording_s: f64,
    /// Seconds of recording a second, from the first block to the end of the work on the last.
    x_real_time: f64,
}

/// Replays a minute of simulated EMG through `tendon run`; `None` where the program has not been built.
pub fn measure() -> anyhow::Result<Option<Replay>> {
    let program =
        std::env::current_exe().context("cannot find this program's file")?.with_file_name("tendon");
    if !program.exists() {
        println!("\nReplay is left out: {} has not been built", program.display());
        return Ok(None);
    }
    let directory = tempfile::tempdir().context("cannot make a folder for a recording")?;
    let recording = directory.path().join("recording.csv");
    let settings = directory.path().join("tendon.toml");
    let report = directory.path().join("report.json");

    let mut config = Config { session: "bench-replay".parse()?, ..Config::default() };
    write_recording(&config, &recording)?;
    config.acquisition.source = Source::Replay;
    let replay = &mut config.acquisition.replay;
    replay.path = Some(recording);
    replay.channels = (0..config.acquisition.channels).map(Channel::Index).collect();
    replay.sample_rate_hz = Some(config.acquisition.sample_rate_hz);
    replay.pace = Pace::Full;
    std::fs::write(&settings, config.to_toml()).context("cannot write the settings of the replay")?;

    let output = Command::new(&program)
        .arg("run")
        .arg("--config")
        .arg(&settings)
        .arg("--json")
        .arg(&report)
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("cannot start {}", program.display()))?;
    if !output.status.success() {
        bail!("`tendon run` failed ({}): {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    let text = std::fs::read_to_string(&report).context("`tendon run` wrote no report")?;
    let report: Report = serde_json::from_str(&text).context("the report of `tendon run`")?;
    let x_real_time =
        report.replay_x_real_time.context("the report of `tendon run` lacks replay_x_real_time")?;
    println!("\nReplay at full speed: {x_real_time:.0} times real time ({RECORDING_S} s of recording)");
    Ok(Some(Replay { recording_s: RECORDING_S, x_real_time }))
}

/// Writes a table of simulated EMG, one line a sample.
fn write_recording(config: &Config, path: &Path) -> anyhow::Result<()> {
    let AcquisitionSettings { channels, sample_rate_hz, .. } = config.acquisition;
    let (mut emg, mut performance) = simulated(channels)?;
    let mut text = String::new();
    let mut frame = vec![0.0_f32; channels];
    for _ in 0..(RECORDING_S * sample_rate_hz) as usize {
        emg.fill_block(&mut performance, &mut frame);
        for (channel, sample) in frame.iter().enumerate() {
            let separator = if channel == 0 { "" } else { "," };
            write!(text, "{separator}{sample}").expect("a String grows as needed");
        }
        text.push('\n');
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
