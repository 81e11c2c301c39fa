//! The settings of the acquisition stage, and the sources that they name, opened.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_daqmx::NidaqmxSettings;
use tendon_delsys::DelsysSettings;
use tendon_emg_simulation::{ContractionSettings, DEFAULT_SCRIPT, Profile, SimulatedEmg, SimulationSettings};
use tendon_lsl::LslSettings;
use tendon_otb::OtbSettings;
use tendon_recordings::three_dc::is_three_dc;
use tendon_recordings::{
    Channel, RecordingError, RecordingSettings, RecordingSource, ReplayStream, Summary, first_muscles,
};
use tendon_stream::StreamSettings;

use crate::ConfigError;

/// Channels of the 3DC armband that take the place of the paper's four electrodes.
const MODEL_CHANNELS_OF_THREE_DC: [usize; 4] = [0, 3, 5, 8];

/// Where samples come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The simulated amplifier.
    Simulate,
    /// A recording.
    Replay,
    /// A stream of the Lab Streaming Layer.
    Lsl,
    /// An NI device, through NI-DAQmx.
    Nidaqmx,
    /// An amplifier of OT Bioelettronica.
    Otb,
    /// Delsys Trigno, over the vendor's server.
    Delsys,
    /// Any program that sends samples over TCP.
    Stream,
    /// A device, which the program `acquisition.program` reads.
    Device,
}

impl Source {
    /// The name as the settings and the report spell it.
    pub fn name(self) -> &'static str {
        match self {
            Source::Simulate => "simulate",
            Source::Replay => "replay",
            Source::Lsl => "lsl",
            Source::Nidaqmx => "nidaqmx",
            Source::Otb => "otb",
            Source::Delsys => "delsys",
            Source::Stream => "stream",
            Source::Device => "device",
        }
    }

    /// The program that acquires from it, which lies beside `tendon`; `None` for a device, whose program
    /// `acquisition.program` names.
    pub fn program(self) -> Option<&'static str> {
        match self {
            Source::Simulate | Source::Replay => Some("tendon-acquisition"),
            Source::Lsl => Some("tendon-acquire-lsl"),
            Source::Nidaqmx => Some("tendon-acquire-daqmx"),
            Source::Otb => Some("tendon-acquire-otb"),
            Source::Delsys => Some("tendon-acquire-delsys"),
            Source::Stream => Some("tendon-acquire-stream"),
            Source::Device => None,
        }
    }

    /// Whether it is an amplifier, and not one that is simulated or recorded.
    pub fn is_amplifier(self) -> bool {
        !matches!(self, Source::Simulate | Source::Replay)
    }
}

/// Settings of the acquisition stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcquisitionSettings {
    /// Where samples come from.
    pub source: Source,
    /// The program that acquires; when left out, the one that comes with Tendon for the source.
    pub program: Option<PathBuf>,
    /// Number of channels.
    pub channels: usize,
    /// Sampling rate of the session in Hz; a recording of another rate is resampled.
    pub sample_rate_hz: f64,
    /// Samples of each channel in a block. 10 at 2000 Hz are 5 ms.
    pub block_samples: usize,
    /// Which channels of an amplifier, by number from 0 or by name; when left out, its first EMG channels.
    pub channel_selection: Option<Vec<Channel>>,
    /// Unit of an amplifier's samples, to which it converts (V, mV, uV, nV); when left out, the one in which they come.
    pub unit: Option<String>,
    /// The simulated amplifier.
    pub simulate: SimulateSettings,
    /// The recording to replay.
    pub replay: ReplaySettings,
    /// The stream of the Lab Streaming Layer.
    pub lsl: LslSettings,
    /// The NI device.
    pub nidaqmx: NidaqmxSettings,
    /// The amplifier of OT Bioelettronica.
    pub otb: OtbSettings,
    /// The server of Delsys Trigno.
    pub delsys: DelsysSettings,
    /// Where programs that send samples connect.
    pub stream: StreamSettings,
}

impl Default for AcquisitionSettings {
    fn default() -> Self {
        AcquisitionSettings {
            source: Source::Simulate,
            program: None,
            channels: 4,
            sample_rate_hz: 2000.0,
            block_samples: 10,
            channel_selection: None,
            unit: None,
            simulate: SimulateSettings::default(),
            replay: ReplaySettings::default(),
            lsl: LslSettings::default(),
            nidaqmx: NidaqmxSettings::default(),
            otb: OtbSettings::default(),
            delsys: DelsysSettings::default(),
            stream: StreamSettings::default(),
        }
    }
}

/// Who decides which gesture the simulated person makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gestures {
    /// `script`, repeated.
    Script,
    /// A random sequence, set by `seed`.
    Random,
    /// The keys pressed in `tendon run`.
    Keyboard,
}

/// Settings of the simulated amplifier. Amplitudes are in the profile's unit (ADC counts in the default one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulateSettings {
    /// Who decides which gesture is made.
    pub gestures: Gestures,
    /// Gestures and how long each is held: `rest 6s, extension 2s, …`. Rest comes first: the threshold
    /// strategy calibrates on its first seconds.
    pub script: String,
    /// The same seed gives the same samples.
    pub seed: u64,
    /// A profile made by `tendon profile fit`, or the name of one that comes with Tendon, such as `stranger-19`; without
    /// one, somebody whom the shipped models know.
    pub profile: Option<PathBuf>,
    /// From rest to full contraction, ms.
    pub rise_ms: f64,
    /// From full contraction to rest, ms.
    pub fall_ms: f64,
    /// Frequency of the mains hum, Hz.
    pub mains_hz: f64,
    /// Peak amplitude of the mains hum; 0 for none.
    pub mains_amplitude: f32,
    /// Frequency of the baseline wander, Hz.
    pub wander_hz: f64,
    /// Peak amplitude of the baseline wander; 0 for none.
    pub wander_amplitude: f32,
    /// Constant offset of the amplifier.
    pub offset: f32,
    /// How often per minute, on average, one channel goes flat; 0 for never.
    pub dropouts_per_minute: f64,
    /// How long a channel stays flat, ms.
    pub dropout_ms: f64,
    /// Samples are limited to ± this value; none when left out.
    pub clip_at: Option<f32>,
    /// Blocks come up to this much later than they are due, at random, ms.
    pub jitter_ms: f64,
}

impl Default for SimulateSettings {
    fn default() -> Self {
        let simulation = SimulationSettings::default();
        let contraction = ContractionSettings::default();
        SimulateSettings {
            gestures: Gestures::Script,
            script: DEFAULT_SCRIPT.to_owned(),
            seed: simulation.seed,
            profile: None,
            rise_ms: contraction.rise_ms,
            fall_ms: contraction.fall_ms,
            mains_hz: simulation.mains_hz,
            mains_amplitude: simulation.mains_amplitude,
            wander_hz: simulation.wander_hz,
            wander_amplitude: simulation.wander_amplitude,
            offset: simulation.offset,
            dropouts_per_minute: simulation.dropouts_per_minute,
            dropout_ms: simulation.dropout_ms,
            clip_at: simulation.clip_at,
            jitter_ms: 0.0,
        }
    }
}

/// How fast a recording is replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Pace {
    /// As fast as it was recorded. The newest messages are kept, and what a slow stage misses is counted.
    True,
    /// As fast as the stages can. The source waits for every message, so the result is the same every time.
    Full,
}

/// Which recording is replayed, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplaySettings {
    /// A folder of the 3DC layout, one of its files, a plain table (CSV), or an EDF, BDF or XDF file.
    pub path: Option<PathBuf>,
    /// Which channels of the recording, by number from 0 or by column name. When left out: of a 3DC recording,
    /// the four that the models were trained on; of a table, its first columns that are muscles.
    pub channels: Option<Vec<Channel>>,
    /// Sampling rate of a plain table, Hz.
    pub sample_rate_hz: Option<f64>,
    /// The column of a plain table that says what was done, by number from 0 or by name; without it, one of a name such as `gesture`
    /// or `label`.
    pub label_column: Option<Channel>,
    /// Only this repetition of a 3DC folder; without it, all in order.
    pub repetition: Option<u32>,
    /// How fast.
    pub pace: Pace,
}

impl Default for ReplaySettings {
    fn default() -> Self {
        ReplaySettings {
            path: None,
            channels: None,
            sample_rate_hz: None,
            label_column: None,
            repetition: None,
            pace: Pace::True,
        }
    }
}

impl SimulateSettings {
    /// What the simulated amplifier needs to know.
    pub fn simulation(&self, channels: usize, sample_rate_hz: f64) -> SimulationSettings {
        SimulationSettings {
            channels,
            sample_rate_hz,
            seed: self.seed,
            mains_hz: self.mains_hz,
            mains_amplitude: self.mains_amplitude,
            wander_hz: self.wander_hz,
            wander_amplitude: self.wander_amplitude,
            offset: self.offset,
            dropouts_per_minute: self.dropouts_per_minute,
            dropout_ms: self.dropout_ms,
            clip_at: self.clip_at,
        }
    }

    /// How fast contractions come and go.
    pub fn contraction(&self) -> ContractionSettings {
        ContractionSettings { rise_ms: self.rise_ms, fall_ms: self.fall_ms }
    }

    /// The profile of the simulated person.
    ///
    /// # Errors
    ///
    /// [`ConfigError::ReadProfile`] and [`ConfigError::Profile`].
    pub fn read_profile(&self) -> Result<Profile, ConfigError> {
        let Some(path) = &self.profile else { return Ok(Profile::default()) };
        if let Some(stranger) = path.to_str().and_then(Profile::of_stranger) {
            return Ok(stranger);
        }
        let text = tendon_input::read_text(path, tendon_input::LARGEST_SETTINGS)
            .map_err(|source| ConfigError::ReadProfile { path: path.clone(), source })?;
        Profile::from_toml(&text).map_err(|source| ConfigError::Profile { path: path.clone(), source })
    }
}

impl AcquisitionSettings {
    /// Makes the simulated amplifier, and gives the profile of its person.
    ///
    /// # Errors
    ///
    /// [`ConfigError::ReadProfile`], [`ConfigError::Profile`] and [`ConfigError::Simulation`].
    pub fn open_simulation(&self) -> Result<(SimulatedEmg, Profile), ConfigError> {
        let profile = self.simulate.read_profile()?;
        let settings = self.simulate.simulation(self.channels, self.sample_rate_hz);
        let emg = SimulatedEmg::new(&profile, &settings)?;
        Ok((emg, profile))
    }

    /// Refuses what cannot be the recording to replay by a look at its beginning, however large it is.
    ///
    /// # Errors
    ///
    /// As [`AcquisitionSettings::open_recording`].
    pub fn check_recording(&self) -> Result<(), ConfigError> {
        let path = self.replay.path.as_deref().unwrap_or(Path::new(""));
        let recording = self.replay.recording(self.channels);
        let opened = recording.and_then(|recording| RecordingSource::open(path, &recording));
        opened.map(drop).map_err(|error| self.recording_error(error))
    }

    /// The unit that the recording to replay states; empty if it states none or cannot be read.
    pub fn recording_unit(&self) -> String {
        let path = self.replay.path.as_deref().unwrap_or(Path::new(""));
        let recording = self.replay.recording(self.channels);
        let opened = recording.and_then(|recording| RecordingSource::open(path, &recording));
        opened.map_or_else(|_| String::new(), |source| source.unit().to_owned())
    }

    /// Opens the recording to replay, once it has been read through, so that a bad one is refused before anything moves.
    ///
    /// # Errors
    ///
    /// [`ConfigError::SampleRateMissing`], [`ConfigError::MissingChannel`] and [`ConfigError::Recording`].
    pub fn open_recording(&self) -> Result<(Summary, ReplayStream), ConfigError> {
        let path = self.replay.path.as_deref().unwrap_or(Path::new(""));
        let recording = self.replay.recording(self.channels).map_err(|error| self.recording_error(error))?;
        let checked = tendon_recordings::check(path, &recording);
        let summary = checked.map_err(|error| self.recording_error(error))?;
        let stream = ReplayStream::open(path, &recording, self.sample_rate_hz, self.block_samples)?;
        Ok((summary, stream))
    }

    /// What is wrong with the recording, in the words of a session.
    fn recording_error(&self, error: RecordingError) -> ConfigError {
        match error {
            RecordingError::SampleRateMissing { file } => ConfigError::SampleRateMissing { path: file },
            error if error.is_missing_channel() && self.replay.channels.is_none() => {
                ConfigError::MissingChannel { error, channels: self.channels }
            }
            error => ConfigError::Recording(error),
        }
    }
}

impl ReplaySettings {
    /// How the recording is read for a session of so many channels.
    ///
    /// # Errors
    ///
    /// When the channels are not named and the recording cannot be opened, or has too few that are muscles.
    pub fn recording(&self, channels: usize) -> Result<RecordingSettings, RecordingError> {
        let path = self.path.as_deref().unwrap_or(Path::new(""));
        let channels = match &self.channels {
            Some(channels) => channels.clone(),
            None if !is_three_dc(path) => first_muscles(path, channels, self.label_column.as_ref())?,
            None if channels == MODEL_CHANNELS_OF_THREE_DC.len() => {
                MODEL_CHANNELS_OF_THREE_DC.map(Channel::Index).to_vec()
            }
            None => (0..channels).map(Channel::Index).collect(),
        };
        Ok(RecordingSettings {
            channels,
            sample_rate_hz: self.sample_rate_hz,
            repetition: self.repetition,
            label_column: self.label_column.clone(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_without_a_rate_is_refused_in_the_words_of_a_session() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("emg.csv");
        std::fs::write(&path, "time,flexor,extensor,thumb,ulna\n0,1,2,3,4\n1,2,3,4,5\n").unwrap();
        let mut acquisition = AcquisitionSettings::default();
        acquisition.replay.path = Some(path);
        let error = acquisition.open_recording().unwrap_err().to_string();
        assert!(error.contains("--recording-rate-hz 1000, or acquisition.replay.sample_rate_hz"), "{error}");
        acquisition.replay.sample_rate_hz = Some(1000.0);
        let (summary, _) = acquisition.open_recording().unwrap();
        assert_eq!(summary.channels, ["flexor", "extensor", "thumb", "ulna"]);
    }

    #[test]
    fn a_recording_with_fewer_channels_than_the_session_says_what_to_set() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("emg.csv");
        std::fs::write(&path, "1,2,3\n2,3,4\n").unwrap();
        let replay = ReplaySettings { path: Some(path), sample_rate_hz: Some(1000.0), ..Default::default() };
        let mut acquisition = AcquisitionSettings { replay, ..Default::default() };
        for refused in [acquisition.open_recording().map(drop), acquisition.check_recording()] {
            let error = refused.unwrap_err().to_string();
            assert!(error.contains("there is no channel 3: the file has 3 (channels 0 to 2)"), "{error}");
            assert!(error.contains("acquisition.channels is 4: set it"), "{error}");
        }
        // Whoever named it needs no such advice.
        acquisition.replay.channels = Some([0, 1, 2, 7].map(Channel::Index).to_vec());
        let error = acquisition.open_recording().unwrap_err().to_string();
        assert!(
            error.ends_with("there is no channel 7: the file has 3 (channels 0 to 2); choose among them"),
            "{error}"
        );
    }

    #[test]
    fn a_table_gives_its_first_muscles_and_a_3dc_recording_the_models_channels() {
        let channels = |path: &str| {
            let replay = ReplaySettings { path: Some(path.into()), ..ReplaySettings::default() };
            replay.recording(4).unwrap().channels
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("emg.csv");
        std::fs::write(&path, "Time,a,b,c,gesture,d\n0,1,2,3,0,5\n").unwrap();
        assert_eq!(channels(path.to_str().unwrap()), ["a", "b", "c", "d"].map(Channel::from));
        assert_eq!(channels("EMG/3dc_EMG_gesture_0_1.txt"), [0, 3, 5, 8].map(Channel::Index));
    }

    #[test]
    fn the_unit_of_a_recording_is_the_one_that_it_states() {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/tests/golden/delsys.bdf");
        let replay = ReplaySettings { path: Some(golden), ..ReplaySettings::default() };
        let mut acquisition = AcquisitionSettings { replay, channels: 2, ..AcquisitionSettings::default() };
        assert_eq!(acquisition.recording_unit(), "uV");
        acquisition.replay.path = Some("nowhere.bdf".into());
        assert_eq!(acquisition.recording_unit(), "");
    }

    #[test]
    fn names_are_those_of_the_settings_file() {
        for source in [
            Source::Simulate,
            Source::Replay,
            Source::Lsl,
            Source::Nidaqmx,
            Source::Otb,
            Source::Delsys,
            Source::Stream,
            Source::Device,
        ] {
            assert_eq!(toml::Value::try_from(source).unwrap().as_str(), Some(source.name()));
        }
    }
}
