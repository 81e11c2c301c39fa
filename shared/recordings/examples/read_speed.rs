//! How fast recordings are read, replayed, and brought to where windows are cut, in one thread:
//! `cargo run --release -p tendon-recordings --example read_speed -- FOLDER/ParticipantP/train/EMG…`
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

use tendon_recordings::{Channel, RecordingSettings, ReplayStream, check, three_dc};
use tendon_signal::{EmgFilter, FilterSettings, OnsetSettings, find_onset};

fn main() -> Result<(), Box<dyn Error>> {
    let folders: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    for (name, channels) in [("4 of 10 channels", vec![0, 3, 5, 8]), ("10 of 10 channels", (0..10).collect())]
    {
        let channels: Vec<Channel> = channels.into_iter().map(Channel::Index).collect();
        let settings = RecordingSettings { channels, ..RecordingSettings::default() };

        let start = Instant::now();
        let (mut bytes, mut recording_s) = (0, 0.0);
        for folder in &folders {
            let summary = check(folder, &settings)?;
            recording_s += summary.duration_s;
            for span in &summary.cues {
                bytes += span.segment.file.metadata()?.len();
            }
        }
        let reading_s = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let mut block = vec![0.0; settings.channels.len() * 10];
        for folder in &folders {
            let mut stream = ReplayStream::open(folder, &settings, 2000.0, 10)?;
            while stream.next_block(&mut block)?.is_some() {}
        }
        let replay_s = start.elapsed().as_secs_f64();

        // As a data set is built: the filter runs through a repetition, the onset is of each file.
        let start = Instant::now();
        let count = settings.channels.len();
        let mut signal = Vec::new();
        for folder in &folders {
            for repetition in three_dc::repetitions(folder)? {
                let settings = RecordingSettings { repetition: Some(repetition), ..settings.clone() };
                let mut stream = ReplayStream::open(folder, &settings, 2000.0, 1)?;
                let mut filter = EmgFilter::new(&FilterSettings::default(), count, 2000.0)?;
                while let Some(block) = stream.next_piece(&mut signal, NonZeroUsize::MAX)? {
                    let samples = signal.len() / count;
                    filter.process_all(&mut signal, 0..samples);
                    if block.cue.is_some() {
                        find_onset(&OnsetSettings::default(), &signal, count, 2000.0)?;
                    }
                }
            }
        }
        let to_windows_s = start.elapsed().as_secs_f64();
        println!(
            "{name}: {:.1} MB, {recording_s:.0} s of EMG; read {:.0} MB/s, {:.0} x real time; \
             read and resampled to 2000 Hz {:.0} MB/s, {:.0} x real time; \
             all up to cutting windows {:.0} x real time",
            bytes as f64 / 1e6,
            bytes as f64 / 1e6 / reading_s,
            recording_s / reading_s,
            bytes as f64 / 1e6 / replay_s,
            recording_s / replay_s,
            recording_s / to_windows_s,
        );
    }
    Ok(())
}
