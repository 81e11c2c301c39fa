//! What the page is told of a session, out of the newest message of each topic. Pure: time comes in as nanoseconds.
//!
//! ```text
//! config ──────────────────────────────▶ hello     once
//! predictions, commands, states ─▶ View ─▶ state     30 times a second
//! measurements ──────────────────────────▶ latency   once a second
//! ```

use hdrhistogram::Histogram;
use serde_json::{Value, json};
use tendon_config::{Config, Source};
use tendon_gesture::{Action, Mode};
use tendon_messages::{
    ArmPhase, BlockHeader, CommandHeader, Hindrance, Measurement, MeasurementHeader, Permission,
    PredictionHeader, Stage, StateHeader, StopReason, Trace,
};
use tendon_report::{LatencySummary, SessionMeasurements};
use tendon_xarm::{Fault, Source as FaultSource};

use crate::traces::Traces;

/// The paper's latency, window start to command, ms.
const PAPER_MEDIAN_MS: u32 = 326;
const PAPER_MEAN_MS: u32 = 324;
/// The histograms' first edge, and how far each is from the next.
const FIRST_EDGE_NS: u64 = 1000;
const EDGE_RATIO: f64 = 1.25;

/// Older than this, the newest message of robot or decision shows that it hangs: the one publishes every 20 ms at least, and without
/// the other's commands the robot stops after 150 ms.
const SILENT_NS: u64 = 250_000_000;

/// The kind of what has an arm.
const SESSION: &str = "session";

/// What a state says of the arm, besides whether it may move.
const ARM_KEYS: [&str; 16] = [
    "seen_ns",
    "arm_is_silent",
    "position_mm",
    "orientation_rad",
    "joints_rad",
    "speed_mm_per_s",
    "gripper",
    "stop_reason",
    "fault",
    "hindrance",
    "phase",
    "gesture",
    "confidence",
    "unsure",
    "mode",
    "calibration_left_ms",
];

/// A session as it is now.
#[derive(Debug)]
pub struct View {
    config: Config,
    /// When sample 0 was captured, as the newest block tells.
    started_ns: Option<u64>,
    probabilities: Vec<f32>,
    efforts: Vec<f32>,
    novelty: f32,
    /// The newest command, and whether it moves the arm.
    command: Option<(CommandHeader, bool)>,
    state: Option<(StateHeader, Vec<f32>)>,
    measurements: SessionMeasurements,
    /// Process of each stage, and how often it was another one.
    processes: [u64; Stage::ALL.len()],
    restarts: u64,
}

impl View {
    /// Of a session of which nothing has come yet.
    pub fn new(config: &Config) -> View {
        View {
            config: config.clone(),
            started_ns: None,
            probabilities: Vec::new(),
            efforts: Vec::new(),
            novelty: 0.0,
            command: None,
            state: None,
            measurements: SessionMeasurements::default(),
            processes: [0; Stage::ALL.len()],
            restarts: 0,
        }
    }

    /// A block has come.
    pub fn block(&mut self, header: &BlockHeader) {
        let newest = header.first_sample + u64::from(header.samples);
        let since_start_ns = 1e9 * newest as f64 / header.sample_rate_hz;
        self.started_ns = Some(header.trace.captured_ns.saturating_sub(since_start_ns as u64));
    }

    /// A prediction has come.
    pub fn prediction(&mut self, header: &PredictionHeader, payload: &[f32]) {
        let (probabilities, efforts) = payload.split_at(payload.len() / 2);
        (self.probabilities, self.efforts) = (probabilities.to_vec(), efforts.to_vec());
        self.novelty = header.novelty;
    }

    /// A command has come.
    pub fn command(&mut self, header: &CommandHeader, twist: &[f32]) {
        self.command = Some((*header, twist.iter().any(|velocity| *velocity != 0.0)));
    }

    /// A state of the arm has come.
    pub fn state(&mut self, header: &StateHeader, payload: &[f32]) {
        self.state = Some((*header, payload.to_vec()));
    }

    /// Measurements of a stage have come.
    pub fn measured(&mut self, header: &MeasurementHeader, batch: &[Measurement]) {
        self.measurements.absorb(header, batch);
        if let Some(process) = self.processes.get_mut(usize::from(header.stage)) {
            self.restarts += u64::from(*process != 0 && *process != header.process_id);
            *process = header.process_id;
        }
    }

    /// What does not change as long as the session runs. `rights` is for each viewer to add; `desk` is what the supervisor tells.
    pub fn hello(&self, joined_ns: u64, bin_ms: f64, desk: &Value) -> Value {
        let Config { acquisition, decision, inference, robot, .. } = &self.config;
        let joints = tendon_arm::denavit_hartenberg().map(|joint| {
            json!({"a_mm": joint.a_mm, "d_mm": joint.d_mm, "alpha_rad": joint.alpha_rad, "theta_offset_rad": 0.0})
        });
        json!({
            "kind": desk["kind"].as_str().unwrap_or(SESSION),
            "session": self.config.session.to_string(),
            "version": env!("CARGO_PKG_VERSION"),
            "started_ns": joined_ns,
            "source": acquisition.source.name(),
            "person": desk["person"],
            "model": inference.model,
            "strategy": decision.strategy.name(),
            "sample_rate_hz": acquisition.sample_rate_hz,
            "channels": channels(&self.config),
            "gestures": decision.gestures.iter().map(|gesture| gesture.name().to_owned()).collect::<Vec<_>>(),
            "modes": decision.modes.iter().map(mode).collect::<Vec<_>>(),
            "workspace_mm": {"min": robot.arm.workspace_min_mm, "max": robot.arm.workspace_max_mm},
            "arm": has_arm(desk).then(|| json!({"joints": joints})),
            "speed_mm_per_s": decision.speed_mm_per_s,
            "paper": {"median_ms": PAPER_MEDIAN_MS, "mean_ms": PAPER_MEAN_MS},
            "bin_ms": bin_ms,
        })
    }

    /// The session now, with what the supervisor tells on its `desk`; `None` before the arm has said anything. A calibration has
    /// no arm, nor has what could not begin.
    pub fn now(&self, now_ns: u64, traces: &Traces, desk: &Value) -> Option<Value> {
        // What decision said last is nothing that it says now.
        let command = self.command.filter(|(command, _)| !is_silent(&command.trace, Stage::Decision, now_ns));
        let counts = |stage| self.measurements.counts(stage);
        let troubles = traces.troubles();
        let troubles: Vec<Value> =
            troubles.into_iter().map(|(channel, kind)| json!({"channel": channel, "kind": kind})).collect();
        let elapsed_ns = self.started_ns.map_or(0, |started_ns| now_ns.saturating_sub(started_ns));
        let mut state = json!({
            "now_ns": now_ns,
            "captured_ns": traces.captured_ns(),
            "elapsed_s": elapsed_ns as f64 / 1e9,
            "voted": command.and_then(|(command, _)| self.gesture(command.voted)),
            "moves": command.is_some_and(|(_, moves)| moves),
            "novelty": self.novelty,
            "probabilities": self.probabilities,
            "efforts": self.efforts,
            "zone": desk["task"]["zone"],
            "recording": desk["recording"],
            "lost_samples": counts(Stage::Acquisition).lost_samples,
            "lost_blocks": counts(Stage::Dsp).lost,
            "stale": Stage::ALL.into_iter().map(|stage| counts(stage).stale).sum::<u64>(),
            "restarts": self.restarts,
            "clock_drift_ppm": self.measurements.clock_drift_ppm(),
            "troubles": troubles,
        });
        let arm = if has_arm(desk) { self.arm(now_ns)? } else { no_arm() };
        for (key, value) in arm {
            state[key] = value;
        }
        Some(state)
    }

    /// What the arm has said last.
    fn arm(&self, now_ns: u64) -> Option<Vec<(&'static str, Value)>> {
        let (header, payload) = self.state.as_ref()?;
        let (joints_rad, position_mm, orientation_rad) =
            (payload.get(..7)?, payload.get(7..10)?, payload.get(10..13)?);
        Some(vec![
            // Of which state an order is that the viewer gives next.
            ("seen_ns", json!(header.trace.published_ns[Stage::Robot.index()])),
            ("arm_is_silent", json!(is_silent(&header.trace, Stage::Robot, now_ns))),
            ("position_mm", json!(position_mm)),
            ("orientation_rad", json!(orientation_rad)),
            ("joints_rad", json!(joints_rad)),
            ("speed_mm_per_s", json!(header.speed_mm_per_s)),
            ("gripper", json!(header.gripper_position)),
            ("permission", json!(kebab_case(&Permission::from_number(header.permission)))),
            (
                "stop_reason",
                json!(StopReason::from_number(header.stop_reason).map(|reason| kebab_case(&reason))),
            ),
            // In the words of the maker's error list, English.
            (
                "fault",
                json!(Fault::new(FaultSource::Controller, header.fault_code).map(|fault| fault.to_string())),
            ),
            (
                "hindrance",
                json!(Hindrance::from_number(header.hindrance).map(|hindrance| hindrance.to_string())),
            ),
            ("phase", json!(kebab_case(&ArmPhase::from_number(header.arm_phase)))),
            ("gesture", json!(self.gesture(header.gesture))),
            ("confidence", json!(header.confidence)),
            ("unsure", json!(header.is_unsure != 0)),
            ("mode", json!(header.mode)),
            ("calibration_left_ms", json!(header.calibration_left_ms)),
        ])
    }

    /// The name of a gesture of this number.
    fn gesture(&self, number: u8) -> Option<String> {
        self.config.decision.gestures.get(number).map(|gesture| gesture.name().to_owned())
    }

    /// The latencies so far.
    pub fn latency(&self) -> Value {
        let transits = Stage::ALL.into_iter().filter_map(|stage| {
            let name = format!("{} → {}", stage.upstream()?.name(), stage.name());
            Some(summary(&name, self.measurements.transit(stage)))
        });
        let works = Stage::ALL
            .into_iter()
            .filter(|stage| stage.upstream().is_some())
            .map(|stage| summary(&format!("{} (work)", stage.name()), self.measurements.work(stage)));
        json!({
            "hops": transits.chain(works).collect::<Vec<_>>(),
            "newest_sample_to_command":
                summary("newest sample → command", &self.measurements.newest_sample_to_command),
        })
    }
}

/// Whether a stage whose newest message has this trace hangs.
fn is_silent(trace: &Trace, stage: Stage, now_ns: u64) -> bool {
    now_ns.saturating_sub(trace.published_ns[stage.index()]) > SILENT_NS
}

/// Whether a desk is that of a session, and of no calibration nor of what could not begin.
fn has_arm(desk: &Value) -> bool {
    desk["kind"].as_str().is_none_or(|kind| kind == SESSION)
}

/// What stands in a state where there is no arm.
fn no_arm() -> Vec<(&'static str, Value)> {
    ARM_KEYS.into_iter().map(|key| (key, Value::Null)).chain([("permission", json!("none"))]).collect()
}

/// The name of a variant in lower case with hyphens: `AwaitRest` is `await-rest`.
fn kebab_case(variant: &impl std::fmt::Debug) -> String {
    let mut name = String::new();
    for letter in format!("{variant:?}").chars() {
        if letter.is_uppercase() && !name.is_empty() {
            name.push('-');
        }
        name.extend(letter.to_lowercase());
    }
    name
}

/// Name and unit of every channel.
fn channels(config: &Config) -> Vec<Value> {
    let acquisition = &config.acquisition;
    let unit = acquisition.unit.clone().or_else(|| match acquisition.source {
        Source::Simulate => acquisition.simulate.read_profile().ok().map(|profile| profile.unit),
        Source::Replay => Some(acquisition.recording_unit()).filter(|unit| !unit.is_empty()),
        _ => None,
    });
    let names = match acquisition.source {
        Source::Simulate => None,
        Source::Replay => acquisition.replay.channels.as_ref(),
        _ => acquisition.channel_selection.as_ref(),
    };
    let name = |channel: usize| {
        let name = names.and_then(|names| names.get(channel));
        name.map_or_else(|| channel.to_string(), |name| name.name())
    };
    (0..acquisition.channels).map(|channel| json!({"name": name(channel), "unit": unit})).collect()
}

fn mode(mode: &Mode) -> Value {
    let motion = |action: &Action| match action {
        Action::Nothing => "none".to_owned(),
        Action::Gripper => "gripper".to_owned(),
        Action::NextMode => "next-mode".to_owned(),
        Action::Move(motion) => motion.direction.to_string(),
    };
    let motions: serde_json::Map<String, Value> = mode
        .actions
        .iter()
        .map(|(gesture, action)| (gesture.name().to_owned(), motion(action).into()))
        .collect();
    json!({"name": mode.name, "motions": motions})
}

fn summary(name: &str, histogram: &Histogram<u64>) -> Value {
    let LatencySummary { count, p50_us, p99_us, .. } = LatencySummary::of(histogram);
    let buckets: Vec<(f64, u64)> = histogram
        .iter_log(FIRST_EDGE_NS, EDGE_RATIO)
        .map(|step| (step.value_iterated_to() as f64 / 1e3, step.count_since_last_iteration()))
        .filter(|(_, count)| *count > 0)
        .collect();
    json!({"name": name, "count": count, "p50_us": p50_us, "p99_us": p99_us, "buckets": buckets})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_words_and_an_arm_that_says_nothing_is_not_shown() {
        let config = Config::default();
        let mut view = View::new(&config);
        let traces = Traces::new(&config).unwrap();
        assert_eq!(view.now(0, &traces, &Value::Null), None);
        let mut header = StateHeader {
            permission: Permission::AwaitRest.number(),
            stop_reason: StopReason::NoCommands.number(),
            arm_phase: ArmPhase::GoingToStart.number(),
            hindrance: Hindrance::JointSpeed.number(),
            gripper_position: f32::NAN,
            gesture: 1,
            ..StateHeader::default()
        };
        header.trace.published_ns[Stage::Robot.index()] = 4;
        let payload: Vec<f32> = (0..13u8).map(f32::from).collect();
        let zone = json!({"center_mm": [1.0, 2.0, 3.0], "width_mm": 20.0});
        let desk = json!({"recording": "/tmp/session.mcap", "task": {"zone": zone}});
        view.state(&header, &payload);
        view.prediction(&PredictionHeader::default(), &[0.25, 0.75, 0.5, 1.0]);
        let state = view.now(5, &traces, &desk).unwrap();
        let expected = json!({
            "seen_ns": 4, "permission": "await-rest", "stop_reason": "no-commands", "fault": null, "phase": "going-to-start",
            "hindrance": "a joint cannot go faster", "gripper": null, "gesture": "extension",
            "joints_rad": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "position_mm": [7.0, 8.0, 9.0],
            "zone": zone, "recording": "/tmp/session.mcap", "orientation_rad": [10.0, 11.0, 12.0], "probabilities": [0.25, 0.75], "efforts": [0.5, 1.0],
        });
        for (key, value) in expected.as_object().unwrap() {
            assert_eq!(&state[key], value, "{key}");
        }
        // What no sender of ours writes.
        (header.gesture, header.stop_reason, header.permission) = (200, 200, 200);
        view.state(&header, &payload);
        let state = view.now(5, &traces, &desk).unwrap();
        assert_eq!((&state["gesture"], &state["stop_reason"]), (&Value::Null, &Value::Null));
        assert_eq!(state["permission"], "stopped");
        view.state(&header, &payload[..5]);
        assert_eq!(view.now(5, &traces, &desk), None);
    }

    #[test]
    fn what_the_robot_and_decision_said_last_is_not_shown_as_what_they_say_now() {
        let config = Config::default();
        let (mut view, traces) = (View::new(&config), Traces::new(&config).unwrap());
        let trace = Trace { published_ns: [7_000_000_000; Stage::ALL.len()], ..Trace::default() };
        view.state(&StateHeader { trace, ..StateHeader::default() }, &[0.0; 13]);
        view.command(&CommandHeader { trace, voted: 1, ..CommandHeader::default() }, &[0.0, 0.0, 5.0]);
        let at = |now_ns| {
            let state = view.now(now_ns, &traces, &Value::Null).unwrap();
            (state["arm_is_silent"] == true, state["voted"].clone(), state["moves"] == true)
        };
        assert_eq!(at(7_250_000_000), (false, json!("extension"), true));
        assert_eq!(at(7_250_000_001), (true, Value::Null, false));
    }

    #[test]
    fn a_calibration_has_signals_and_no_arm() {
        let config = Config::default();
        let (mut view, traces) = (View::new(&config), Traces::new(&config).unwrap());
        let desk = json!({"kind": "calibration"});
        let hello = view.hello(7, 8.0, &desk);
        assert_eq!((&hello["kind"], &hello["arm"]), (&json!("calibration"), &Value::Null));
        let state = view.now(5, &traces, &desk).unwrap();
        assert_eq!((&state["permission"], &state["now_ns"]), (&json!("none"), &json!(5)));
        // The same keys as with an arm.
        view.state(&StateHeader::default(), &[0.0; 13]);
        let session = view.now(5, &traces, &json!({"kind": "session"})).unwrap();
        let keys = |state: &Value| state.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        assert_eq!(keys(&state), keys(&session));
    }

    #[test]
    fn hello_tells_what_gestures_do_and_how_the_arm_is_built() {
        let hello = View::new(&Config::default()).hello(7, 8.0, &json!({"person": "anna"}));
        assert_eq!(hello["person"], "anna");
        assert_eq!(hello["modes"][0]["motions"]["extension"], "+z");
        assert_eq!(hello["channels"].as_array().unwrap().len(), 4);
        assert_eq!(hello["gestures"][0], "rest");
        let joints = hello["arm"]["joints"].as_array().unwrap();
        let offsets: Vec<f64> = joints.iter().map(|joint| joint["d_mm"].as_f64().unwrap().round()).collect();
        assert_eq!(offsets, [267.0, 0.0, 293.0, 0.0, 343.0, 0.0, 97.0]);
    }

    #[test]
    fn a_histogram_keeps_its_count_in_few_buckets() {
        let mut histogram = tendon_report::duration_histogram();
        for value in 1..=5000 {
            histogram.record(value * 997).unwrap();
        }
        let summary = summary("hop", &histogram);
        let buckets = summary["buckets"].as_array().unwrap();
        assert_eq!(buckets.iter().map(|bucket| bucket[1].as_u64().unwrap()).sum::<u64>(), 5000);
        assert!((10..60).contains(&buckets.len()), "{}", buckets.len());
    }
}
