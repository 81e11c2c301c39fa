//! What a person is fitted from: windows of known gestures.

use std::collections::BTreeSet;

use tendon_features::{FeatureError, FitError, PriorError};

use tendon_gesture::{Gesture, GestureSet, InvalidGestureSet};

use crate::person::SignalFit;

/// Windows of a person with what was made in them, in the order in which they were recorded.
#[derive(Clone, Copy, Debug)]
pub struct Calibration<'a> {
    /// Where the windows come from.
    pub signal: &'a SignalFit,
    /// The gestures, rest among them.
    pub gestures: &'a [Gesture],
    /// Windows x channels x samples, filtered, in the unit of the source.
    pub samples: &'a [f32],
    /// Of each window, its gesture: a place in `gestures`.
    pub labels: &'a [usize],
    /// Of each window, which repetition of its gesture it is part of.
    pub repetitions: &'a [u32],
    /// Of each window, whether it begins within half a second of the onset of its movement; empty if nobody knows.
    pub is_entry: &'a [bool],
    /// Of each channel, the share of its samples that were clipped, from
    /// [`ClippingWatch`](crate::ClippingWatch); empty if nobody watched.
    pub clipped_shares: &'a [f64],
}

/// Why a person cannot be fitted.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// There are no windows of rest.
    #[error("there is no rest in the calibration: record the arm at rest, too")]
    NoRest,
    /// The gestures are too few, too many, or one is there twice.
    #[error("{0}: choose other gestures to calibrate")]
    Gestures(InvalidGestureSet),
    /// Samples, labels and repetitions do not belong together.
    #[error(
        "{samples} samples, {labels} labels and {repetitions} repetitions do not fit windows of {channels} channels x \
         {window_samples} samples"
    )]
    Shape {
        /// Samples of all windows.
        samples: usize,
        /// Number of labels.
        labels: usize,
        /// Number of repetition numbers.
        repetitions: usize,
        /// Channels of a window.
        channels: usize,
        /// Samples of a channel in a window.
        window_samples: usize,
    },
    /// A label that names no gesture.
    #[error("window {window} has label {label}, but there are only {gestures} gestures, counted from 0")]
    Label {
        /// The window.
        window: usize,
        /// Its label.
        label: usize,
        /// Number of gestures.
        gestures: usize,
    },
    /// The windows make no features.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The features make no recogniser.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The prior is not for these windows.
    #[error(transparent)]
    Prior(#[from] PriorError),
}

impl<'a> Calibration<'a> {
    /// The windows, channel-major, in order.
    pub(crate) fn windows(&self) -> impl Iterator<Item = &'a [f32]> {
        self.samples.chunks_exact(self.signal.window_length().max(1))
    }

    /// The windows of one gesture.
    pub(crate) fn windows_of(&self, label: usize) -> impl Iterator<Item = &'a [f32]> {
        self.windows().zip(self.labels).filter(move |(_, own)| **own == label).map(|(window, _)| window)
    }

    /// Checks all but the number of windows. Returns the gestures with rest first.
    pub(crate) fn check(&self) -> Result<GestureSet, CalibrationError> {
        let Calibration { signal, gestures, samples, labels, repetitions, .. } = *self;
        let rest = gestures.iter().position(|gesture| *gesture == Gesture::REST);
        let rest = rest.ok_or(CalibrationError::NoRest)?;
        let others = gestures.iter().enumerate().filter(|(place, _)| *place != rest);
        let set = std::iter::once(Gesture::REST).chain(others.map(|(_, gesture)| *gesture)).collect();
        let set = GestureSet::new(set).map_err(CalibrationError::Gestures)?;
        let length = signal.window_length();
        if length == 0 || samples.len() != labels.len() * length || repetitions.len() != labels.len() {
            return Err(CalibrationError::Shape {
                samples: samples.len(),
                labels: labels.len(),
                repetitions: repetitions.len(),
                channels: signal.channels.len(),
                window_samples: signal.window_samples,
            });
        }
        if let Some((window, &label)) = labels.iter().enumerate().find(|(_, label)| **label >= gestures.len())
        {
            return Err(CalibrationError::Label { window, label, gestures: gestures.len() });
        }
        if labels.contains(&rest) { Ok(set) } else { Err(CalibrationError::NoRest) }
    }

    /// How often each gesture was made.
    pub(crate) fn repetitions_of(&self, label: usize) -> BTreeSet<u32> {
        let own = self.labels.iter().zip(self.repetitions).filter(|(of, _)| **of == label);
        own.map(|(_, repetition)| *repetition).collect()
    }
}
