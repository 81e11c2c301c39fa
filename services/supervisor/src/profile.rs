//! `tendon profile fit`: a profile of the simulated amplifier from real recordings.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::{Args, Subcommand};
use tendon_dataset::{DatasetSettings, list};
use tendon_emg_simulation::{FitSettings, Profile, Segment, fit as fit_profile};
use tendon_gesture::Gesture;
use tendon_identity::{PersonId, list_of};
use tendon_output::{check_distinct, collect};
use tendon_recordings::{Frame, RecordingSettings, RecordingSource, three_dc};

use crate::Failure;
use crate::channels::{channels_or_default, of_three_dc};
use crate::output::{checked, counted, print, tell};
use crate::recording_options::RecordingOptions;

/// Commands of `tendon profile`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fit a profile from one person's recordings, for acquisition.simulate.profile.
    Fit(FitOptions),
}

/// Command line of `tendon profile fit`.
#[derive(Debug, Args)]
pub struct FitOptions {
    /// Recordings with cues, in any layout that `tendon evaluate` reads; or single files of a 3DC folder.
    #[arg(required = true, value_name = "PATH")]
    recordings: Vec<PathBuf>,
    /// Where to write the profile.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    recording: RecordingOptions,
    /// Where the recordings come from, as a note in the profile.
    #[arg(long, default_value = "fitted from recordings")]
    source: String,
    /// Mains frequency where the recordings were made, in Hz: 50 or 60.
    #[arg(long, default_value_t = 60.0)]
    mains_hz: f64,
    /// Seconds to skip at the start of every gesture, before the person reacts to the cue.
    #[arg(long, default_value_t = 1.5)]
    skip_s: f64,
}

/// Fits and writes a profile.
pub fn fit(options: &FitOptions) -> Result<(), Failure> {
    refuse_other_file(&options.out).map_err(Failure::input)?;
    let out = checked(Some(&options.out))?;
    let inputs = options.recordings.iter().map(PathBuf::as_path);
    check_distinct(&out, [], inputs).map_err(Failure::input)?;
    let profile = fitted(options).map_err(Failure::input)?;
    collect(out.iter().map(|file| file.write_bytes(profile.to_toml().as_bytes())))
        .map_err(Failure::running)?;
    let path = options.out.display();
    print(format_args!(
        "{path}: profile of {}; use it with\n  tendon run --set acquisition.simulate.profile={path}",
        counted(profile.channels(), "channel", "channels")
    ))
    .map_err(Failure::running)
}

/// An earlier profile is replaced, and nothing else.
fn refuse_other_file(out: &Path) -> anyhow::Result<()> {
    if !out.is_file() {
        return Ok(());
    }
    let text = tendon_input::read_text(out, tendon_input::LARGEST_SETTINGS);
    ensure!(
        text.is_ok_and(|text| text.is_empty() || Profile::from_toml(&text).is_ok()),
        "{} is there already and is no profile: name another file",
        out.display()
    );
    Ok(())
}

fn fitted(options: &FitOptions) -> anyhow::Result<Profile> {
    // Single files and folders of any name, too.
    let is_three_dc = |path: &&PathBuf| {
        three_dc::parse_file_name(path).is_some()
            || three_dc::repetitions(path).is_ok_and(|repetitions| !repetitions.is_empty())
    };
    let (three_dc, others): (Vec<&PathBuf>, Vec<&PathBuf>) = options.recordings.iter().partition(is_three_dc);
    let settings = options.recording.settings(DatasetSettings::default());
    let channels = if others.is_empty() {
        let given = options.recording.channels.clone();
        if given.is_empty() { of_three_dc() } else { given }
    } else {
        ensure!(
            three_dc.is_empty(),
            "{} is of the layout 3DC and {} of another: fit one profile for each",
            three_dc[0].display(),
            others[0].display()
        );
        channels_or_default(&options.recording.channels, &settings, &options.recordings)?
    };
    let settings = DatasetSettings { channels, ..settings };
    let mut parts = Parts { skip_s: options.skip_s, ..Parts::default() };
    let own_unit = if others.is_empty() {
        ensure!(settings.label_column.is_none(), "--label-column is for tables of your own: leave it out");
        let settings = RecordingSettings {
            channels: settings.channels.clone(),
            sample_rate_hz: settings.recording_rate_hz,
            ..RecordingSettings::default()
        };
        for path in three_dc {
            parts.read(path, RecordingSource::open(path, &settings)?)?;
        }
        three_dc::UNIT.to_owned()
    } else {
        let found = list(&settings, &options.recordings)?;
        let people: BTreeSet<PersonId> = found.recordings.iter().map(|recording| recording.person).collect();
        ensure!(
            people.len() == 1,
            "the recordings are of several people ({}): a profile is of one, so give those of one",
            list_of(&people.into_iter().collect::<Vec<_>>())
        );
        for recording in &found.recordings {
            parts.read(&recording.path, recording.open(&settings)?)?;
        }
        found.unit
    };
    let segments = parts.segments.iter().map(|(gesture, samples)| Segment { gesture: *gesture, samples });
    let segments: Vec<Segment<'_>> = segments.collect();
    Ok(fit_profile(
        &segments,
        &FitSettings {
            source: options.source.clone(),
            unit: options.recording.unit_of(&own_unit)?,
            channels: settings.channels.len(),
            sample_rate_hz: parts.sample_rate_hz.context("there are no recordings")?,
            mains_hz: options.mains_hz,
        },
    )?)
}

/// Whether two recordings can be fitted together: rates that were found by time stamps are never quite the same.
fn is_same_rate(a_hz: f64, b_hz: f64) -> bool {
    const TOLERANCE: f64 = 1e-3;
    (a_hz / b_hz - 1.0).abs() <= TOLERANCE
}

/// What was read of recordings: samples under a cue, without the beginning of each part.
#[derive(Default)]
struct Parts {
    /// The gestures with their samples, channel-major.
    segments: Vec<(Gesture, Vec<f32>)>,
    sample_rate_hz: Option<f64>,
    /// Left out of the beginning of each part, s.
    skip_s: f64,
}

impl Parts {
    /// Cuts a recording at its cues and where samples are missing.
    fn read(&mut self, path: &Path, mut recording: RecordingSource) -> anyhow::Result<()> {
        let rate_hz = recording.sample_rate_hz();
        ensure!(
            is_same_rate(*self.sample_rate_hz.get_or_insert(rate_hz), rate_hz),
            "{}: recorded at another rate than the recordings before it: fit one profile for each rate",
            path.display()
        );
        let skip = (self.skip_s * rate_hz) as usize;
        let mut values = vec![0.0; recording.channels()];
        let mut by_channel: Vec<Vec<f32>> = vec![Vec::new(); values.len()];
        let mut last: Option<Frame> = None;
        loop {
            let frame = recording.next_frame(&mut values)?;
            let goes_on = |last: &Frame| {
                frame.is_some_and(|frame| frame.segment == last.segment && frame.samples_lost_before == 0)
            };
            if let Some(last) = last.filter(|last| !goes_on(last)) {
                if let Some(gesture) = last.cue.filter(|_| by_channel[0].len() > skip) {
                    let samples = by_channel.iter().flat_map(|samples| &samples[skip..]).copied().collect();
                    self.segments.push((gesture, samples));
                }
                by_channel.iter_mut().for_each(Vec::clear);
            }
            last = frame;
            if frame.is_none() {
                tell(format_args!("read {} (gestures so far: {})", path.display(), self.segments.len()));
                return Ok(());
            }
            by_channel.iter_mut().zip(&values).for_each(|(samples, value)| samples.push(*value));
        }
    }
}
