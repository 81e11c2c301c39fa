//! The constants of the method, in one place.

use serde::{Deserialize, Serialize};

use crate::error::FeatureError;

/// The constants of features and discriminant. The defaults are those that gave the best accuracy on people
/// who were calibrated in one session and scored in another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MethodSettings {
    /// Delays of the copies that are stacked below each channel, in ms, ascending from 0.
    pub delays_ms: Vec<f64>,
    /// Channels x delays is at most this; with more channels the longest delays are left out. One delay, 0,
    /// is always used.
    pub largest_rows: usize,
    /// Share of the covariance's mean diagonal that is added to its diagonal.
    pub ridge: f64,
    /// Share of the person's rest variance that is added to the diagonal, see
    /// [`rest_floor`](crate::rest_floor).
    pub rest_floor_share: f64,
    /// Length of the pieces, in ms, of whose features a window's are the mean. A gesture varies in strength within a window:
    /// the covariance of the whole would be that of its strongest part.
    pub piece_ms: f64,
    /// Other people's covariance counts as much as so many seconds of the person's own windows. 0: not at all.
    pub prior_s: f64,
    /// Smallest and largest temperature of the posterior. Parts of one repetition are so alike that holding
    /// them out asks for no temperature at all, so the smallest one has to keep the posterior honest. On
    /// fifteen people scored in another session (four channels, 300 ms, with prior), the log-loss was least
    /// near 14 after one repetition and near 7 after four.
    pub temperature_range: [f64; 2],
    /// Windows that every class needs at least.
    pub fewest_windows: usize,
}

impl Default for MethodSettings {
    fn default() -> Self {
        MethodSettings {
            delays_ms: vec![0.0, 1.0, 2.0, 3.0],
            largest_rows: 32,
            ridge: 0.001,
            rest_floor_share: 0.002,
            piece_ms: 75.0,
            prior_s: 9.0,
            temperature_range: [8.0, 1000.0],
            fewest_windows: 5,
        }
    }
}

impl MethodSettings {
    /// Checks every value.
    ///
    /// # Errors
    ///
    /// The first setting out of its range, by name.
    pub fn check(&self) -> Result<(), FeatureError> {
        let delays = &self.delays_ms;
        let ascending = delays.windows(2).all(|pair| pair[0] < pair[1]);
        if delays.first() != Some(&0.0) || !ascending || !delays.iter().all(|delay| *delay <= 1000.0) {
            return Err(FeatureError::Delays(delays.clone()));
        }
        let [coldest, hottest] = self.temperature_range;
        let in_range = [
            ("largest_rows", self.largest_rows as f64, (1..=256).contains(&self.largest_rows), "1 to 256"),
            ("ridge", self.ridge, (0.0..=1.0).contains(&self.ridge), "0 to 1"),
            (
                "rest_floor_share",
                self.rest_floor_share,
                self.rest_floor_share > 0.0 && self.rest_floor_share <= 1.0,
                "above 0 and at most 1",
            ),
            ("piece_ms", self.piece_ms, (1.0..=10_000.0).contains(&self.piece_ms), "1 to 10000"),
            ("prior_s", self.prior_s, (0.0..=1e6).contains(&self.prior_s), "0 to a million"),
            (
                "temperature_range[0]",
                coldest,
                coldest > 0.0 && coldest <= hottest,
                "above 0 and at most the second value",
            ),
            ("temperature_range[1]", hottest, hottest.is_finite(), "a finite number"),
            ("fewest_windows", self.fewest_windows as f64, self.fewest_windows >= 2, "2 or more"),
        ];
        match in_range.into_iter().find(|(_, _, fits, _)| !fits) {
            Some((setting, value, _, range)) => Err(FeatureError::Setting { setting, value, range }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_hold() {
        MethodSettings::default().check().expect("valid defaults");
    }

    #[test]
    fn values_out_of_range_are_named() {
        type Change = fn(&mut MethodSettings);
        let cases: [(&str, Change); 11] = [
            ("delays_ms", |settings| settings.delays_ms = vec![]),
            ("delays_ms", |settings| settings.delays_ms = vec![1.0]),
            ("delays_ms", |settings| settings.delays_ms = vec![0.0, 2.0, 1.0]),
            ("delays_ms", |settings| settings.delays_ms = vec![0.0, f64::NAN]),
            ("largest_rows", |settings| settings.largest_rows = 0),
            ("ridge", |settings| settings.ridge = -1.0),
            ("rest_floor_share", |settings| settings.rest_floor_share = 0.0),
            ("piece_ms", |settings| settings.piece_ms = 0.0),
            ("prior_s", |settings| settings.prior_s = f64::NAN),
            ("temperature_range", |settings| settings.temperature_range = [2.0, 1.0]),
            ("fewest_windows", |settings| settings.fewest_windows = 1),
        ];
        for (name, change) in cases {
            let mut settings = MethodSettings::default();
            change(&mut settings);
            let message = settings.check().expect_err(name).to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
