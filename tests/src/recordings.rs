//! Recordings to replay: made here, the same every time, or real ones where there are any.

use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Channels of every recording made here.
pub const CHANNELS: usize = 4;

/// Noise whose amplitude says who is moving: a stretch of a pseudo-EMG.
#[derive(Clone, Copy, Debug)]
pub struct Stretch {
    /// Samples of each channel.
    pub samples: usize,
    /// Amplitude of each channel.
    pub amplitudes: [f32; CHANNELS],
}

/// Rest: little on all channels.
pub const REST: [f32; CHANNELS] = [10.0; CHANNELS];
/// Some movement: much, unevenly.
pub const MOVEMENT: [f32; CHANNELS] = [800.0, 300.0, 500.0, 150.0];

/// Noise with a spectrum like that of muscles, in the stretches' amplitudes, frame by frame, the same every time.
#[derive(Debug)]
pub struct PseudoEmg {
    state: u64,
    /// The last two samples of each channel before its amplitude.
    last: [[f32; 2]; CHANNELS],
}

impl Default for PseudoEmg {
    fn default() -> Self {
        PseudoEmg { state: 1, last: [[0.0; 2]; CHANNELS] }
    }
}

impl PseudoEmg {
    /// The next sample of every channel.
    pub fn frame(&mut self, amplitudes: [f32; CHANNELS]) -> [f32; CHANNELS] {
        std::array::from_fn(|channel| {
            // A broad peak in the spectrum, as muscles have; white noise would be an electrode that is off.
            let [newer, older] = self.last[channel];
            let next = 1.538 * newer - 0.64 * older + self.uniform();
            self.last[channel] = [next, newer];
            amplitudes[channel] * next / 3.75
        })
    }

    /// Between -1 and 1: Knuth's linear congruential generator (MMIX).
    fn uniform(&mut self) -> f32 {
        self.state =
            self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.state >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

/// Writes the stretches as a table, one line a sample, one column a channel.
pub fn write_table(path: &Path, stretches: &[Stretch]) {
    write_columns(path, stretches, CHANNELS);
}

/// Writes so many columns: beyond the channels, these again.
fn write_columns(path: &Path, stretches: &[Stretch], columns: usize) {
    let mut emg = PseudoEmg::default();
    let mut text = String::new();
    for stretch in stretches {
        for _ in 0..stretch.samples {
            let frame = emg.frame(stretch.amplitudes);
            for column in 0..columns {
                let separator = if column == 0 { "" } else { "," };
                write!(text, "{separator}{:.2}", frame[column % CHANNELS]).unwrap();
            }
            text.push('\n');
        }
    }
    std::fs::write(path, text).unwrap();
}

/// Columns of the armband of the 3DC data set.
const THREE_DC_COLUMNS: usize = 10;

/// Writes a folder of the 3DC layout (1000 Hz, ten columns), whose one repetition is 6 s of rest, 3 s with the cue
/// extension and 3 s with the cue grip. Its cues make recognition count windows.
pub fn write_three_dc(folder: &Path) {
    std::fs::create_dir_all(folder).unwrap();
    // Not taken for a grip by the model, so that the arm moves.
    let extension = [60.0, 60.0, 400.0, 60.0];
    let grip = [200.0, 900.0, 100.0, 600.0];
    // Numbers of the data set: 0 rest, 4 extension, 7 grip.
    for (number, samples, amplitudes) in [(0, 6000, REST), (4, 3000, extension), (7, 3000, grip)] {
        let file = folder.join(format!("3dc_EMG_gesture_0_{number}.txt"));
        write_columns(&file, &[Stretch { samples, amplitudes }], THREE_DC_COLUMNS);
    }
}

/// Writes an EDF+D file of four channels in uV at 1925.926 Hz: 3 s with the annotation rest, half a second that is missing, and
/// 3 s with the annotation extension.
pub fn write_edf(path: &Path) {
    const SAMPLES: usize = 26;
    const RECORD_S: f64 = 0.0135;
    const TEXT_BYTES: usize = 60;
    let records = 2 * (3.0 / RECORD_S) as usize;
    let heads = CHANNELS + 1;
    let mut bytes =
        format!("{:<184}{:<8}{:<44}{records:<8}{RECORD_S:<8}{heads:<4}", 0, 256 * (heads + 1), "EDF+D")
            .into_bytes();
    for (of_channel, of_text, width) in [
        ("EMG", "EDF Annotations", 16),
        ("", "", 80),
        ("uV", "", 8),
        ("-3276.8", "-1", 8),
        ("3276.7", "1", 8),
        ("-32768", "-32768", 8),
        ("32767", "32767", 8),
        ("", "", 80),
        (&SAMPLES.to_string(), &(TEXT_BYTES / 2).to_string(), 8),
        ("", "", 32),
    ] {
        for channel in 1..=CHANNELS {
            let value = if of_channel == "EMG" { format!("EMG {channel}") } else { of_channel.to_owned() };
            bytes.extend(format!("{value:<width$}").bytes());
        }
        bytes.extend(format!("{of_text:<width$}").bytes());
    }
    let mut emg = PseudoEmg::default();
    for record in 0..records {
        let is_second_half = record >= records / 2;
        let amplitudes = if is_second_half { [60.0, 60.0, 400.0, 60.0] } else { REST };
        let frames: Vec<_> = (0..SAMPLES).map(|_| emg.frame(amplitudes)).collect();
        for channel in 0..CHANNELS {
            bytes.extend(frames.iter().flat_map(|frame| ((10.0 * frame[channel]) as i16).to_le_bytes()));
        }
        let start_s = record as f64 * RECORD_S + if is_second_half { 0.5 } else { 0.0 };
        let mut text = format!("+{start_s:.4}\x14\x14\0");
        if record % (records / 2) == 0 {
            let gesture = if is_second_half { "extension" } else { "rest" };
            text += &format!("+{start_s:.4}\x153\x14{gesture}\x14\0");
        }
        text += &"\0".repeat(TEXT_BYTES - text.len());
        bytes.extend(text.bytes());
    }
    std::fs::write(path, bytes).unwrap();
}

/// The EMG folder of one person of the real 3DC recordings: below `TENDON_SHARED`, else in the folder
/// `shared` beside the project. `None`, and a word about it, when there are none.
pub fn real_three_dc() -> Option<PathBuf> {
    let shared = std::env::var_os("TENDON_SHARED")
        .map_or_else(|| crate::repository().join("../shared"), PathBuf::from);
    let folder = shared.join("data/3dc/Participant1/train/EMG");
    if folder.is_dir() {
        return folder.canonicalize().ok();
    }
    println!("skipped: recordings not found");
    None
}
