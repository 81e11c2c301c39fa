//! From a recording to the windows of its trials: what data sets are made of, and what evaluation sees.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;

use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_recordings::{RecordingError, ReplayStream, Segment, SkippedEntry, SkippedKind};
use tendon_signal::{DesignError, EmgFilter, Envelope, WindowInput, WindowSettings, find_onset};

use crate::recording::Recording;
use crate::settings::DatasetSettings;
use crate::trial::RecordingEntry;

/// The most values of a trial, all channels together: what is held in memory while it is cut. At 2000 Hz and
/// four channels that is more than eight minutes.
const MAX_TRIAL_VALUES: usize = 4_000_000;

/// Samples of each channel that are read and filtered at a time.
const PIECE_SAMPLES: NonZeroUsize = NonZeroUsize::new(1 << 12).expect("more than none");

/// A window, as [`cut`] gives it.
#[derive(Clone, Copy, Debug)]
pub struct CutWindow<'a> {
    /// Channel-major `[channels × samples]`, in the recording's unit.
    pub samples: &'a [f32],
    /// What the person was asked to do.
    pub gesture: Gesture,
    /// Whose it is.
    pub person: PersonId,
    /// Repetition of the gesture, counted through all sessions of the person.
    pub repetition: u8,
    /// The trial it was cut from: its place in [`Cut::trials`].
    pub trial: usize,
    /// Its first sample within that trial, at the rate of the settings.
    pub start_sample: usize,
}

/// What [`cut`] made of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cut {
    /// The trials that gave windows, in order.
    pub trials: Vec<RecordingEntry>,
    /// Those that gave none, and why.
    pub skipped: Vec<SkippedEntry>,
    /// What the user should know.
    pub notices: Vec<String>,
    /// Samples of each channel that were read, at the rate of the settings, within trials or not.
    pub samples: u64,
}

/// Gives every window of `recording` to `on_window`, in order, by the filter and the onset detection of
/// `settings`. The window is in a buffer that the next one is written to: nothing is allocated for a window.
///
/// # Errors
/// When the settings do not fit or the recording cannot be read to its end. The windows that it has given by then
/// are not to be used: a data set leaves out such a recording whole.
pub fn cut(
    settings: &DatasetSettings,
    recording: &Recording,
    on_window: &mut dyn FnMut(CutWindow<'_>),
) -> Result<Cut, RecordingError> {
    let mut cut = Cut::default();
    let mut window = vec![0.0; settings.channels.len() * settings.windows.window_samples];
    let (notices, samples) = trials(settings, recording, &mut |outcome| {
        match outcome {
            Outcome::Skipped(skipped) => cut.skipped.push(skipped),
            Outcome::Trial(trial) => {
                for start_sample in trial.entry.starts(&settings.windows) {
                    trial.copy_window(start_sample, &settings.windows, &mut window);
                    on_window(CutWindow {
                        samples: &window,
                        gesture: trial.entry.gesture,
                        person: trial.entry.person,
                        repetition: trial.entry.repetition_of_all,
                        trial: cut.trials.len(),
                        start_sample,
                    });
                }
                cut.trials.push(trial.entry);
            }
        }
        ControlFlow::Continue(())
    })?;
    Ok(Cut { notices, samples, ..cut })
}

/// What became of a trial.
pub(crate) enum Outcome {
    Trial(Trial),
    Skipped(SkippedEntry),
}

/// A trial that windows can be cut from.
pub(crate) struct Trial {
    pub(crate) entry: RecordingEntry,
    /// What windows hold, `[channels × samples]`.
    content: Vec<f32>,
}

impl Trial {
    /// Copies the window that begins at `start_sample` into `window`, `[channels × samples]`.
    pub(crate) fn copy_window(&self, start_sample: usize, windows: &WindowSettings, window: &mut [f32]) {
        let channels = self.content.chunks_exact(self.entry.samples);
        for (window, channel) in window.chunks_exact_mut(windows.window_samples).zip(channels) {
            window.copy_from_slice(&channel[start_sample..start_sample + windows.window_samples]);
        }
    }

    /// Memory that its samples take, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.content.as_slice())
    }
}

/// Gives what became of each trial of `recording` to `on_trial`, in order, until that breaks off. The result is
/// what the user should know about the recording, and how many samples of each channel were read, at the rate of
/// `settings`.
pub(crate) fn trials(
    settings: &DatasetSettings,
    recording: &Recording,
    on_trial: &mut dyn FnMut(Outcome) -> ControlFlow<()>,
) -> Result<(Vec<String>, u64), RecordingError> {
    settings.check()?;
    let channels = settings.channels.len();
    let rate_hz = settings.sample_rate_hz;
    let source = recording.open(settings)?;
    let mut notices: Vec<String> = source.notices().iter().map(ToString::to_string).collect();
    let notices_at_start = notices.len();
    let mut filter =
        settings.filter.as_ref().map(|filter| EmgFilter::new(filter, channels, rate_hz)).transpose()?;
    // Taken by pieces: the blocks' length is for replays.
    let mut stream = ReplayStream::of(source, rate_hz, 1)?;
    notices.extend(stream.rate_notice().map(|notice| notice.to_string()));
    let segments = stream.source().segments().to_vec();
    let is_divided = segments.iter().any(|segment| segment.end_sample.is_some());
    let mut piece = Vec::new();
    let mut samples = 0;
    let mut signal = Signal { channels: vec![Vec::new(); channels], samples: 0, replaced_samples: 0 };
    let (mut segment, mut is_continued) = (0, false);
    // Of the part, and of what follows on without a gap.
    let (mut first_sample, mut next_sample) = (0, 0);
    loop {
        let block = stream.next_piece(&mut piece, PIECE_SAMPLES)?;
        // No window spans a gap: what follows is a part of its own.
        let is_gap = block.is_some_and(|block| block.first_sample != next_sample);
        if is_gap || block.is_none_or(|block| block.segment != segment) {
            let part =
                Part { recording, segment: &segments[segment], first_sample, is_divided, is_continued };
            // A trial that the file does not contain to its end is reported below.
            let is_cut_off = block.is_none() && part.ends_after(stream.source().position());
            if !is_cut_off
                && let Some(outcome) = part.outcome(settings, &signal)?
                && on_trial(outcome).is_break()
            {
                return Ok((notices, samples));
            }
            signal.clear();
            is_continued = is_gap
                && block.is_some_and(|block| is_one_trial(&segments[segment], &segments[block.segment]));
            first_sample = block.map_or(0, |block| if is_gap { block.first_sample } else { block.cue_since });
        }
        let Some(block) = block else { break };
        segment = block.segment;
        let piece_samples = piece.len() / channels;
        samples += piece_samples as u64;
        next_sample = block.first_sample + piece_samples as u64;
        if let Some(filter) = &mut filter {
            signal.replaced_samples += filter.process_all(&mut piece, 0..piece_samples);
        }
        signal.push(&piece, piece_samples);
        let is_too_long = signal.channels[0].len() * channels > MAX_TRIAL_VALUES;
        if is_too_long || segments[segment].repetition.is_none() {
            signal.channels.iter_mut().for_each(Vec::clear);
        }
    }
    let source = stream.source();
    notices.extend(source.notices().iter().skip(notices_at_start).map(ToString::to_string));
    let file_samples = source.position();
    let cut_off = segments[segment..].iter().filter(|segment| segment.repetition.is_some());
    for segment in cut_off {
        let part = Part { recording, segment, first_sample, is_divided, is_continued };
        if part.ends_after(file_samples) && on_trial(part.cut_off(file_samples)).is_break() {
            break;
        }
    }
    Ok((notices, samples))
}

/// Whether two segments, the second after a gap, are parts of one trial.
fn is_one_trial(first: &Segment, second: &Segment) -> bool {
    (&first.file, first.repetition, first.cue) == (&second.file, second.repetition, second.cue)
}

/// A segment as it grows, filtered.
struct Signal {
    /// Of each channel, what is kept of it.
    channels: Vec<Vec<f32>>,
    /// Samples so far, kept or not.
    samples: usize,
    /// Those that the filter replaced.
    replaced_samples: u32,
}

impl Signal {
    fn push(&mut self, piece: &[f32], samples: usize) {
        for (channel, piece) in self.channels.iter_mut().zip(piece.chunks_exact(samples)) {
            channel.extend_from_slice(piece);
        }
        self.samples += samples;
    }

    fn clear(&mut self) {
        self.channels.iter_mut().for_each(Vec::clear);
        (self.samples, self.replaced_samples) = (0, 0);
    }
}

/// A segment of a recording.
struct Part<'a> {
    recording: &'a Recording,
    segment: &'a Segment,
    /// Its first sample in the recording, at the rate of the data set.
    first_sample: u64,
    /// Whether it is one of several in a file.
    is_divided: bool,
    /// Whether it is the rest of a trial after a gap: no cue begins it.
    is_continued: bool,
}

impl Part<'_> {
    fn ends_after(&self, file_samples: u64) -> bool {
        self.segment.end_sample.is_some_and(|end| end > file_samples)
    }

    /// A trial that its file does not contain to its end.
    fn cut_off(&self, file_samples: u64) -> Outcome {
        let end = self.segment.end_sample.unwrap_or_default();
        let reason = format!("it ends at sample {end}, but the file has only {file_samples}");
        let path = self.segment.file.clone();
        Outcome::Skipped(SkippedEntry { path, kind: SkippedKind::CutOff, reason })
    }

    fn skipped(&self, signal: &Signal, kind: SkippedKind, reason: String) -> Outcome {
        let reason = if self.is_divided || self.is_continued {
            let end = self.first_sample + signal.samples as u64;
            format!("samples {} to {end}: {reason}", self.first_sample)
        } else {
            reason
        };
        Outcome::Skipped(SkippedEntry { path: self.segment.file.clone(), kind, reason })
    }

    /// What becomes of the segment, whose filtered samples are `signal`; `None` if it is no trial.
    fn outcome(&self, settings: &DatasetSettings, signal: &Signal) -> Result<Option<Outcome>, DesignError> {
        let Segment { file, repetition: Some(repetition), cue, .. } = self.segment else { return Ok(None) };
        let Some(gesture) = *cue else {
            let reason = "its gesture is not one of the six".to_owned();
            return Ok(Some(self.skipped(signal, SkippedKind::OtherGesture, reason)));
        };
        if signal.replaced_samples > 0 {
            let reason =
                format!("{} samples are larger than any amplifier delivers", signal.replaced_samples);
            return Ok(Some(self.skipped(signal, SkippedKind::Faulty, reason)));
        }
        let channels = settings.channels.len();
        let rate_hz = settings.sample_rate_hz;
        let samples = signal.samples;
        if samples > signal.channels[0].len() {
            let longest_s = (MAX_TRIAL_VALUES / channels) as f64 / rate_hz;
            let reason = format!(
                "{:.1} s are too long for a trial, {longest_s:.1} s is the most: divide it into several",
                samples as f64 / rate_hz
            );
            return Ok(Some(self.skipped(signal, SkippedKind::TooLong, reason)));
        }
        let content = signal.channels.concat();
        let samples_of_ms = |ms: f64| (ms * 1e-3 * rate_hz).round() as usize;
        let (onset_sample, start_sample) = match gesture {
            Gesture::REST => (None, samples_of_ms(settings.rest_start_ms)),
            // The movement is on its way.
            _ if self.is_continued => (None, samples_of_ms(settings.fallback_ms)),
            _ => match find_onset(&settings.onset, &content, channels, rate_hz)? {
                Some(onset) => (Some(onset.sample), onset.start_sample),
                None => (None, samples_of_ms(settings.fallback_ms)),
            },
        };
        let WindowSettings { window_samples, increment_samples } = settings.windows;
        let left = samples.saturating_sub(start_sample);
        if left < window_samples {
            let reason =
                format!("{left} samples after the start of the gesture, a window has {window_samples}");
            return Ok(Some(self.skipped(signal, SkippedKind::TooShort, reason)));
        }
        let content = match settings.input {
            WindowInput::Raw => content,
            WindowInput::Envelope => envelope_of(content, samples, settings.onset.envelope_ms, rate_hz)?,
        };
        let entry = RecordingEntry {
            file: file.clone(),
            person: self.recording.person,
            session: self.recording.session.clone(),
            repetition: *repetition,
            repetition_of_all: self.recording.repetition_of_all(*repetition),
            gesture,
            sample_rate_hz: rate_hz,
            first_sample: if self.is_divided || self.is_continued { self.first_sample } else { 0 },
            samples,
            onset_sample,
            start_sample,
            fallback: gesture != Gesture::REST && onset_sample.is_none(),
            first_window: 0,
            windows: ((left - window_samples) / increment_samples + 1) as u64,
        };
        Ok(Some(Outcome::Trial(Trial { entry, content })))
    }
}

/// The moving RMS of every channel of a trial, starting from zero.
fn envelope_of(
    mut signal: Vec<f32>,
    samples: usize,
    envelope_ms: f64,
    rate_hz: f64,
) -> Result<Vec<f32>, DesignError> {
    for channel in signal.chunks_exact_mut(samples) {
        let mut tracker = Envelope::new(envelope_ms, rate_hz)?;
        channel.iter_mut().for_each(|sample| *sample = tracker.push(*sample));
    }
    Ok(signal)
}
