//! `tendon dataset build`: recordings to windows that models are trained on.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use tendon_recordings::Channel;
use tendon_recordings::dataset::{DatasetSettings, OnsetStatistics, Progress};
use tendon_signal::{OnsetMethod, OnsetSettings, WindowInput, WindowSettings};

use crate::Failure;

/// Commands of `tendon dataset`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Cut recordings of the 3DC layout into windows, through the same filter as live.
    Build(BuildOptions),
}

/// Command line of `tendon dataset build`.
#[derive(Debug, Args)]
pub struct BuildOptions {
    /// Folders of the 3DC layout, …/ParticipantP/train/EMG, or folders above such.
    #[arg(required = true, value_name = "FOLDER")]
    recordings: Vec<PathBuf>,
    /// Folder for the arrays (windows.npy and what belongs to each window) and manifest.json.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Channels, in this order.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// Sampling rate of the windows, Hz.
    #[arg(long, default_value_t = 2000.0)]
    sample_rate_hz: f64,
    /// Length of a window, in samples.
    #[arg(long, default_value_t = 600)]
    window_samples: usize,
    /// Samples from the start of a window to that of the next: a quarter of the window is an overlap of 75 %.
    #[arg(long, default_value_t = 150)]
    increment_samples: usize,
    /// What windows hold.
    #[arg(long, value_enum, default_value = "raw")]
    input: Input,
    /// The recordings are filtered already.
    #[arg(long)]
    filtered: bool,
    /// Where the threshold comes from above which a movement begins.
    #[arg(long, value_enum, default_value = "baseline")]
    onset: Onset,
    /// With --onset peak-percentile: which percentile of the envelope's peaks is the threshold.
    #[arg(long, default_value_t = 80.0, value_name = "PERCENT")]
    peak_percentile: f64,
    /// Where a movement is taken to begin if no onset is found, ms from the cue; 0 keeps the whole recording.
    #[arg(long, default_value_t = 500.0)]
    fallback_ms: f64,
}

/// What windows hold.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Input {
    /// The filtered signal, as live.
    Raw,
    /// Its moving RMS over 25 ms.
    Envelope,
}

/// Where the threshold comes from.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Onset {
    /// Median and deviation of the first 500 ms: the paper's choice.
    Baseline,
    /// A percentile of the envelope's peaks.
    PeakPercentile,
}

impl BuildOptions {
    fn settings(&self) -> DatasetSettings {
        let default = DatasetSettings::default();
        DatasetSettings {
            channels: self.channels.iter().copied().map(Channel::Index).collect(),
            sample_rate_hz: self.sample_rate_hz,
            filter: default.filter.filter(|_| !self.filtered),
            input: match self.input {
                Input::Raw => WindowInput::Raw,
                Input::Envelope => WindowInput::Envelope,
            },
            windows: WindowSettings {
                window_samples: self.window_samples,
                increment_samples: self.increment_samples,
            },
            onset: OnsetSettings {
                method: match self.onset {
                    Onset::Baseline => OnsetMethod::Baseline,
                    Onset::PeakPercentile => OnsetMethod::PeakPercentile,
                },
                peak_percentile: self.peak_percentile,
                ..default.onset
            },
            fallback_ms: self.fallback_ms,
            rest_start_ms: default.rest_start_ms,
        }
    }
}

/// Builds a data set.
pub fn build(options: &BuildOptions) -> Result<(), Failure> {
    let start = Instant::now();
    let settings = options.settings();
    let mut show = |progress: Progress<'_>| show_progress(&progress);
    let manifest = tendon_recordings::dataset::build(&settings, &options.recordings, &options.out, &mut show)
        .context("no data set was built")
        .map_err(Failure::input)?;
    println!(
        "{}: {} windows of {} people, {} recordings; {} left out (manifest.json says why)",
        options.out.display(),
        manifest.windows,
        manifest.windows_per_person.len(),
        manifest.recordings.len(),
        manifest.skipped.len()
    );
    println!(
        "\n{:<12}{:>9}{:>12}{:>22}{:>34}",
        "gesture", "windows", "recordings", "no onset found", "onset, ms"
    );
    for (gesture, windows) in &manifest.windows_per_gesture {
        print!("{gesture:<12}{windows:>9}");
        match manifest.onsets.get(gesture).filter(|onsets| onsets.recordings > 0) {
            Some(onsets) => println!("{}", columns(onsets)),
            None => println!(),
        }
    }
    if let Some(total) = manifest.onsets.get("total") {
        println!("{:<12}{:>9}{}", "total", manifest.windows, columns(total));
    }
    let signal_s: f64 =
        manifest.recordings.iter().map(|entry| entry.samples as f64 / entry.sample_rate_hz).sum();
    let duration_s = start.elapsed().as_secs_f64();
    println!(
        "\n{signal_s:.0} s of signal in {duration_s:.1} s: {:.0} times faster than real time",
        signal_s / duration_s
    );
    Ok(())
}

/// How onsets were found, as columns of the table.
fn columns(onsets: &OnsetStatistics) -> String {
    let OnsetStatistics { recordings, fallbacks, fallback_percent, mean_ms, sd_ms, min_ms, max_ms } = onsets;
    let fallbacks = format!("{fallbacks} ({fallback_percent:.1} %)");
    let onset = format!("mean {mean_ms:.1}, sd {sd_ms:.1}, {min_ms:.0} to {max_ms:.0}");
    format!("{recordings:>12}{fallbacks:>22}{onset:>34}")
}

#[allow(clippy::print_stderr, reason = "progress is for the person who waits")]
fn show_progress(progress: &Progress<'_>) {
    eprintln!(
        "{}/{} recordings, {} windows: {}",
        progress.done,
        progress.total,
        progress.windows,
        progress.path.display()
    );
}
