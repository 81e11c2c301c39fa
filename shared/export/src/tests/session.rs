//! Made-up sessions, for tests.

use std::io::Cursor;
use std::path::PathBuf;

use tempfile::TempDir;
use tendon_messages::{Permission, STAGE_COUNT, Stage, StopReason, Truth};
use tendon_session_file::{
    Block, CONFIGURATION, CommandRecord, ContextRecord, Cue, Event, EventKind, Message, Number, PERSON,
    PredictionRecord, StateRecord, TASK, TraceRecord, Writer,
};

pub(crate) const RATE_HZ: f64 = 2000.0;
pub(crate) const BLOCK_SAMPLES: u64 = 10;
/// When the first sample of the made-up session was captured, CLOCK_MONOTONIC ns.
pub(crate) const BEGUN_NS: u64 = 5_000_000_000;

/// A session as its topics would show it.
pub(crate) struct Session {
    pub(crate) messages: Vec<Message>,
    pub(crate) channels: usize,
    next_sample: u64,
    now_ns: u64,
    sequence: u64,
    truth: Truth,
}

impl Session {
    pub(crate) fn new(channels: usize) -> Session {
        Session::beginning_at(channels, BEGUN_NS)
    }

    pub(crate) fn beginning_at(channels: usize, now_ns: u64) -> Session {
        let truth = Truth::default();
        Session { messages: Vec::new(), channels, next_sample: 0, now_ns, sequence: 0, truth }
    }

    /// The value of a sample: another one everywhere.
    pub(crate) fn value(channel: usize, sample: u64) -> f32 {
        (sample as f32 * 0.01).sin() * 100.0 + channel as f32 * 1000.0 + 0.1
    }

    /// So many blocks, one after the other.
    pub(crate) fn blocks(&mut self, count: usize) {
        for _ in 0..count {
            self.now_ns += BLOCK_SAMPLES * 500_000;
            let first = self.next_sample;
            let channels = 0..self.channels;
            let values = channels.flat_map(|channel| {
                (first..first + BLOCK_SAMPLES).map(move |sample| Session::value(channel, sample))
            });
            self.messages.push(Message::Block(Block {
                sequence: self.sequence,
                captured_ns: self.now_ns - 500_000,
                published_ns: self.now_ns,
                first_sample: first,
                sample_rate_hz: RATE_HZ,
                truth: self.truth,
                channels: self.channels as u32,
                samples: BLOCK_SAMPLES as u32,
                non_finite_samples: 0,
                values: values.collect(),
            }));
            self.sequence += 1;
            self.next_sample += BLOCK_SAMPLES;
        }
    }

    /// Samples that the source lost.
    pub(crate) fn lose(&mut self, samples: u64) {
        self.next_sample += samples;
        self.now_ns += samples * 500_000;
    }

    /// The source begins anew after so long.
    pub(crate) fn begin_anew(&mut self, pause_ns: u64) {
        (self.next_sample, self.sequence) = (0, 0);
        self.now_ns += pause_ns;
    }

    pub(crate) fn cue(&mut self, class_number: u8, gesture: &str) {
        self.cue_ahead(0, class_number, gesture);
    }

    /// A cue that is known so many samples before it comes.
    pub(crate) fn cue_ahead(&mut self, samples: u64, class_number: u8, gesture: &str) {
        self.messages.push(Message::Cue(Cue {
            since_sample: self.next_sample + samples,
            captured_ns: self.now_ns,
            class_number: Some(class_number),
            gesture: Some(gesture.to_owned()),
        }));
    }

    /// From here on nothing is asked for.
    pub(crate) fn cue_is_over(&mut self) {
        self.messages.push(Message::Cue(Cue {
            since_sample: self.next_sample,
            captured_ns: self.now_ns,
            class_number: None,
            gesture: None,
        }));
    }

    pub(crate) fn event(&mut self, kind: EventKind, text: &str) {
        self.messages.push(Message::Event(Event { at_ns: self.now_ns, kind, text: text.to_owned() }));
    }

    /// A prediction and a command of the window that begins there, with each hop 10 us long and each work 30 us.
    pub(crate) fn window(&mut self, first_sample: u64) {
        let mut trace = TraceRecord { captured_ns: self.now_ns - 500_000, ..TraceRecord::default() };
        for stage in 0..STAGE_COUNT as u64 {
            trace.received_ns[stage as usize] =
                if stage == 0 { 0 } else { self.now_ns + stage * 40_000 - 30_000 };
            trace.published_ns[stage as usize] = self.now_ns + stage * 40_000;
        }
        let context = ContextRecord { first_sample, truth: Some(1), activity: 2, ..ContextRecord::default() };
        let numbers = |numbers: [f32; 6]| numbers.map(Number).to_vec();
        self.messages.push(Message::Prediction(PredictionRecord {
            trace,
            context,
            novelty: Number(f32::NAN),
            probabilities: numbers([0.1, 0.6, 0.3, 0.0, 0.0, 0.0]),
            efforts: numbers([0.0, f32::INFINITY, 0.5, 1.0, 1.0, 1.0]),
        }));
        self.messages.push(Message::Command(CommandRecord {
            trace,
            context,
            gesture: 1,
            voted: 0,
            confidence: Number(0.6),
            mode: 0,
            frame: 1,
            is_unsure: 0,
            ordered_mode: 0,
            gripper_toggles: 3,
            twist: [0.0, -1.5, 0.0, 0.0, 0.25, 0.0].map(Number).to_vec(),
        }));
    }

    pub(crate) fn state(&mut self, permission: Permission, reason: Option<StopReason>) {
        let mut trace = TraceRecord::default();
        trace.published_ns[Stage::Robot.index()] = self.now_ns + 1_000_000;
        self.messages.push(Message::State(StateRecord {
            trace,
            joints_rad: (0..7).map(|joint| Number(joint as f32)).collect(),
            position_mm: [300.0, 0.0, 400.0].map(Number).to_vec(),
            orientation_rad: [3.0, 0.0, 0.5].map(Number).to_vec(),
            speed_mm_per_s: Number(12.5),
            gripper_position: Number(850.0),
            gesture: 1,
            confidence: Number(0.6),
            permission: permission.number(),
            stop_reason: reason.map_or(0, StopReason::number),
            fault_code: 0,
            arm_phase: 3,
            hindrance: 1,
            start_distance_mm: Number(0.0),
            mode: 0,
            is_unsure: 0,
        }));
    }

    /// Its file, in a folder of its own.
    pub(crate) fn file(&self) -> (TempDir, PathBuf) {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = Writer::begin(&mut bytes, "test", BEGUN_NS).unwrap();
        writer.metadata("provenance", [("json", r#"{"version":"1.2.3"}"#.to_owned())]).unwrap();
        let configuration = "session = \"test\"\n[dsp.windows]\nwindow_samples = 20\nincrement_samples = 10\n\
             [decision]\nstrategy = \"personal\"\n";
        writer.attach(CONFIGURATION, "application/toml", configuration.as_bytes()).unwrap();
        let person =
            b"format = \"tendon-person\"\nversion = 99\n\nname = \"anna\"\n[made]\nname = \"nobody\"\n";
        writer.attach(PERSON, "application/octet-stream", person).unwrap();
        let names: Vec<&str> = ["flexor", "2", "a, \"b\""].into_iter().take(self.channels).collect();
        let stages = serde_json::json!({ "acquisition": { "signal": { "channels": names, "unit": "uV" } } });
        writer.metadata("stages", [("json", stages.to_string())]).unwrap();
        for messages in self.messages.chunks(16) {
            messages.iter().for_each(|message| writer.write(message, self.now_ns).unwrap());
            writer.flush().unwrap();
        }
        writer.metadata(TASK, [("json", TASK_REPORT.to_owned())]).unwrap();
        writer.finish().unwrap();
        drop(writer);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        std::fs::write(&path, bytes.into_inner()).unwrap();
        (folder, path)
    }
}

const TASK_REPORT: &str = r#"{"name":"zones","user":"person","seed":0,"shape":"sphere","width_mm":40.0,"dwell_s":1.0,
    "timeout_s":20.0,"duration_s":30.0,"zones_reached":1,"zones_timed_out":1,"mean_completion_time_s":4.0,
    "mean_movement_time_s":3.0,"mean_index_of_difficulty_bits":1.5,"throughput_bits_per_s":0.5,"mean_path_efficiency":0.8,
    "overshoots":0,"box_violations":0,"outside_box_s":0.0,"states_lost":0,"zones":[
    {"centre_mm":[300.0,10.0,400.0],"distance_mm":80.0,"index_of_difficulty_bits":1.5,"reached":true,"completion_time_s":4.0,
     "movement_time_s":3.0,"throughput_bits_per_s":0.5,"path_length_mm":100.0,"path_efficiency":0.8,"overshoots":0},
    {"centre_mm":[300.0,-10.0,420.0],"distance_mm":60.0,"index_of_difficulty_bits":1.3,"reached":false,
     "completion_time_s":null,"movement_time_s":null,"throughput_bits_per_s":null,"path_length_mm":10.0,
     "path_efficiency":null,"overshoots":2}]}"#;

/// A session with all that there can be: a gap of 30 samples behind row 40, a source that began anew behind row 60.
pub(crate) fn eventful() -> Session {
    let mut session = Session::new(3);
    session.cue(0, "rest");
    session.state(Permission::AwaitRest, None);
    session.blocks(2);
    session.window(0);
    session.cue(1, "extension");
    session.blocks(2);
    session.event(EventKind::Note, "electrode 3, \"loose\"");
    session.lose(30);
    session.blocks(2);
    session.state(Permission::Granted, None);
    session.state(Permission::Granted, None);
    session.begin_anew(1_000_000_000);
    session.cue(0, "rest");
    session.blocks(3);
    session.state(Permission::Stopped, Some(StopReason::Ordered));
    session.window(0);
    session
}
