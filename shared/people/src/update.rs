//! A person on a new day: the electrodes were put on again, and everything lies elsewhere by about the same step.
//!
//! ```text
//! person, a few seconds of rest and gestures ─▶ step of the features ─▶ person, moved by it
//! ```

use serde::Serialize;
use tendon_features::FitError;
use tendon_gesture::Gesture;

use crate::person::Person;
use crate::quality::ChannelQuality;
use crate::recogniser::RecogniseError;

/// How much stronger a channel is than in the calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelShift {
    /// Name of the channel.
    pub name: String,
    /// RMS at rest over that in the calibration; 0 for a flat channel.
    pub rest: f64,
    /// The same of the gestures.
    pub gestures: f64,
}

impl Person {
    /// How much stronger each channel is in these windows, channel-major, than in the calibration.
    pub fn shifts<'a>(&self, windows: impl Iterator<Item = (Gesture, &'a [f32])>) -> Vec<ChannelShift> {
        let (rest, gestures): (Vec<_>, Vec<_>) = windows.partition(|(gesture, _)| *gesture == Gesture::REST);
        let [rest, gestures] =
            [rest, gestures].map(|of| of.into_iter().map(|(_, window)| window).collect::<Vec<&[f32]>>());
        let signal = &self.signal;
        let shift = |(channel, before): (usize, &ChannelQuality)| {
            let (samples, rate_hz) = (signal.window_samples, signal.sample_rate_hz);
            let now = ChannelQuality::of(channel, &before.name, samples, rate_hz, &rest, &gestures);
            let times =
                |of: fn(&ChannelQuality) -> f64| if of(before) > 0.0 { of(&now) / of(before) } else { 0.0 };
            ChannelShift {
                name: before.name.clone(),
                rest: times(|quality| quality.rest_rms),
                gestures: times(ChannelQuality::gesture_rms),
            }
        };
        self.channels.iter().enumerate().map(shift).collect()
    }

    /// The person where all gestures have moved by the step that these windows show, channel-major, each with the gesture
    /// that was made. `when` is noted as part of where the person comes from. Effort and quality stay as they were.
    ///
    /// # Errors
    ///
    /// There are no windows of the person's gestures, or one makes no features.
    pub fn updated<'a>(
        &self,
        windows: impl Iterator<Item = (Gesture, &'a [f32])>,
        when: &str,
    ) -> Result<Person, RecogniseError> {
        let mut covariance = self.features()?;
        let gestures = self.gesture_set();
        let (mut classes, mut features) = (Vec::new(), Vec::new());
        for (gesture, window) in windows {
            if let Some(number) = gestures.number(gesture) {
                let mut own = vec![0.0; covariance.feature_count()];
                covariance.compute(window, &mut own)?;
                classes.push(usize::from(number));
                features.push(own);
            }
        }
        if classes.is_empty() {
            return Err(FitError::TooFewClasses(0).into());
        }
        let windows = classes.into_iter().zip(features.iter().map(Vec::as_slice));
        let mut updated = self.clone();
        updated.fitted.discriminant = self.fitted.discriminant.clone().moved_to(windows)?;
        updated.made.from += &format!("; updated {when}");
        Ok(updated)
    }
}
