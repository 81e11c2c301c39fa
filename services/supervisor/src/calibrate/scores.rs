//! How well a person is recognised before and after a calibration or an update.

use std::collections::BTreeMap;

use serde::Serialize;
use tendon_gesture::Gesture;
use tendon_people::ChannelShift;

/// Shares of the windows of a check round that were recognised.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckScores {
    /// What recognises them without this calibration, in words: the person of before, or a network; `None` if nothing fits.
    pub before_by: Option<String>,
    /// The share without it; every gesture counts the same.
    pub before: Option<f64>,
    /// The share with the calibration.
    pub after: f64,
    /// The same by gesture.
    pub after_by_gesture: BTreeMap<Gesture, f64>,
}

/// What an update changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UpdateScores {
    /// Share of the windows of the update that the person recognised before it; every gesture counts the same.
    pub before: f64,
    /// The same after it. The update was made of these windows, so expect less of others.
    pub after: f64,
    /// How much stronger each channel is than in the calibration.
    pub channels: Vec<ChannelShift>,
}
