//! `tendon profile fit`: a profile of the simulated amplifier from real recordings.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::{Args, Subcommand};
use tendon_emg_simulation::{FitSettings, Profile, Segment, fit as fit_profile};
use tendon_gesture::Gesture;
use tendon_output::{check_distinct, collect};
use tendon_recordings::{RecordingSettings, RecordingSource, three_dc};

use crate::Failure;
use crate::channels::of_three_dc;
use crate::options::RecordingOptions;
use crate::output::{checked, print, tell};

/// Commands of `tendon profile`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fit a profile from one person's recordings, for acquisition.simulate.profile.
    Fit(FitOptions),
}

/// Command line of `tendon profile fit`.
#[derive(Debug, Args)]
pub struct FitOptions {
    /// Recordings with cues: folders of the 3DC layout (…/ParticipantP/train/EMG), or single files from one.
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
        "{path}: profile of {} channels; use it with\n  tendon run --set acquisition.simulate.profile={path}",
        profile.channels()
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
    let channels = &options.recording.channels;
    let unit = options.recording.unit_of(three_dc::UNIT)?;
    let settings = RecordingSettings {
        channels: if channels.is_empty() { of_three_dc() } else { channels.clone() },
        sample_rate_hz: options.recording.recording_rate_hz,
        repetition: None,
    };
    let mut segments: Vec<(Gesture, Vec<f32>)> = Vec::new();
    let mut sample_rate_hz = None;
    for path in &options.recordings {
        ensure!(
            three_dc::is_three_dc(path),
            "{}: a table does not say which gestures were made: give a folder of the 3DC layout \
             (…/ParticipantP/train/EMG), or one of its files",
            path.display()
        );
        let mut recording = RecordingSource::open(path, &settings)?;
        let rate = recording.sample_rate_hz();
        ensure!(
            *sample_rate_hz.get_or_insert(rate) == rate,
            "{}: recorded at another rate than the recordings before it: fit one profile for each rate",
            path.display()
        );
        read_segments(&mut recording, (options.skip_s * rate) as usize, &mut segments)?;
        tell(format_args!("read {} ({} gestures so far)", path.display(), segments.len()));
    }
    let segments: Vec<Segment<'_>> =
        segments.iter().map(|(gesture, samples)| Segment { gesture: *gesture, samples }).collect();
    Ok(fit_profile(
        &segments,
        &FitSettings {
            source: options.source.clone(),
            unit,
            channels: settings.channels.len(),
            sample_rate_hz: sample_rate_hz.context("there are no recordings")?,
            mains_hz: options.mains_hz,
        },
    )?)
}

/// Cuts a recording at its cues, without the first `skip` samples after each; channel-major.
fn read_segments(
    recording: &mut RecordingSource,
    skip: usize,
    segments: &mut Vec<(Gesture, Vec<f32>)>,
) -> anyhow::Result<()> {
    let channels = recording.channels();
    let mut values = vec![0.0; channels];
    let mut by_channel: Vec<Vec<f32>> = vec![Vec::new(); channels];
    let mut current = None;
    loop {
        let frame = recording.next_frame(&mut values)?;
        if current != frame {
            let gesture = current.and_then(|frame: tendon_recordings::Frame| frame.cue);
            if let Some(gesture) = gesture.filter(|_| by_channel[0].len() > skip) {
                segments.push((
                    gesture,
                    by_channel.iter().flat_map(|samples| &samples[skip..]).copied().collect(),
                ));
            }
            by_channel.iter_mut().for_each(Vec::clear);
            current = frame;
        }
        if frame.is_none() {
            return Ok(());
        }
        by_channel.iter_mut().zip(&values).for_each(|(samples, value)| samples.push(*value));
    }
}
