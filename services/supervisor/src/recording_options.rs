//! How recordings are read: options that many commands have.

use anyhow::ensure;
use clap::Args;
use tendon_dataset::DatasetSettings;
use tendon_recordings::Channel;
use tendon_signal::{canonical_unit, known_units};

/// How recordings are read: the same options for every command that reads some.
#[derive(Clone, Debug, Default, Args)]
pub struct RecordingOptions {
    /// Channels of the recordings in this order, by number from 0 or by the name that the recordings give them [default: those
    /// that the model or person names; else all of what Tendon recorded, of your own recordings the first that look like EMG, of
    /// 3DC 0,3,5,8, of Ozdemir 2022 0,1,2,3].
    #[arg(long, value_name = "C,…", value_delimiter = ',', value_parser = named_channel)]
    pub channels: Vec<Channel>,
    /// Sampling rate of recordings that do not state it, Hz.
    #[arg(long, value_name = "HZ", alias = "replay-rate-hz")]
    pub recording_rate_hz: Option<f64>,
    /// Column of tables that says what was done, by name or by number from 0; each run of a label is a trial [default: labels.csv;
    /// to replay, a column of a name such as gesture or label].
    #[arg(long, value_name = "COLUMN", value_parser = named_channel)]
    pub label_column: Option<Channel>,
    /// Unit of recordings that do not state it: V, mV, uV, nV or adc_counts.
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    pub unit: Option<String>,
}

impl RecordingOptions {
    /// The first of these options that was given.
    pub fn given(&self) -> Option<&'static str> {
        let given = [
            ("--channels", !self.channels.is_empty()),
            ("--recording-rate-hz", self.recording_rate_hz.is_some()),
            ("--label-column", self.label_column.is_some()),
            ("--unit", self.unit.is_some()),
        ];
        given.into_iter().find_map(|(option, is_given)| is_given.then_some(option))
    }

    /// `settings` for recordings that are read as these options say; but for the channels.
    pub fn settings(&self, settings: DatasetSettings) -> DatasetSettings {
        let RecordingOptions { recording_rate_hz, label_column, .. } = self.clone();
        DatasetSettings { recording_rate_hz, label_column, ..settings }
    }

    /// The unit of recordings that state `own`, in its canonical spelling; empty if nobody knows.
    ///
    /// # Errors
    ///
    /// The option says another one.
    pub fn unit_of(&self, own: &str) -> anyhow::Result<String> {
        let own = canonical_unit(own);
        let Some(unit) = &self.unit else { return Ok(own.to_owned()) };
        ensure!(
            own.is_empty() || own == unit,
            "--unit {unit}: the recordings say that they are in {own}: leave --unit out"
        );
        Ok(unit.clone())
    }
}

/// A unit of samples, in its canonical spelling.
///
/// # Errors
///
/// When it is none.
pub fn unit(text: &str) -> anyhow::Result<String> {
    let canonical = canonical_unit(text);
    let known: Vec<&str> = known_units().collect();
    ensure!(known.contains(&canonical), "take one of {}", known.join(", "));
    Ok(canonical.to_owned())
}

/// A channel by number, or by the name that the header of a table gives it.
///
/// # Errors
///
/// When there is nothing.
pub fn named_channel(text: &str) -> anyhow::Result<Channel> {
    let text = text.trim();
    ensure!(!text.is_empty(), "name each channel, or give its number, from 0");
    Ok(text.parse().map_or_else(|_| Channel::from(text), Channel::Index))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_that_of_the_recordings_or_of_the_option() {
        let given = RecordingOptions { unit: Some("mV".to_owned()), ..RecordingOptions::default() };
        assert_eq!(RecordingOptions::default().unit_of("microvolts").unwrap(), "uV");
        assert_eq!((given.unit_of("").unwrap(), given.unit_of("mV").unwrap()), ("mV".into(), "mV".into()));
        assert!(given.unit_of("uV").unwrap_err().to_string().contains("leave --unit out"));
        assert_eq!((given.given(), RecordingOptions::default().given()), (Some("--unit"), None));
    }

    #[test]
    fn a_unit_is_kept_in_one_spelling_and_a_named_channel_may_have_a_number() {
        assert_eq!(unit("microvolts").unwrap(), "uV");
        assert_eq!(unit("ADC counts").unwrap(), "adc_counts");
        assert_eq!(unit("furlongs").unwrap_err().to_string(), "take one of V, mV, uV, nV, adc_counts");
        assert_eq!(named_channel(" 3 ").unwrap(), Channel::Index(3));
        assert_eq!(named_channel("flexor").unwrap(), Channel::from("flexor"));
        named_channel("").unwrap_err();
    }
}
