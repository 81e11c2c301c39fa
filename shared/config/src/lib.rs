//! The settings of a session: `tendon.toml`.
//!
//! Every key has a default (the paper's, where it names one), so an empty file is a valid one; an unknown
//! key is an error that names the nearest known one. Paths are relative to the file's folder.
#![forbid(unsafe_code)]

use std::net::IpAddr;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_arm::ArmSettings;
use tendon_emg_simulation::{ContractionSettings, DEFAULT_SCRIPT, SimulationSettings};
use tendon_gesture::DecisionSettings;
use tendon_recordings::{Channel, RecordingSettings};
use tendon_signal::SignalSettings;
use tendon_transport::{Delivery, SessionName};
use tendon_zones::TaskSettings;

/// All settings of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The session's name; two sessions on one machine need two names.
    pub session: SessionName,
    /// Where samples come from.
    pub acquisition: AcquisitionSettings,
    /// Filters, activity detection and windows.
    pub dsp: SignalSettings,
    /// The classifier.
    pub inference: InferenceSettings,
    /// Strategy, vote, gripper and speed.
    pub decision: DecisionSettings,
    /// The arm.
    pub robot: RobotSettings,
    /// The target-zone task of `tendon run --task`.
    pub task: TaskSettings,
    /// What is asked of the kernel's scheduler.
    pub scheduling: SchedulingSettings,
}

impl Default for Config {
    fn default() -> Self {
        Config {
            session: "tendon".parse().expect("the name is made of letters only"),
            acquisition: AcquisitionSettings::default(),
            dsp: SignalSettings::default(),
            inference: InferenceSettings::default(),
            decision: DecisionSettings::default(),
            robot: RobotSettings::default(),
            task: TaskSettings::default(),
            scheduling: SchedulingSettings::default(),
        }
    }
}

/// Where samples come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The simulated DAQ.
    Simulate,
    /// A recording.
    Replay,
}

/// Settings of the acquisition stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcquisitionSettings {
    /// Where samples come from.
    pub source: Source,
    /// Number of channels.
    pub channels: usize,
    /// Sampling rate of the session in Hz; a recording of another rate is resampled.
    pub sample_rate_hz: f64,
    /// Samples of each channel in a block. 10 at 2000 Hz are 5 ms.
    pub block_samples: usize,
    /// The simulated DAQ.
    pub simulate: SimulateSettings,
    /// The recording to replay.
    pub replay: ReplaySettings,
}

impl Default for AcquisitionSettings {
    fn default() -> Self {
        AcquisitionSettings {
            source: Source::Simulate,
            channels: 4,
            sample_rate_hz: 2000.0,
            block_samples: 10,
            simulate: SimulateSettings::default(),
            replay: ReplaySettings::default(),
        }
    }
}

/// Who says which gesture the simulated person makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gestures {
    /// `script`, over and over.
    Script,
    /// A random sequence, set by `seed`.
    Random,
    /// The keys pressed in `tendon run`.
    Keyboard,
}

/// Settings of the simulated DAQ. Amplitudes are in the profile's unit (ADC counts in the default one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulateSettings {
    /// Who says which gesture is made.
    pub gestures: Gestures,
    /// Gestures and how long each is held: `rest 6s, extension 2s, …`. Rest comes first: the threshold
    /// strategy calibrates on its first seconds.
    pub script: String,
    /// The same seed gives the same samples.
    pub seed: u64,
    /// A profile made by `tendon profile fit`; without one, the profile that comes with Tendon.
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
    /// How often a minute, on average, one channel goes flat; 0 for never.
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// As fast as it was recorded. The newest messages are kept; what a slow stage misses is counted.
    True,
    /// As fast as the stages can. Every message is waited for, so the outcome is the same every time.
    Full,
}

/// Which recording is replayed, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplaySettings {
    /// A folder of the 3DC layout, one of its files, or a plain table (CSV).
    pub path: Option<PathBuf>,
    /// Which channels of the recording, by number from 0 or by column name. When left out: of a 3DC recording,
    /// the four that the models were trained on; of a table, its first columns.
    pub channels: Option<Vec<Channel>>,
    /// Sampling rate of a plain table, Hz.
    pub sample_rate_hz: Option<f64>,
    /// Of a 3DC folder, only this repetition; all in order when left out.
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
            repetition: None,
            pace: Pace::True,
        }
    }
}

/// Settings of the inference stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InferenceSettings {
    /// The ONNX model of the gestures; when left out, the one that comes with Tendon for the decision's strategy.
    pub model: Option<PathBuf>,
    /// The ONNX model of the two-stage strategy's first stage, rest or move; when left out, the one that comes with
    /// Tendon.
    pub rest_move_model: Option<PathBuf>,
    /// ONNX Runtime's shared library; when left out, `ORT_DYLIB_PATH`, then what
    /// `scripts/fetch-onnxruntime` put beside the programs.
    pub runtime_library: Option<PathBuf>,
}

/// What moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// A kinematic simulation of the xArm7.
    Simulate,
    /// An xArm7 on the network, or `xarm-emulator`.
    #[serde(rename = "xarm")]
    XArm,
}

/// Where the xArm7 is, and how it gets to its start position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct XArmSettings {
    /// Address of its control box; 127.0.0.1 for the emulator on this machine.
    pub address: Option<IpAddr>,
    /// Port of the control connection.
    pub control_port: u16,
    /// Port of the reports that carry errors.
    pub normal_report_port: u16,
    /// Port of the real-time reports.
    pub real_time_report_port: u16,
    /// Whether it has a gripper.
    pub gripper: bool,
    /// Greatest speed of a joint on the way to the start position, degrees/s.
    pub start_speed_deg_per_s: f64,
}

impl Default for XArmSettings {
    fn default() -> Self {
        XArmSettings {
            address: None,
            control_port: 502,
            normal_report_port: 30001,
            real_time_report_port: 30003,
            gripper: true,
            start_speed_deg_per_s: 10.0,
        }
    }
}

/// Settings of the robot stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotSettings {
    /// What moves.
    pub backend: Backend,
    /// Limits, start position and watchdog.
    pub arm: ArmSettings,
    /// The arm on the network.
    pub xarm: XArmSettings,
}

impl Default for RobotSettings {
    fn default() -> Self {
        RobotSettings {
            backend: Backend::Simulate,
            arm: ArmSettings::default(),
            xarm: XArmSettings::default(),
        }
    }
}

/// Whether real-time scheduling is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Realtime {
    /// Where the rights allow it.
    Auto,
    /// Or the session does not start.
    On,
    /// Never.
    Off,
}

/// What is asked of the kernel's scheduler.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SchedulingSettings {
    /// Whether real-time scheduling is used.
    pub realtime: Realtime,
    /// Keep all stages on one core: a hand-over then never waits for a sleeping core to wake.
    pub one_core: bool,
}

impl Default for SchedulingSettings {
    fn default() -> Self {
        SchedulingSettings { realtime: Realtime::Auto, one_core: true }
    }
}

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{}: cannot read the configuration: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file is not what it has to be.
    #[error("{}: {message}{suggestion}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        message: String,
        /// The nearest known key, as a sentence; empty when there is none.
        suggestion: String,
    },
    /// Values of a section cannot work.
    #[error("[{section}] {reason}")]
    Section {
        /// Name of the section.
        section: &'static str,
        /// Which key, and what to do.
        reason: String,
    },
    /// A value cannot work.
    #[error("{key} = {value}: {remedy}")]
    Value {
        /// Key of the setting.
        key: &'static str,
        /// Its value.
        value: String,
        /// What to do.
        remedy: String,
    },
}

/// Channels of the 3DC armband that stand for the paper's four electrodes.
const MODEL_CHANNELS_OF_THREE_DC: [usize; 4] = [0, 3, 5, 8];

/// Most channels a session may have; beyond it a header is more likely damaged than meant.
const MAXIMUM_CHANNELS: usize = 1024;

impl Config {
    /// Reads the configuration at `path`. Relative paths in it become absolute, from its folder.
    ///
    /// # Errors
    ///
    /// [`ConfigError`], naming file, line and key.
    pub fn read(path: &Path) -> Result<Config, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let mut config = Config::parse(&text, path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for setting in [
            &mut config.acquisition.simulate.profile,
            &mut config.acquisition.replay.path,
            &mut config.inference.model,
            &mut config.inference.rest_move_model,
            &mut config.inference.runtime_library,
        ] {
            if let Some(value) = setting.as_mut() {
                *value = folder.join(&value);
            }
        }
        Ok(config)
    }

    /// The configuration with one key changed, given as on the command line: `acquisition.channels=8`. What
    /// is no TOML value is taken as text.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Parse`] when there is no such key or the value does not fit it.
    pub fn with(&self, assignment: &str) -> Result<Config, ConfigError> {
        let origin = PathBuf::from(format!("--set {assignment}"));
        let no_assignment = || ConfigError::Parse {
            path: origin.clone(),
            message: "write KEY=VALUE, such as acquisition.channels=8".to_owned(),
            suggestion: String::new(),
        };
        let (key, value) = assignment.split_once('=').ok_or_else(no_assignment)?;
        let value = format!("value = {value}")
            .parse::<toml::Table>()
            .ok()
            .and_then(|mut table| table.remove("value"))
            .unwrap_or_else(|| toml::Value::String(value.to_owned()));
        let mut root =
            toml::Table::try_from(self).expect("a configuration has only what TOML can say: tested");
        let mut table = &mut root;
        let mut keys = key.trim().split('.').peekable();
        while let Some(key) = keys.next() {
            if keys.peek().is_none() {
                table.insert(key.to_owned(), value);
                break;
            }
            table = table
                .entry(key)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                .as_table_mut()
                .ok_or_else(no_assignment)?;
        }
        Config::parse(&toml::to_string(&root).map_err(|_| no_assignment())?, &origin)
    }

    /// Reads a configuration from `text`; `path` is only for messages.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Parse`].
    pub fn parse(text: &str, path: &Path) -> Result<Config, ConfigError> {
        toml::from_str(text).map_err(|error| {
            let message = error.to_string();
            ConfigError::Parse { path: path.to_owned(), suggestion: suggestion(&message), message }
        })
    }

    /// The configuration as the text of a `tendon.toml`.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a configuration has only what TOML can say: tested")
    }

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
        if self.robot.backend == Backend::XArm {
            self.robot.arm.check_for_real_arm().map_err(|error| invalid("robot.arm", &error))?;
        }
        // Commands come once an increment; a shorter watchdog stops the arm between any two of them.
        let increment_ms = self.dsp.windows.increment_samples as f64 * 1e3 / acquisition.sample_rate_hz;
        if self.robot.arm.watchdog_ms as f64 <= increment_ms {
            return value(
                "robot.arm.watchdog_ms",
                self.robot.arm.watchdog_ms.to_string(),
                &format!(
                    "take more than the {increment_ms:.0} ms from one window to the next \
                     (dsp.windows.increment_samples), best twice as much: else the arm never moves"
                ),
            );
        }
        self.task.check().map_err(|error| invalid("task", &error))
    }

    /// Whether messages are waited for or the newest are kept.
    pub fn delivery(&self) -> Delivery {
        match (self.acquisition.source, self.acquisition.replay.pace) {
            (Source::Replay, Pace::Full) => Delivery::Lossless,
            _ => Delivery::Live,
        }
    }

    /// Samples of all channels in a block.
    pub fn block_length(&self) -> usize {
        self.acquisition.channels * self.acquisition.block_samples
    }

    /// Samples of all channels in a window.
    pub fn window_length(&self) -> usize {
        self.acquisition.channels * self.dsp.windows.window_samples
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
}

impl ReplaySettings {
    /// How the recording is read for a session of so many channels.
    pub fn recording(&self, channels: usize) -> RecordingSettings {
        let is_three_dc = self.path.as_deref().is_some_and(tendon_recordings::three_dc::is_three_dc);
        let default = || match channels {
            4 if is_three_dc => MODEL_CHANNELS_OF_THREE_DC.map(Channel::Index).to_vec(),
            _ => (0..channels).map(Channel::Index).collect(),
        };
        RecordingSettings {
            channels: self.channels.clone().unwrap_or_else(default),
            sample_rate_hz: self.sample_rate_hz,
            repetition: self.repetition,
        }
    }
}

/// A sentence naming the known key or value nearest to the unknown one that `message` complains of. serde
/// lists the known ones in backticks after the unknown one.
fn suggestion(message: &str) -> String {
    let Some(start) = message.find("unknown field").or_else(|| message.find("unknown variant")) else {
        return String::new();
    };
    let mut names = message[start..].split('`').skip(1).step_by(2);
    let Some(unknown) = names.next() else {
        return String::new();
    };
    names
        .map(|known| (strsim::damerau_levenshtein(unknown, known), known))
        .min()
        .filter(|(distance, known)| *distance <= 2.max(known.len() / 3))
        .map_or_else(String::new, |(_, known)| format!("did you mean `{known}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Config, String> {
        Config::parse(text, Path::new("tendon.toml")).map_err(|error| error.to_string())
    }

    #[test]
    fn an_empty_file_is_the_default_and_the_default_is_valid() {
        assert_eq!(parse("").unwrap(), Config::default());
        Config::default().check().unwrap();
    }

    #[test]
    fn the_documented_file_holds_every_key_at_its_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tendon.toml");
        let text = std::fs::read_to_string(path).unwrap();
        assert_eq!(parse(&text).unwrap(), Config::default());
        // The same keys, and those that are left out by default as comments.
        let keys = |table: &str| -> Vec<String> {
            let key = |line: &str| {
                let line = line.trim_start_matches("# ");
                line.starts_with(|first: char| first.is_ascii_lowercase() || first == '[')
                    .then(|| line.split(['=', ']']).next().unwrap_or_default().trim().to_owned())
            };
            table.lines().filter_map(key).collect()
        };
        let documented = keys(&text);
        let mut config = Config::default();
        config.acquisition.simulate.profile = Some("x".into());
        config.acquisition.simulate.clip_at = Some(1.0);
        config.acquisition.replay.path = Some("x".into());
        config.acquisition.replay.sample_rate_hz = Some(1.0);
        config.acquisition.replay.channels = Some(vec![]);
        config.acquisition.replay.repetition = Some(0);
        config.inference.model = Some("x".into());
        config.inference.runtime_library = Some("x".into());
        for key in keys(&config.to_toml()) {
            assert!(documented.contains(&key), "tendon.toml does not document `{key}`");
        }
    }

    #[test]
    fn what_would_disarm_a_real_arm_is_refused() {
        let check = |text: &str| {
            let real = "backend = \"xarm\"\nxarm.address = \"127.0.0.1\"\n";
            let config = parse(&format!("[robot]\n{real}{text}")).unwrap();
            config.check().map_err(|error| error.to_string())
        };
        assert_eq!(check(""), Ok(()));
        assert!(check("arm.watchdog_ms = 10000").unwrap_err().contains("at most 300"));
        assert!(check("arm.linear_speed_limit_mm_per_s = 1500.0").unwrap_err().contains("at most 250"));
        let never_moves = check("arm.watchdog_ms = 75").unwrap_err();
        assert!(
            never_moves.contains("robot.arm.watchdog_ms = 75: take more than the 75 ms"),
            "{never_moves}"
        );
        for key in [
            "arm.linear_speed_limit_mm_per_s",
            "arm.linear_acceleration_mm_per_s2",
            "arm.linear_jerk_mm_per_s3",
            "arm.gripper_open_pulses",
            "arm.gripper_closed_pulses",
            "arm.gripper_speed_pulses_per_s",
            "xarm.start_speed_deg_per_s",
        ] {
            for number in ["nan", "inf", "-inf"] {
                assert!(check(&format!("{key} = {number}")).is_err(), "{key} = {number}");
            }
        }
        assert!(check("arm.start_joints_deg = [0.0, -15.0, nan, 45.0, 0.0, 60.0, 0.0]").is_err());
        assert!(check("arm.workspace_min_mm = [nan, -400.0, 150.0]").is_err());
        assert!(check("arm.workspace_max_mm = [600.0, inf, 650.0]").is_err());
    }

    #[test]
    fn a_configuration_reads_back_from_its_text() {
        let mut config = Config::default();
        config.acquisition.simulate.clip_at = Some(100.0);
        config.acquisition.replay.path = Some("recording.csv".into());
        config.acquisition.replay.channels = Some(vec![Channel::Index(2), Channel::Name("biceps".into())]);
        assert_eq!(parse(&config.to_toml()).unwrap(), config);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_the_nearest_known_one() {
        let error = parse("[acquisition]\nblock_sample = 5\n").unwrap_err();
        for part in ["tendon.toml", "line 2", "block_sample", "did you mean `block_samples`?"] {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }

    #[test]
    fn one_key_is_changed_as_on_the_command_line() {
        let config = Config::default().with("acquisition.channels=8").unwrap();
        assert_eq!(config.acquisition.channels, 8);
        let config = config.with("acquisition.simulate.script=rest 1s, grip 2s").unwrap();
        assert_eq!(config.acquisition.simulate.script, "rest 1s, grip 2s");
        assert_eq!(config.acquisition.channels, 8);
        for (assignment, expected) in [
            ("acquisition.chanels=8", "did you mean `channels`?"),
            ("acquisition.channels=many", "invalid type"),
            ("channels", "write KEY=VALUE"),
        ] {
            let error = config.with(assignment).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains(assignment), "{error}");
        }
    }

    #[test]
    fn a_table_gives_its_first_columns_and_a_3dc_recording_the_models_channels() {
        let channels = |path: &str| {
            let replay = ReplaySettings { path: Some(path.into()), ..ReplaySettings::default() };
            replay.recording(4).channels
        };
        assert_eq!(channels("emg.csv"), [0, 1, 2, 3].map(Channel::Index));
        assert_eq!(channels("EMG/3dc_EMG_gesture_0_1.txt"), [0, 3, 5, 8].map(Channel::Index));
    }

    #[test]
    fn settings_that_do_not_fit_each_other_are_refused() {
        let mut config = Config::default();
        config.acquisition.source = Source::Replay;
        assert!(config.check().unwrap_err().to_string().contains("--replay PATH"));
        config.acquisition.replay.path = Some("x".into());
        config.acquisition.replay.channels = Some(vec![Channel::Index(0)]);
        assert!(config.check().unwrap_err().to_string().contains("as many as acquisition.channels"));
    }

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in "[\\x00-\\x7f]{0,200}") {
            let _ = parse(&text);
        }
    }
}
