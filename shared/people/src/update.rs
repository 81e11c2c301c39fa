//! A person on a new day: the electrodes were put on again, and everything lies elsewhere by about the same step.
//!
//! ```text
//! person, a few seconds of rest and gestures ─▶ step of the features ─▶ person, moved by it
//! ```

use tendon_features::FitError;
use tendon_gesture::Gesture;

use crate::person::Person;
use crate::recogniser::RecogniseError;

impl Person {
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
