//! The whole dsp stage as one pure transformation, used live and offline.
//!
//! ```text
//! block [channels × samples] ─▶ filter ─┬─▶ windows ─────────────▶ window [channels × window]
//!           │                           ├─▶ envelope ─▶ activity ─▶ Calibrating | Rest | Move
//!           └───────────────────────────┴─▶ contact ─▶ novelty
//! ```
//! The output is bit-identical however the samples are divided into blocks.

use serde::{Deserialize, Serialize};

use crate::activity::{Activity, ActivityDetector, ActivitySettings, Baseline};
use crate::contact::{ContactWatch, Fault};
use crate::envelope::{DEFAULT_ENVELOPE_MS, Envelope};
use crate::error::DesignError;
use crate::filter::{EmgFilter, FilterSettings, is_usable};
use crate::windows::{WindowSettings, Windower};

/// All settings of the signal processing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SignalSettings {
    /// Notch and band-pass.
    pub filter: FilterSettings,
    /// Length of the moving RMS, in ms.
    pub envelope_ms: f64,
    /// Calibration and detection of movement.
    pub activity: ActivitySettings,
    /// Window length and increment.
    pub windows: WindowSettings,
}

impl Default for SignalSettings {
    fn default() -> SignalSettings {
        SignalSettings {
            filter: FilterSettings::default(),
            envelope_ms: DEFAULT_ENVELOPE_MS,
            activity: ActivitySettings::default(),
            windows: WindowSettings::default(),
        }
    }
}

/// A window that is due: [`SignalChain::write_window`] writes its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Number of its first sample, counted from the start of the chain, lost samples included.
    pub first_sample: u64,
    /// Activity at its newest sample.
    pub activity: Activity,
    /// How many of its samples, over all channels, were unusable and replaced. A window with any does not
    /// show what the muscles did and must be treated as rest.
    pub replaced_samples: u32,
    /// How unlike muscles the least likely channel is: above 1, an electrode is off (flat, silent, hum or noise).
    pub novelty: f32,
}

/// What [`SignalChain::push`] did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Samples of each channel taken from the block, at least 1. Push again from there until all are taken.
    pub consumed: usize,
    /// How many of them, over all channels, were unusable and replaced.
    pub replaced_samples: u32,
    /// Activity at the last of them.
    pub activity: Activity,
    /// The window that ends with the last of them, if one does.
    pub window: Option<Window>,
}

/// Filter, envelope, activity and windows of all channels of a session.
///
/// ```
/// # use tendon_signal::{SignalChain, SignalSettings};
/// let mut chain = SignalChain::new(&SignalSettings::default(), 4, 2000.0)?;
/// let mut out = vec![0.0; chain.window_len()];
/// let mut windows = 0;
/// let Ok(_) = chain.push_block(&[0.0; 4 * 1000], |chain, _, _| {
///     chain.write_window(&mut out);
///     windows += 1;
///     Ok::<(), std::convert::Infallible>(())
/// });
/// assert_eq!(windows, 3);
/// # Ok::<(), tendon_signal::DesignError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SignalChain {
    channels: usize,
    filter: EmgFilter,
    /// Of each channel.
    trackers: Vec<Envelope>,
    activity: ActivityDetector,
    contact: ContactWatch,
    windower: Windower,
    window_samples: usize,
    /// Number of the next sample, lost ones included.
    next_sample: u64,
    /// Envelope of every channel at each sample being pushed: `[samples × channels]`.
    envelopes: Vec<f32>,
    /// How many channels were replaced at each sample being pushed.
    replaced: Vec<u16>,
    /// Samples of each channel in the last push.
    pushed: usize,
}

impl SignalChain {
    /// Creates a chain and allocates all its memory.
    ///
    /// # Errors
    /// The first setting that cannot work.
    pub fn new(
        settings: &SignalSettings,
        channels: usize,
        sample_rate_hz: f64,
    ) -> Result<SignalChain, DesignError> {
        Ok(SignalChain {
            channels,
            filter: EmgFilter::new(&settings.filter, channels, sample_rate_hz)?,
            trackers: vec![Envelope::new(settings.envelope_ms, sample_rate_hz)?; channels],
            activity: ActivityDetector::new(&settings.activity, channels, sample_rate_hz)?,
            contact: ContactWatch::new(
                channels,
                settings.windows.window_samples,
                &settings.filter,
                sample_rate_hz,
            ),
            windower: Windower::new(&settings.windows, channels)?,
            window_samples: settings.windows.window_samples,
            next_sample: 0,
            envelopes: vec![0.0; channels * settings.windows.window_samples],
            replaced: vec![0; settings.windows.window_samples],
            pushed: 0,
        })
    }

    /// Samples in a window over all channels: the length that [`SignalChain::write_window`] expects.
    pub fn window_len(&self) -> usize {
        self.channels * self.window_samples
    }

    /// How many more samples the activity detector's calibration needs; 0 once it is over.
    pub fn calibration_left_samples(&self) -> usize {
        self.activity.calibration_left_samples()
    }

    /// What calibration measured of each channel at rest; `None` until it is over.
    pub fn baselines(&self) -> Option<&[Baseline]> {
        self.activity.baselines()
    }

    /// What is wrong with each channel in the newest window, if anything: an electrode that is off, or picks something up.
    pub fn faults(&self) -> &[Option<Fault>] {
        self.contact.faults()
    }

    /// The samples of the last [`SignalChain::push`], filtered: one slice a channel.
    pub fn filtered(&self) -> impl Iterator<Item = &[f32]> {
        self.windower.newest(self.pushed)
    }

    /// The envelope of each channel at the newest sample; empty before the first.
    pub fn envelope(&self) -> &[f32] {
        &self.envelopes[self.pushed.saturating_sub(1) * self.channels..self.pushed * self.channels]
    }

    /// Takes over what the activity detector of `other`, a chain of the same settings, has measured. At rest.
    pub fn take_calibration(&mut self, other: &SignalChain) {
        self.activity = other.activity.clone();
        self.activity.restart();
    }

    /// Takes samples `from..` of `block`, `[channels × samples]`, up to the end of the next window at most,
    /// so that every window can be written as soon as its newest sample is in.
    ///
    /// # Panics
    /// If the length of `block` is not a multiple of the number of channels, or `from` is past its end.
    pub fn push(&mut self, block: &[f32], from: usize) -> Push {
        assert!(block.len().is_multiple_of(self.channels), "a block is channels × samples");
        let samples = block.len() / self.channels;
        assert!(from < samples, "nothing to push: the block has {samples} samples, pushed from {from}");
        let consumed = self.windower.room().min(samples - from);

        let (ring, place) = self.windower.place_mut(consumed);
        let raw_channels = block.chunks_exact(samples).map(|raw| &raw[from..from + consumed]);
        let channels = ring.chunks_exact_mut(self.window_samples).zip(raw_channels.clone());
        for (channel, (signal, raw)) in channels.enumerate() {
            signal[place.clone()].copy_from_slice(raw);
            self.contact.push(channel, raw, self.next_sample);
        }
        let replaced_samples = self.filter.process_all(ring, place.clone());

        let replaced = &mut self.replaced[..consumed];
        replaced.fill(0);
        if replaced_samples > 0 {
            for raw in raw_channels {
                for (count, &sample) in replaced.iter_mut().zip(raw) {
                    *count += u16::from(!is_usable(sample));
                }
            }
        }
        let envelopes = &mut self.envelopes[..consumed * self.channels];
        let channels = ring.chunks_exact(self.window_samples).zip(&mut self.trackers);
        for (channel, (signal, tracker)) in channels.enumerate() {
            for (envelopes, &sample) in envelopes.chunks_exact_mut(self.channels).zip(&signal[place.clone()])
            {
                envelopes[channel] = tracker.push(sample);
            }
        }
        for envelope in envelopes.chunks_exact(self.channels) {
            self.activity.push(envelope);
        }
        let window_ends = self.windower.advance(&self.replaced[..consumed]);
        self.next_sample += consumed as u64;
        self.pushed = consumed;

        let activity = self.activity.activity();
        let window = window_ends.then(|| {
            let first_sample = self.next_sample - self.window_samples as u64;
            Window {
                first_sample,
                activity,
                replaced_samples: self.windower.replaced_samples(),
                novelty: self.contact.novelty(first_sample, self.windower.parts(), self.activity.baselines()),
            }
        });
        Push { consumed, replaced_samples, activity, window }
    }

    /// Takes all of `block`, `[channels × samples]`. Calls `on_window` for each window it completes, with the
    /// chain (which can write the window at that moment), the window, and how many samples of the block have
    /// been taken so far. Returns how many samples of the block, over all channels, were unusable and
    /// replaced.
    ///
    /// # Errors
    /// The first error of `on_window`. The rest of the block is then not taken.
    ///
    /// # Panics
    /// As [`SignalChain::push`], except for an empty block, which is allowed.
    pub fn push_block<E>(
        &mut self,
        block: &[f32],
        mut on_window: impl FnMut(&SignalChain, Window, usize) -> Result<(), E>,
    ) -> Result<u32, E> {
        let samples = block.len() / self.channels;
        let (mut end, mut replaced_samples) = (0, 0);
        loop {
            let push = self.push(block, end);
            end += push.consumed;
            replaced_samples += push.replaced_samples;
            if let Some(window) = push.window {
                on_window(self, window, end)?;
            }
            if end == samples {
                return Ok(replaced_samples);
            }
        }
    }

    /// Writes the window that the last [`SignalChain::push`] completed as `[channels × window]`, filtered.
    ///
    /// # Panics
    /// If `out` is not [`SignalChain::window_len`] long.
    pub fn write_window(&self, out: &mut [f32]) {
        self.windower.write_window(out);
    }

    /// Lets a window end after `samples` more samples of every channel, at least 1, and the others follow from there. Nothing
    /// changes if it is a whole number of increments from the next one anyway. For who knows where the windows of a
    /// recording began.
    pub fn align_windows(&mut self, samples: usize) {
        self.windower.align(samples);
    }

    /// Tells the chain that `lost_samples` samples of every channel are missing before the next ones. No
    /// window spans the gap, and movement must be detected anew. The filter continues as if nothing were
    /// missing, which disturbs it less than a restart.
    pub fn gap(&mut self, lost_samples: u64) {
        self.next_sample += lost_samples;
        self.windower.restart();
        self.activity.restart();
    }
}
