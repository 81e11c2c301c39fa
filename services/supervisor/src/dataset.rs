//! `tendon dataset build`: recordings to windows that models are trained on.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use clap::{Args, Subcommand};
use tendon_config::Config;
use tendon_dataset::{BuildSettings, DatasetSettings, Manifest, OnsetStatistics, SplitEntry, check_place};
use tendon_identity::{PersonId, list_of};
use tendon_output::OutputFolder;
use tendon_provenance::Provenance;
use tendon_signal::{OnsetMethod, OnsetSettings, WindowInput, WindowSettings};

use crate::Failure;
use crate::channels::channels_or_default;
use crate::configuration::{Base, WINDOW_KEYS};
use crate::output::{counted, print, summed_up, tell};
use crate::progress::Progress;
use crate::provenance::PROGRAM;
use crate::recording_options::RecordingOptions;

/// Commands of `tendon dataset`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Cut recordings into windows to train on, with the filter that runs live.
    ///
    /// The layout follows from what is found in each FOLDER or below it:
    ///
    /// * 3DC: folders ParticipantP/train/EMG and ParticipantP/test/EMG with files 3dc_EMG_gesture_R_G.txt, 1000 Hz.
    ///
    /// * Ozdemir 2022: files .mat, one a person (variables data, fs, iD), or files
    ///   `P<person>_C<cycle>_G<gesture>.csv`, one a trial; 2000 Hz. Files in a folder `filtered` need --filtered.
    ///
    /// * Your own: files .edf, .bdf, .xdf or .xdfz whose annotations or markers name gestures; of the person that sub-PERSON_….edf or
    ///   the folder names.
    ///
    /// * Your own: tables (.csv, .tsv, .txt; one line per sample, one column per channel) and a labels.csv in the same
    ///   folder with the header file,person,session,repetition,gesture,start_sample,end_sample. Needs
    ///   --recording-rate-hz. The session is optional, and so are start and end where the whole file is one trial.
    ///   Gestures have any names of a-z, 0-9, - and _; rest is `rest`.
    ///
    /// Filter, windows and rate are those of the session: dsp.filter, dsp.windows and acquisition.sample_rate_hz of
    /// ./tendon.toml, --config and --set. With 50 Hz mains, for instance, --set dsp.filter.notch_hz=50.
    ///
    /// Recordings that cannot be used are left out; manifest.json lists them with the reason. After an interruption, the
    /// same command continues the build, which lies beside FOLDER with the ending .unfinished.
    #[command(verbatim_doc_comment)]
    Build(BuildOptions),
}

/// Command line of `tendon dataset build`.
#[derive(Debug, Args)]
pub struct BuildOptions {
    /// Folders with recordings of one layout, or folders above them; single .mat and .csv files, too.
    #[arg(required = true, value_name = "FOLDER")]
    recordings: Vec<PathBuf>,
    /// Folder for the data set: windows.npy, the arrays with each window's label and origin, and manifest.json. What stands
    /// there stays until the new one is complete.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Replace a finished data set that stands there.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    recording: RecordingOptions,
    #[command(flatten)]
    base: Base,
    /// Sampling rate of the windows, Hz; by default acquisition.sample_rate_hz of the configuration.
    #[arg(long, value_name = "HZ")]
    sample_rate_hz: Option<f64>,
    /// Length of a window, in samples; by default dsp.windows.window_samples.
    #[arg(long, value_name = "N")]
    window_samples: Option<usize>,
    /// Samples from the start of one window to the start of the next; by default dsp.windows.increment_samples. A
    /// quarter of the window means 75 % overlap.
    #[arg(long, value_name = "N")]
    increment_samples: Option<usize>,
    /// What windows hold.
    #[arg(long, value_enum, default_value = "raw")]
    input: WindowInput,
    /// The recordings are filtered already.
    #[arg(long)]
    filtered: bool,
    /// How the threshold for the onset of a movement is chosen.
    #[arg(long, value_enum, default_value = "baseline")]
    onset: OnsetMethod,
    /// With --onset peak-percentile: the percentile of the envelope's peaks that serves as the threshold [default: 80].
    #[arg(long, value_name = "PERCENT")]
    peak_percentile: Option<f64>,
    /// Assumed start of the movement if no onset is found, ms after the cue; 0 keeps the whole recording.
    #[arg(long, default_value_t = 500.0)]
    fallback_ms: f64,
    /// People to hold out for the test, by number or name: all their windows are for the test, and nobody else's. 3DC's 13 and
    /// 14 share recordings and must stay together.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    test_people: Vec<PersonId>,
    /// Sessions to hold out for the test, such as test of 3DC: all their windows are for the test. The model then knows the
    /// people, and its score says how well it does in another session of the same people.
    #[arg(long, value_name = "SESSION,…", value_delimiter = ',')]
    test_sessions: Vec<String>,
    /// Repetitions of each person to hold out for the test, counted from 0 through all of the person's sessions: all their
    /// windows are for the test. The model then knows the people.
    #[arg(long, value_name = "N,…", value_delimiter = ',')]
    test_repetitions: Vec<u8>,
    /// Seed for choosing the validation windows: 20 % of each gesture's windows that are not for the test.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Recordings to read at the same time [default: one per processor, up to 8]. The data set does not depend on it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl BuildOptions {
    /// How windows are cut: by the filter, the windows and the rate of the configuration that `tendon run` would read
    /// here, unless an option says otherwise.
    fn settings(&self) -> anyhow::Result<DatasetSettings> {
        ensure!(
            !(self.filtered && self.base.sets("dsp.filter")),
            "--filtered leaves the filter out, so --set dsp.filter… has no effect: leave one of the two out"
        );
        ensure!(
            self.peak_percentile.is_none() || self.onset == OnsetMethod::PeakPercentile,
            "--peak-percentile is for --onset peak-percentile: add that, or leave --peak-percentile out"
        );
        let Config { acquisition, dsp, .. } =
            self.base.configuration_of("tendon dataset build", &WINDOW_KEYS)?;
        let default = DatasetSettings::default();
        let settings = DatasetSettings {
            sample_rate_hz: self.sample_rate_hz.unwrap_or(acquisition.sample_rate_hz),
            filter: (!self.filtered).then_some(dsp.filter),
            input: self.input,
            windows: WindowSettings {
                window_samples: self.window_samples.unwrap_or(dsp.windows.window_samples),
                increment_samples: self.increment_samples.unwrap_or(dsp.windows.increment_samples),
            },
            onset: OnsetSettings {
                method: self.onset,
                peak_percentile: self.peak_percentile.unwrap_or(default.onset.peak_percentile),
                ..default.onset
            },
            fallback_ms: self.fallback_ms,
            ..default
        };
        let settings = self.recording.settings(settings);
        let channels = channels_or_default(&self.recording.channels, &settings, &self.recordings)?;
        Ok(DatasetSettings { channels, ..settings })
    }
}

/// How far a build has come, for the person who waits.
#[derive(Debug, Default)]
pub struct BuildProgress {
    progress: Option<Progress>,
    /// Windows that an earlier build had made.
    resumed_windows: u64,
}

impl BuildProgress {
    /// Shows the next step.
    pub fn show(&mut self, step: &tendon_dataset::Progress<'_>) {
        match *step {
            tendon_dataset::Progress::Begun { total, resumed, windows, is_other } => {
                self.resumed_windows = windows;
                if is_other {
                    tell(
                        "the folder holds an unfinished build with other settings or recordings: starting anew",
                    );
                }
                if resumed > 0 {
                    tell(format_args!("continuing after {resumed} of {total} recordings, {windows} windows"));
                }
                self.progress.insert(Progress::of(total, "recordings")).go_on_from(resumed);
            }
            tendon_dataset::Progress::Recording { done, windows, .. } => {
                if let Some(progress) = &mut self.progress {
                    progress.show(done, || format!(", {windows} windows"));
                }
            }
        }
    }
}

/// What the data set is made from. Its settings stand in the manifest itself.
fn provenance(options: &BuildOptions) -> anyhow::Result<Provenance> {
    let configuration = serde_json::json!({
        "test_people": options.test_people,
        "test_sessions": options.test_sessions,
        "test_repetitions": options.test_repetitions,
        "seed": options.seed,
    });
    let begun = Provenance::begin(PROGRAM).with_configuration(&configuration)?;
    Ok(begun.with_recording(&options.recordings)?)
}

/// Builds a data set.
pub fn build(options: &BuildOptions) -> Result<(), Failure> {
    let start = Instant::now();
    let default = BuildSettings::default();
    let settings = options.settings().map_err(Failure::input)?;
    // Before everything is read for its hash: what cannot be used is refused at once.
    let found = tendon_dataset::list(&settings, &options.recordings).map_err(Failure::input)?;
    let unit = options.recording.unit_of(&found.unit).map_err(Failure::input)?;
    OutputFolder::check(&options.out).map_err(Failure::input)?;
    check_place(&options.out, options.force).map_err(Failure::input)?;
    let building = BuildSettings {
        test_people: options.test_people.clone(),
        test_sessions: options.test_sessions.clone(),
        test_repetitions: options.test_repetitions.clone(),
        seed: options.seed,
        threads: options.threads.map_or(default.threads, usize::from),
        replaces: options.force,
        unit,
        provenance: provenance(options).map_err(Failure::input)?,
    };
    let mut progress = BuildProgress::default();
    let mut show = |step: tendon_dataset::Progress<'_>| {
        progress.show(&step);
        ControlFlow::Continue(())
    };
    let built = tendon_dataset::build(&settings, &building, &options.recordings, &options.out, &mut show);
    let BuildProgress { progress, resumed_windows } = progress;
    drop(progress);
    let manifest = built.context("no data set was built").map_err(Failure::input)?;
    // After a build that continued an earlier one, nobody knows how long the first part took.
    let duration = (resumed_windows == 0).then(|| start.elapsed());
    print(text(options, &manifest, duration)).map_err(Failure::running)
}

fn text(options: &BuildOptions, manifest: &Manifest, duration: Option<Duration>) -> String {
    let mut text = format!(
        "{}: {} windows of {}, {}\n",
        options.out.display(),
        manifest.windows,
        counted(manifest.windows_per_person.len(), "person", "people"),
        counted(manifest.recordings.len(), "recording", "recordings"),
    );
    if !manifest.skipped.is_empty() {
        let skipped: Vec<_> = manifest.skipped.iter().map(|skipped| (skipped.kind, skipped)).collect();
        text += &format!("{}\n", summed_up(&skipped, "manifest.json lists all of it"));
    }
    text += &format!(
        "\n{:<12}{:>9}{:>12}{:>22}{:>34}\n",
        "gesture", "windows", "recordings", "no onset found", "onset, ms"
    );
    for (gesture, windows) in &manifest.windows_per_gesture {
        let onsets = manifest.onsets.get(gesture).filter(|onsets| onsets.recordings > 0);
        text += &format!("{gesture:<12}{windows:>9}{}\n", onsets.map_or(String::new(), columns));
    }
    if let Some(total) = manifest.onsets.get("total") {
        text += &format!("{:<12}{:>9}{}\n", "total", manifest.windows, columns(total));
    }
    let SplitEntry { test_people, test_sessions, test_repetitions, held_out, seed, windows: split, .. } =
        &manifest.split;
    text +=
        &format!("\n{} windows to train on, {} for validation (seed {seed})", split.train, split.validation);
    text += &match (test_people.as_slice(), test_sessions.len() + test_repetitions.len()) {
        ([], 0) => "; nobody is held out: --test-people chooses whom to test on".to_owned(),
        (people, 0) => format!(", {} for the test: all of {}", split.test, list_of(people)),
        _ => format!(", {} for the test: {held_out}", split.test),
    };
    if let Some(duration) = duration {
        let signal_s: f64 =
            manifest.recordings.iter().map(|entry| entry.samples as f64 / entry.sample_rate_hz).sum();
        let duration_s = duration.as_secs_f64();
        text += &format!(
            "\n{signal_s:.0} s of signal in {duration_s:.1} s: {:.0} times faster than real time",
            signal_s / duration_s
        );
    }
    text
}

/// How onsets were found, as columns of the table.
fn columns(onsets: &OnsetStatistics) -> String {
    let OnsetStatistics { recordings, fallbacks, fallback_percent, mean_ms, sd_ms, min_ms, max_ms } = onsets;
    let fallbacks = format!("{fallbacks} ({fallback_percent:.1} %)");
    let onset = format!("mean {mean_ms:.1}, sd {sd_ms:.1}, {min_ms:.0} to {max_ms:.0}");
    format!("{recordings:>12}{fallbacks:>22}{onset:>34}")
}
