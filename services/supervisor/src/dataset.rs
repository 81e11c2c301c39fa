//! `tendon dataset build`: recordings to windows that models are trained on.

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, Subcommand};
use tendon_recordings::Channel;
use tendon_recordings::dataset::{DatasetSettings, Progress};

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
    /// Folders of the 3DC layout: …/ParticipantP/train/EMG.
    #[arg(required = true, value_name = "FOLDER")]
    recordings: Vec<PathBuf>,
    /// Folder for windows.npy, labels.npy, people.npy, repetitions.npy and manifest.json.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Channels, in this order.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// Sampling rate of the windows, Hz.
    #[arg(long, default_value_t = 2000.0)]
    sample_rate_hz: f64,
}

/// Builds a data set.
pub fn build(options: &BuildOptions) -> Result<(), Failure> {
    let settings = DatasetSettings {
        channels: options.channels.iter().copied().map(Channel::Index).collect(),
        sample_rate_hz: options.sample_rate_hz,
        ..DatasetSettings::default()
    };
    let mut show = |progress: Progress<'_>| show_progress(&progress);
    let manifest = tendon_recordings::dataset::build(&settings, &options.recordings, &options.out, &mut show)
        .context("no data set was built")
        .map_err(Failure::input)?;
    println!(
        "{}: {} windows of {} people; {} onsets not found, {} files left out (manifest.json says why)",
        options.out.display(),
        manifest.windows,
        manifest.windows_per_person.len(),
        manifest.fallbacks,
        manifest.skipped.len()
    );
    for (gesture, windows) in &manifest.windows_per_gesture {
        println!("  {gesture:<10}{windows:>8}");
    }
    Ok(())
}

#[allow(clippy::print_stderr, reason = "progress is for the person who waits")]
fn show_progress(progress: &Progress<'_>) {
    eprintln!(
        "{}/{} recordings, {} windows: {}",
        progress.done,
        progress.total,
        progress.windows,
        progress.folder.display()
    );
}
