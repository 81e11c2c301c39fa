//! What no single key can tell: ranges, and whether the settings fit each other.

use tendon_transport::Delivery;

use crate::{Backend, Config, ConfigError, Source};

/// Longest block: the stages act upon nothing older.
const LONGEST_BLOCK_MS: f64 = 100.0;

/// Most channels a session may have; beyond it a header is more likely damaged than meant.
const MAXIMUM_CHANNELS: usize = 1024;

impl Config {
    /// Checks what no single key can tell: ranges, and whether the settings fit each other.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Value`] or [`ConfigError::Section`] for the first that does not.
    pub fn check(&self) -> Result<(), ConfigError> {
        let acquisition = &self.acquisition;
        let value = |key, value: String, remedy: &str| {
            Err(ConfigError::Value { key, value, remedy: remedy.to_owned() })
        };
        if !(1..=MAXIMUM_CHANNELS).contains(&acquisition.channels) {
            return value(
                "acquisition.channels",
                acquisition.channels.to_string(),
                "take 1 to 1024 channels",
            );
        }
        if !(100.0..=100_000.0).contains(&acquisition.sample_rate_hz) {
            return value(
                "acquisition.sample_rate_hz",
                acquisition.sample_rate_hz.to_string(),
                "take 100 to 100000 Hz",
            );
        }
        if !(1..=100_000).contains(&acquisition.block_samples) {
            return value(
                "acquisition.block_samples",
                acquisition.block_samples.to_string(),
                "take 1 to 100000 samples",
            );
        }
        let duration_ms = |samples: usize| samples as f64 * 1e3 / acquisition.sample_rate_hz;
        if duration_ms(acquisition.block_samples) > LONGEST_BLOCK_MS {
            return value(
                "acquisition.block_samples",
                acquisition.block_samples.to_string(),
                "such a block is longer than 100 ms, and its first samples are too old to act upon when it comes: \
                 take 5 to 20 ms",
            );
        }
        if duration_ms(self.dsp.windows.increment_samples) >= self.robot.arm.watchdog_ms as f64 {
            return value(
                "dsp.windows.increment_samples",
                self.dsp.windows.increment_samples.to_string(),
                &format!(
                    "the arm stops {} ms after a command (robot.arm.watchdog_ms), before the next one comes: take a \
                     smaller increment, such as half of that",
                    self.robot.arm.watchdog_ms
                ),
            );
        }
        if acquisition.source == Source::Device && acquisition.program.is_none() {
            return value(
                "acquisition.program",
                "(none)".to_owned(),
                "name the program that reads the device: acquisition.source is \"device\"",
            );
        }
        let jitter_ms = acquisition.simulate.jitter_ms;
        if !(0.0..=1000.0).contains(&jitter_ms) {
            return value("acquisition.simulate.jitter_ms", jitter_ms.to_string(), "take 0 to 1000 ms");
        }
        if acquisition.source == Source::Replay {
            if acquisition.replay.path.is_none() {
                return value(
                    "acquisition.replay.path",
                    "(none)".to_owned(),
                    "name the recording, or use --replay PATH",
                );
            }
            let chosen = acquisition.replay.channels.as_ref().map_or(acquisition.channels, Vec::len);
            if chosen != acquisition.channels {
                return value(
                    "acquisition.replay.channels",
                    format!("{chosen} channels"),
                    &format!("name as many as acquisition.channels says: {}", acquisition.channels),
                );
            }
        }
        let invalid = |section, error: &dyn std::fmt::Display| ConfigError::Section {
            section,
            reason: error.to_string(),
        };
        tendon_signal::SignalChain::new(&self.dsp, acquisition.channels, acquisition.sample_rate_hz)
            .map_err(|error| invalid("dsp", &error))?;
        self.decision.check().map_err(|error| invalid("decision", &error))?;
        if self.robot.backend == Backend::XArm {
            if self.robot.xarm.address.is_none() {
                return value(
                    "robot.xarm.address",
                    "(none)".to_owned(),
                    "give the address of the arm's control box, or 127.0.0.1 for xarm-emulator",
                );
            }
            if self.delivery() == Delivery::Lossless {
                return value(
                    "acquisition.replay.pace",
                    "full".to_owned(),
                    "a real arm takes its time: replay at the true pace, or set robot.backend = \"simulate\"",
                );
            }
        }
        let start_speed = self.robot.xarm.start_speed_deg_per_s;
        if !(0.1..=45.0).contains(&start_speed) {
            return value(
                "robot.xarm.start_speed_deg_per_s",
                start_speed.to_string(),
                "take 0.1 to 45 degrees/s",
            );
        }
        self.robot.arm.check().map_err(|error| invalid("robot.arm", &error))?;
        self.task.check().map_err(|error| invalid("task", &error))
    }
}

#[cfg(test)]
mod tests {
    use tendon_recordings::Channel;

    use super::*;

    #[test]
    fn settings_that_do_not_fit_each_other_are_refused() {
        let mut config = Config::default();
        config.acquisition.source = Source::Replay;
        assert!(config.check().unwrap_err().to_string().contains("--replay PATH"));
        config.acquisition.replay.path = Some("x".into());
        config.acquisition.replay.channels = Some(vec![Channel::Index(0)]);
        assert!(config.check().unwrap_err().to_string().contains("as many as acquisition.channels"));
    }

    #[test]
    fn a_block_too_long_to_act_upon_and_an_increment_beyond_the_watchdog_are_refused() {
        let refused = |change: fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert!(refused(|config| config.acquisition.block_samples = 201).contains("longer than 100 ms"));
        let error = refused(|config| config.dsp.windows.increment_samples = 300);
        assert!(error.contains("robot.arm.watchdog_ms"), "{error}");
        let error = refused(|config| config.acquisition.source = Source::Device);
        assert!(error.contains("acquisition.program"), "{error}");
    }
}
