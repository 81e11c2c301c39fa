//! The streams, and what goes into them.

use tendon_config::Config;
use tendon_gesture::GestureSet;
use tendon_lsl::{ChannelFacts, Lsl, LslError, Outlet, StreamDescription, TextOutlet};
use tendon_messages::{
    COMMAND_CHANNELS, CommandHeader, PermissionChanges, PredictionHeader, Stage, StateHeader, TWIST_LENGTH,
    Trace,
};

/// The streams of a session.
pub struct Streams {
    gestures: GestureSet,
    predictions: Outlet,
    commands: Outlet,
    markers: TextOutlet,
    /// The gesture that was last acted on.
    gesture: Option<u8>,
    permission: PermissionChanges,
}

impl Streams {
    /// Opens the streams of this session.
    pub fn open(lsl: Lsl, config: &Config) -> Result<Streams, LslError> {
        let gestures = config.decision.gestures.clone();
        let describe = |what: &str, content_type: &str, channels: Vec<ChannelFacts>| {
            let name = format!("Tendon {} {what}", config.session);
            StreamDescription {
                source_id: format!("{name} of user {}", tendon_transport::own_user()),
                name,
                content_type: content_type.to_owned(),
                sample_rate_hz: 0.0,
                channels,
            }
        };
        let probabilities = gestures.iter().map(|gesture| channel(&format!("probability {gesture}"), "1"));
        let efforts = gestures.iter().map(|gesture| channel(&format!("effort {gesture}"), "1"));
        let commands = COMMAND_CHANNELS.iter().map(|(label, unit)| channel(label, unit));
        let predictions = describe("predictions", "Predictions", probabilities.chain(efforts).collect());
        let commands = describe("commands", "Commands", commands.collect());
        let markers = describe("markers", "Markers", vec![channel("marker", "")]);
        Ok(Streams {
            predictions: Outlet::new(lsl, &predictions)?,
            commands: Outlet::new(lsl, &commands)?,
            markers: TextOutlet::new(lsl, &markers)?,
            gestures,
            gesture: None,
            permission: PermissionChanges::default(),
        })
    }

    /// Gives a prediction: a probability and an effort for each gesture.
    pub fn predicted(&mut self, header: &PredictionHeader, payload: &[f32]) {
        if payload.len() == 2 * self.gestures.len() {
            self.predictions.push(payload, captured_s(&header.trace));
        }
    }

    /// Gives a command, and a marker when another gesture is acted on.
    pub fn commanded(&mut self, header: &CommandHeader, payload: &[f32]) -> Result<(), LslError> {
        let at_s = captured_s(&header.trace);
        if let Ok(twist) = <[f32; TWIST_LENGTH]>::try_from(payload) {
            let [x, y, z, about_x, about_y, about_z] = twist;
            self.commands.push(&[x, y, z, about_x, about_y, about_z, header.confidence], at_s);
        }
        if self.gesture.replace(header.voted) != Some(header.voted)
            && let Some(gesture) = self.gestures.iter().nth(usize::from(header.voted))
        {
            self.markers.push(&format!("gesture {gesture}"), at_s)?;
        }
        Ok(())
    }

    /// Gives a marker when the arm may move, or no longer.
    pub fn stated(&mut self, header: &StateHeader) -> Result<(), LslError> {
        let Some(marker) = self.permission.said(header.permission, header.stop_reason) else { return Ok(()) };
        self.markers.push(&marker, seconds(header.trace.published_ns[Stage::Robot.index()]))
    }
}

fn channel(label: &str, unit: &str) -> ChannelFacts {
    ChannelFacts { label: label.to_owned(), unit: unit.to_owned(), content_type: String::new() }
}

fn captured_s(trace: &Trace) -> f64 {
    seconds(trace.captured_ns)
}

fn seconds(time_ns: u64) -> f64 {
    time_ns as f64 * 1e-9
}
