//! The settings, section by section, each key with its default.

use std::net::IpAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tendon_arm::ArmSettings;
use tendon_gesture::DecisionSettings;
use tendon_people::Adaptation;
use tendon_signal::SignalSettings;
use tendon_transport::{Delivery, SessionName};
use tendon_zones::TaskSettings;

use crate::acquisition::{AcquisitionSettings, Pace, Source};

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
    /// What is given to other programs.
    pub outlets: OutletSettings,
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
            outlets: OutletSettings::default(),
            scheduling: SchedulingSettings::default(),
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
    /// The file of the person, for the strategy `personal`; `tendon calibrate` makes it.
    pub person: Option<PathBuf>,
    /// The checksum of the person in that file. `tendon run` sets it, so that a stage that is started again in the middle of
    /// the session refuses a file that was replaced.
    pub person_checksum: Option<String>,
    /// Whether the person's recogniser follows them during use.
    pub adaptation: Adaptation,
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

impl Backend {
    /// The name as the settings and the report spell it.
    pub fn name(self) -> &'static str {
        match self {
            Backend::Simulate => "simulate",
            Backend::XArm => "xarm",
        }
    }
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
    /// Maximum speed of a joint on the way to the start position, degrees/s.
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

/// What a session gives to other programs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutletSettings {
    /// Predictions, commands and markers as streams of the Lab Streaming Layer.
    pub lsl: bool,
}

/// Whether real-time scheduling is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Realtime {
    /// Use it if permitted.
    Auto,
    /// Require it.
    On,
    /// Do not ask for it.
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

impl Config {
    /// Whether publishers wait or only the newest messages are kept.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_settings_file() {
        for backend in [Backend::Simulate, Backend::XArm] {
            assert_eq!(toml::Value::try_from(backend).unwrap().as_str(), Some(backend.name()));
        }
    }
}
