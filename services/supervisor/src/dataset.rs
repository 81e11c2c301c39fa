//! `tendon dataset build`: recordings to windows that models are trained on.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::{Args, Subcommand};
use tendon_dataset::{
    BuildSettings, DatasetSettings, Manifest, OnsetStatistics, Progress as BuildProgress, SplitEntry,
};
use tendon_recordings::Channel;
use tendon_signal::{OnsetMethod, OnsetSettings, WindowInput, WindowSettings};

use crate::Failure;
use crate::progress::Progress;

/// Commands of `tendon dataset`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Cut recordings into windows to train on, through the same filter as live.
    ///
    /// What lies at or below each FOLDER tells the layout:
    ///
    /// * 3DC: folders ParticipantP/train/EMG and ParticipantP/test/EMG with files 3dc_EMG_gesture_R_G.txt, 1000 Hz.
    ///
    /// * Ozdemir 2022: files .mat, one a person (variables data, fs, iD; saved with `save -v7`), or files
    ///   `P<person>_C<cycle>_G<gesture>.csv`, one a trial; 2000 Hz. Those in a folder `filtered` need --filtered.
    ///
    /// * Your own: tables (.csv, .tsv, .txt; a line a sample, a column a channel) and beside them labels.csv with the
    ///   header file,person,session,repetition,gesture,start_sample,end_sample. Give --recording-rate-hz. Session may
    ///   be left out, and start and end where the whole file is one trial. Gestures: rest, extension, flexion, ulnar,
    ///   radial, grip.
    ///
    /// What cannot be used is left out and listed in manifest.json with the reason. A build that was interrupted goes
    /// on when the same command is given again.
    #[command(verbatim_doc_comment)]
    Build(BuildOptions),
}

/// Command line of `tendon dataset build`.
#[derive(Debug, Args)]
pub struct BuildOptions {
    /// Folders with recordings of one layout, or folders above such; also single .mat and .csv files.
    #[arg(required = true, value_name = "FOLDER")]
    recordings: Vec<PathBuf>,
    /// Folder for the arrays (windows.npy and what belongs to each window) and manifest.json.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Channels, in this order.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// Sampling rate of recordings that do not tell it, Hz: needed with labels.csv.
    #[arg(long, value_name = "HZ")]
    recording_rate_hz: Option<f64>,
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
    input: WindowInput,
    /// The recordings are filtered already.
    #[arg(long)]
    filtered: bool,
    /// Where the threshold comes from above which a movement begins.
    #[arg(long, value_enum, default_value = "baseline")]
    onset: OnsetMethod,
    /// With --onset peak-percentile: which percentile of the envelope's peaks is the threshold.
    #[arg(long, default_value_t = 80.0, value_name = "PERCENT")]
    peak_percentile: f64,
    /// Where a movement is taken to begin if no onset is found, ms from the cue; 0 keeps the whole recording.
    #[arg(long, default_value_t = 500.0)]
    fallback_ms: f64,
    /// People held out for the test, by number: all of their windows, and nobody else's. 3DC's 13 and 14 only
    /// together.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    test_people: Vec<u16>,
    /// Seed of the choice of windows for validation: 20 % of those of each gesture that are not for the test.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Recordings read at a time [default: one a processor, up to 8]. The data set does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl BuildOptions {
    fn settings(&self) -> DatasetSettings {
        let default = DatasetSettings::default();
        DatasetSettings {
            channels: self.channels.iter().copied().map(Channel::Index).collect(),
            recording_rate_hz: self.recording_rate_hz,
            sample_rate_hz: self.sample_rate_hz,
            filter: default.filter.filter(|_| !self.filtered),
            input: self.input,
            windows: WindowSettings {
                window_samples: self.window_samples,
                increment_samples: self.increment_samples,
            },
            onset: OnsetSettings {
                method: self.onset,
                peak_percentile: self.peak_percentile,
                ..default.onset
            },
            fallback_ms: self.fallback_ms,
            rest_start_ms: default.rest_start_ms,
        }
    }
}

/// Builds a data set and shows how far it has come; beside the manifest, how many windows an earlier build had made.
///
/// # Errors
///
/// As [`tendon_dataset::build`].
pub fn build_shown(
    settings: &DatasetSettings,
    building: &BuildSettings,
    recordings: &[PathBuf],
    out: &Path,
) -> Result<(Manifest, u64), Failure> {
    let mut progress = None;
    let mut resumed_windows = 0;
    let mut show = |build: BuildProgress<'_>| {
        match build {
            BuildProgress::Begun { total, resumed, windows, is_other } => {
                resumed_windows = windows;
                tell_beginning(total, resumed, windows, is_other);
                progress.insert(Progress::of(total, "recordings")).go_on_from(resumed);
            }
            BuildProgress::Recording { done, windows, .. } => {
                if let Some(progress) = &mut progress {
                    progress.show(done, || format!(", {windows} windows"));
                }
            }
        }
        ControlFlow::Continue(())
    };
    let built = tendon_dataset::build(settings, building, recordings, out, &mut show);
    drop(progress);
    Ok((built.context("no data set was built").map_err(Failure::input)?, resumed_windows))
}

#[allow(clippy::print_stderr, reason = "for the person who waits")]
fn tell_beginning(total: usize, resumed: usize, windows: u64, is_other: bool) {
    if is_other {
        eprintln!("an unfinished build of other settings or recordings is there: building anew");
    }
    if resumed > 0 {
        eprintln!("{resumed} of {total} recordings are there already, {windows} windows: going on");
    }
}

/// Builds a data set.
pub fn build(options: &BuildOptions) -> Result<(), Failure> {
    let start = Instant::now();
    let default = BuildSettings::default();
    let building = BuildSettings {
        test_people: options.test_people.clone(),
        seed: options.seed,
        threads: options.threads.map_or(default.threads, usize::from),
    };
    let (manifest, resumed_windows) =
        build_shown(&options.settings(), &building, &options.recordings, &options.out)?;
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
    let SplitEntry { test_people, seed, windows: split, .. } = &manifest.split;
    print!("\n{} windows to train on, {} for validation (seed {seed})", split.train, split.validation);
    match test_people.as_slice() {
        [] => println!("; nobody is held out: --test-people chooses whom to test on"),
        people => println!(", {} for the test: all of {}", split.test, list_of(people)),
    }
    let signal_s: f64 =
        manifest.recordings.iter().map(|entry| entry.samples as f64 / entry.sample_rate_hz).sum();
    let duration_s = start.elapsed().as_secs_f64();
    // Of a build that went on, nobody knows how long the first part took.
    if resumed_windows == 0 {
        println!(
            "{signal_s:.0} s of signal in {duration_s:.1} s: {:.0} times faster than real time",
            signal_s / duration_s
        );
    }
    Ok(())
}

/// How onsets were found, as columns of the table.
fn columns(onsets: &OnsetStatistics) -> String {
    let OnsetStatistics { recordings, fallbacks, fallback_percent, mean_ms, sd_ms, min_ms, max_ms } = onsets;
    let fallbacks = format!("{fallbacks} ({fallback_percent:.1} %)");
    let onset = format!("mean {mean_ms:.1}, sd {sd_ms:.1}, {min_ms:.0} to {max_ms:.0}");
    format!("{recordings:>12}{fallbacks:>22}{onset:>34}")
}

fn list_of(people: &[u16]) -> String {
    people.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
