//! Sessions in which something goes wrong: stages that stall, die and are started again, a supervisor that dies,
//! samples that are no numbers.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::os::fd::AsFd;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use tendon_config::{Config, Pace, Source};
use tendon_gesture::Gesture;
use tendon_messages::{
    Activity, BLOCKS, BlockHeader, COMMANDS, CommandHeader, MEASUREMENTS, Measurement, MeasurementHeader,
    Permission, STATES, Stage, StateHeader, StopReason, TWIST_LENGTH, Trace, WINDOWS, WindowContext,
    WindowHeader,
};
use tendon_report::{Outcome, Report};
use tendon_system_tests::recordings::{CHANNELS, MOVEMENT, PseudoEmg, REST, Stretch, write_table};
use tendon_system_tests::{
    StageAlone, TendonBuilder, WATCHDOG, assert_nothing_left, is_alive, model, unique_session, wait_until,
};
use tendon_transport::{
    Delivery, Leftovers, Publisher, Session, SessionLock, SessionName, Subscriber, now_ns,
};

/// Age of the newest sample from which on nothing is acted upon, ns.
const STALE_NS: u64 = 100_000_000;

/// Looks on at a session's blocks, commands and states.
struct Observer {
    blocks: Subscriber<BlockHeader, f32>,
    commands: Subscriber<CommandHeader, f32>,
    states: Subscriber<StateHeader, f32>,
    /// Blocks seen.
    blocks_seen: u64,
    /// Traces of all commands seen.
    commands_seen: Vec<Trace>,
    /// Commands that the arm acted on later than allowed.
    acted_late: u64,
    /// The arm was seen following commands.
    followed: bool,
    /// The arm was seen stopped because no command had come.
    halted: bool,
    // Ports are closed before the membership they belong to.
    _session: Session,
}

impl Observer {
    fn join(name: &SessionName) -> Observer {
        let session = Session::join(name, "test").unwrap();
        Observer {
            blocks: Subscriber::open(&session, &BLOCKS, None, Delivery::Live).unwrap(),
            commands: Subscriber::open(&session, &COMMANDS, None, Delivery::Live).unwrap(),
            states: Subscriber::open(&session, &STATES, None, Delivery::Live).unwrap(),
            blocks_seen: 0,
            commands_seen: Vec::new(),
            acted_late: 0,
            followed: false,
            halted: false,
            _session: session,
        }
    }

    /// Looks on until `enough`, or in vain until the watchdog.
    fn look_on_until(&mut self, what: &str, enough: impl Fn(&Observer) -> bool) {
        let begun = Instant::now();
        while !enough(self) {
            assert!(begun.elapsed() < WATCHDOG, "waited {WATCHDOG:?} in vain for {what}");
            let ports = [self.blocks.as_fd(), self.commands.as_fd(), self.states.as_fd()];
            let mut ports = ports.map(|port| PollFd::new(port, PollFlags::POLLIN));
            poll(&mut ports, PollTimeout::from(50_u8)).unwrap();
            self.take();
        }
    }

    fn look_on_for(&mut self, duration: Duration) {
        let begun = Instant::now();
        self.look_on_until("time to pass", |_| begun.elapsed() >= duration);
    }

    fn take(&mut self) {
        self.blocks.acknowledge_wakes().unwrap();
        while self.blocks.receive().unwrap().is_some() {
            self.blocks_seen += 1;
        }
        self.commands.acknowledge_wakes().unwrap();
        while let Some(command) = self.commands.receive().unwrap() {
            self.commands_seen.push(command.trace());
        }
        self.states.acknowledge_wakes().unwrap();
        while let Some(state) = self.states.receive().unwrap() {
            let trace = state.header().trace;
            let received_ns = trace.received_ns[Stage::Robot.index()];
            self.acted_late += u64::from(received_ns.saturating_sub(trace.captured_ns) > STALE_NS);
            self.followed |= state.header().permission == Permission::Granted as u8;
            self.halted |= state.header().stop_reason == StopReason::NoCommands as u8;
        }
    }

    /// Commands seen whose newest sample is from after `time_ns`.
    fn commands_since(&self, time_ns: u64) -> usize {
        self.commands_seen.iter().filter(|trace| trace.captured_ns > time_ns).count()
    }

    fn late_commands(&self) -> Vec<&Trace> {
        let age_ns =
            |trace: &Trace| trace.published_ns[Stage::Decision.index()].saturating_sub(trace.captured_ns);
        self.commands_seen.iter().filter(|trace| age_ns(trace) > STALE_NS).collect()
    }
}

/// Stalls one stage of a session for three seconds.
fn stall(stage: Stage) {
    let session = unique_session();
    let mut tendon = TendonBuilder::run(&session).args(&["--set", "dsp.activity.calibration_s=1.0"]).start();
    tendon.wait_until_running();
    let mut observer = Observer::join(&session);
    observer.look_on_until("an arm that follows commands", |observer| observer.followed);

    let process = tendon.stage(stage.name());
    let blocks_before = observer.blocks_seen;
    let commands_before = observer.commands_seen.len();
    kill(process, Signal::SIGSTOP).unwrap();
    observer.look_on_for(Duration::from_secs(3));
    let blocks = observer.blocks_seen - blocks_before;
    let commands = observer.commands_seen.len() - commands_before;
    kill(process, Signal::SIGCONT).unwrap();

    // 600 are due; a busy machine may leave out some, but a source that waits gives 64 at most.
    assert!(blocks > 200, "only {blocks} blocks while {} stood still", stage.name());
    if stage == Stage::Robot {
        assert!(commands > 10, "only {commands} commands while the robot stood still");
    } else {
        assert!(observer.halted, "the arm went on without commands");
    }
    let resumed_ns = now_ns();
    observer.look_on_until("commands after the stall", |observer| observer.commands_since(resumed_ns) >= 10);
    assert!(observer.late_commands().is_empty(), "{:#?}", observer.late_commands());
    assert_eq!(observer.acted_late, 0, "the arm acted on old commands");

    drop(observer);
    tendon.signal(Signal::SIGTERM);
    let report = tendon.end().report();
    let missed: u64 = report.messages.values().map(|messages| messages.lost + messages.stale).sum();
    assert!(missed > 0, "what was missed was not counted: {report:#?}");
}

#[test]
fn a_dsp_that_stalls_holds_nobody_up_and_acts_on_nothing_old() {
    stall(Stage::Dsp);
}

#[test]
fn an_inference_that_stalls_holds_nobody_up_and_acts_on_nothing_old() {
    stall(Stage::Inference);
}

#[test]
fn a_decision_that_stalls_holds_nobody_up_and_acts_on_nothing_old() {
    stall(Stage::Decision);
}

#[test]
fn a_robot_that_stalls_holds_nobody_up_and_acts_on_nothing_old() {
    stall(Stage::Robot);
}

#[test]
fn a_stage_that_dies_is_started_again_by_name_and_what_it_missed_is_counted() {
    let session = unique_session();
    let mut tendon = TendonBuilder::run(&session).start();
    tendon.wait_until_running();
    let mut observer = Observer::join(&session);
    observer.look_on_until("commands", |observer| observer.commands_seen.len() >= 10);
    let mut processes = tendon.stages();
    assert_eq!(processes.len(), Stage::ALL.len());
    for stage in Stage::ALL {
        let process = tendon.stage(stage.name());
        kill(process, Signal::SIGKILL).unwrap();
        let successor = wait_until("the stage to be started again", || {
            tendon.find_stage(stage.name()).filter(|successor| *successor != process)
        });
        processes.push(successor);
        let killed_ns = now_ns();
        observer.look_on_until("commands once more", |observer| observer.commands_since(killed_ns) >= 10);
        let says = format!("{} ended (signal: 9 (SIGKILL)) and is started again", stage.name());
        assert!(tendon.errors_so_far().contains(&says), "{}", tendon.errors_so_far());
    }
    assert!(observer.late_commands().is_empty(), "{:#?}", observer.late_commands());
    assert_eq!(observer.acted_late, 0, "the arm acted on old commands");
    drop(observer);
    tendon.signal(Signal::SIGTERM);
    let report = tendon.end().report();
    assert_eq!(report.restarts, Stage::ALL.len() as u64);
    let blocks = report.messages["blocks"];
    assert!(blocks.lost > 0 && blocks.lost < blocks.published / 2, "{blocks:?}");
    assert!(!processes.into_iter().any(is_alive), "stages outlived the session");
}

#[test]
fn a_stage_that_dies_again_and_again_ends_the_session_by_name() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    tendon.kill_until_it_gives_up("decision");
    tendon.end().assert_failed(1, &["tendon: error:", "decision ended", "the session is stopped"]);
}

#[test]
fn a_source_that_hangs_is_named_and_so_is_its_going_on() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    let acquisition = tendon.stage("acquisition");
    kill(acquisition, Signal::SIGSTOP).unwrap();
    let says = |text: &str| wait_until(text, || tendon.errors_so_far().contains(text).then_some(()));
    says("acquisition has published no samples for 2 s");
    // In the live line, too.
    says("acquisition: no samples for ");
    kill(acquisition, Signal::SIGCONT).unwrap();
    says("acquisition publishes samples again");
    tendon.signal(Signal::SIGTERM);
    let events = tendon.end().report().events;
    let texts: Vec<&str> = events.iter().map(|event| event.text.as_str()).collect();
    assert!(texts[0].starts_with("acquisition has published no samples"), "{texts:?}");
    assert!(texts.contains(&"acquisition publishes samples again"), "{texts:?}");
}

#[test]
fn a_source_that_never_yields_is_named() {
    let program = format!("acquisition.program={}", env!("CARGO_BIN_EXE_push-device"));
    let builder = TendonBuilder::run(&unique_session()).env("PUSH_DEVICE_SILENT", "1");
    let settings = ["--set", "acquisition.source=device", "--set", &program, "--duration", "5s"];
    let ended = builder.args(&settings).end();
    assert!(ended.errors.contains("acquisition has published no samples for 2 s"), "{ended:#?}");
    let report = ended.report();
    assert_eq!(report.events.len(), 1, "{report:#?}");
    assert_eq!(report.messages["blocks"].published, 0);
}

#[test]
fn a_session_whose_files_were_deleted_says_so_and_ends_in_good_order() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    let in_memory = |path: &std::path::PathBuf| path.starts_with("/dev/shm");
    for file in Leftovers::of(tendon.session()).files.into_iter().filter(in_memory) {
        let _ = std::fs::remove_file(file);
    }
    let ended = tendon.end();
    ended.assert_failed(1, &["files in /dev/shm were deleted", "Start it again"]);
    let report: Report = serde_json::from_str(ended.report_json.as_deref().unwrap()).unwrap();
    assert_eq!(report.outcome, Outcome::BrokeOff);
    assert!(report.error.unwrap().contains("files in /dev/shm were deleted"));
}

#[test]
fn after_the_true_reason_of_a_failed_start_no_other_is_given() {
    let builder = TendonBuilder::run(&unique_session()).args(&["--set", "acquisition.channels=8"]);
    let ended = builder.end();
    ended.assert_failed(2, &["inference: error:", "channels"]);
    let reasons: Vec<&str> = ended.errors.lines().filter(|line| line.contains("error:")).collect();
    assert!(reasons.len() == 2 && reasons[1].contains("inference ended"), "{ended:#?}");
}

#[test]
fn commands_of_a_decision_process_that_began_anew_stop_the_arm_whoever_started_it() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tendon.toml");
    let mut config = Config { session: name.clone(), ..Config::default() };
    config.scheduling.realtime = tendon_config::Realtime::Off;
    std::fs::write(&path, config.to_toml()).unwrap();
    let increment_samples = config.dsp.windows.increment_samples as u64;
    let lock = SessionLock::take(&name).unwrap();
    let session = Session::join(&name, "test").unwrap();
    let open = || Publisher::open(&session, &COMMANDS, TWIST_LENGTH, Delivery::Live, Arc::default()).unwrap();
    let mut states = Subscriber::open(&session, &STATES, None, Delivery::Live).unwrap();
    // Rest until the robot is as wanted.
    let mut first_sample = 0;
    let mut rest_until = |commands: &mut Publisher<CommandHeader, f32>,
                          is_enough: &dyn Fn(&StateHeader) -> bool| {
        wait_until("a state of the robot", || {
            let header = CommandHeader {
                trace: Trace { captured_ns: now_ns(), ..Trace::default() },
                context: WindowContext {
                    first_sample,
                    activity: Activity::Rest as u8,
                    ..WindowContext::default()
                },
                ..CommandHeader::default()
            };
            first_sample += increment_samples;
            commands.publish(header, TWIST_LENGTH, |twist| twist.fill(0.0)).unwrap();
            let mut is_there = false;
            while let Some(state) = states.receive().unwrap() {
                is_there |= is_enough(state.header());
            }
            is_there.then_some(())
        });
    };
    let mut commands = open();
    let robot = StageAlone::start("robot", &path);
    rest_until(&mut commands, &|state| state.permission == Permission::Granted as u8);
    drop(commands);
    rest_until(&mut open(), &|state| {
        let is_stopped = state.permission == Permission::Stopped as u8;
        is_stopped && state.stop_reason == StopReason::StageEnded as u8
    });
    let (exit_code, errors) = robot.stop();
    assert_eq!((exit_code, errors.as_str()), (Some(0), ""));
    drop((states, session));
    Leftovers::remove(&lock);
}

#[test]
fn a_recording_ends_its_session_though_a_stage_was_gone_at_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("recording.csv");
    write_table(&recording, &[Stretch { samples: 6000, amplitudes: REST }]);
    let session = unique_session();
    let builder = TendonBuilder::run(&session).arg("--replay").arg(recording);
    let mut tendon = builder.args(&["--replay-rate-hz", "2000"]).start();
    tendon.wait_until_running();
    let membership = Session::join(&session, "test").unwrap();
    let mut blocks = Subscriber::open(&membership, &BLOCKS, None, Delivery::Live).unwrap();
    // The windows that end with samples 5850 and 6000 find no decision.
    wait_until("the end of the recording to be near", || {
        let mut is_near = false;
        while let Some(block) = blocks.receive().unwrap() {
            is_near |= block.header().first_sample >= 5800;
        }
        is_near.then_some(())
    });
    kill(tendon.stage("decision"), Signal::SIGKILL).unwrap();
    drop((blocks, membership));
    assert_eq!(tendon.end().report().restarts, 1);
}

#[test]
fn a_recording_that_breaks_off_ends_the_session_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("recording.csv");
    write_table(&recording, &[Stretch { samples: 60_000, amplitudes: REST }]);
    let builder = TendonBuilder::run(&unique_session()).arg("--replay").arg(recording);
    let mut tendon = builder.args(&["--replay-rate-hz", "2000"]).start();
    tendon.wait_until_running();
    kill(tendon.stage("acquisition"), Signal::SIGKILL).unwrap();
    // Begun anew it would be another recording.
    tendon.end().assert_failed(1, &["tendon: error:", "acquisition ended", "the session is stopped"]);
}

#[test]
fn stages_end_when_their_supervisor_is_killed_and_the_next_session_of_that_name_starts_clean() {
    let session = unique_session();
    let mut tendon = TendonBuilder::run(&session).start();
    tendon.wait_until_running();
    let stages = tendon.stages();
    assert_eq!(stages.len(), Stage::ALL.len());
    tendon.signal(Signal::SIGKILL);
    let ended = tendon.end_whatever_is_left();
    assert_eq!(ended.exit_code, None);
    wait_until("the stages to end", || (!stages.iter().any(|stage| is_alive(*stage))).then_some(()));
    // Otherwise the next session would have nothing to clean up.
    assert!(!Leftovers::of(&session).files.is_empty());

    let report = TendonBuilder::run(&session).args(&["--duration", "2s"]).end().report();
    assert!(report.messages["commands"].published > 0, "{report:#?}");
}

/// Samples that come before the last in the test of NaN: 1 s of calibration, and some more rest.
const REST_SAMPLES: u64 = 4000;
const MOVEMENT_SAMPLES: u64 = 6000;
/// In the middle of the movement.
const NAN_SAMPLE: u64 = REST_SAMPLES + 3000;

/// The session of the test of NaN: dsp, inference, decision and robot as processes; acquisition is the test.
/// Nothing is lost in it, as in a replay at full speed, so it does not depend on the machine.
fn configure_without_acquisition(session: &SessionName, path: &Path) -> Config {
    let mut config = Config { session: session.clone(), ..Config::default() };
    config.acquisition.source = Source::Replay;
    config.acquisition.replay.path = Some("none: the test is the source".into());
    config.acquisition.replay.pace = Pace::Full;
    config.inference.model = Some(model("cnn-five-gesture"));
    config.dsp.activity.calibration_s = 1.0;
    config.scheduling.realtime = tendon_config::Realtime::Off;
    std::fs::write(path, config.to_toml()).unwrap();
    config
}

/// What was seen of one window.
struct Seen {
    replaced_samples: u32,
    all_finite: bool,
}

/// The other end of a session of which the test is the source.
struct Sink {
    windows: Subscriber<WindowHeader, f32>,
    commands: Subscriber<CommandHeader, f32>,
    measurements: Subscriber<MeasurementHeader, Measurement>,
    windows_seen: Vec<Seen>,
    commands_seen: Vec<CommandHeader>,
    /// As dsp counts them.
    replaced_samples: u64,
}

impl Sink {
    fn open(session: &Session) -> Sink {
        Sink {
            windows: Subscriber::open(session, &WINDOWS, None, Delivery::Lossless).unwrap(),
            commands: Subscriber::open(session, &COMMANDS, None, Delivery::Lossless).unwrap(),
            measurements: Subscriber::open(session, &MEASUREMENTS, None, Delivery::Live).unwrap(),
            windows_seen: Vec::new(),
            commands_seen: Vec::new(),
            replaced_samples: 0,
        }
    }

    fn take(&mut self) {
        while let Some(window) = self.windows.receive().unwrap() {
            self.windows_seen.push(Seen {
                replaced_samples: window.header().context.replaced_samples,
                all_finite: window.payload().iter().all(|sample| sample.is_finite()),
            });
        }
        while let Some(command) = self.commands.receive().unwrap() {
            self.commands_seen.push(*command.header());
        }
        while let Some(batch) = self.measurements.receive().unwrap() {
            if usize::from(batch.header().stage) == Stage::Dsp.index() {
                self.replaced_samples = batch.header().replaced_samples;
            }
        }
    }
}

#[test]
fn samples_that_are_no_numbers_are_replaced_counted_and_taken_for_rest() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tendon.toml");
    let config = configure_without_acquisition(&name, &path);
    let lock = SessionLock::take(&name).unwrap();
    let session = Session::join(&name, "test").unwrap();
    let mut blocks =
        Publisher::open(&session, &BLOCKS, config.block_length(), Delivery::Lossless, Arc::default())
            .unwrap();
    let stages = ["dsp", "inference", "decision", "robot"].map(|stage| StageAlone::start(stage, &path));
    let mut sink = Sink::open(&session);

    let block_samples = config.acquisition.block_samples;
    let mut emg = PseudoEmg::default();
    let broken = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    for first_sample in (0..REST_SAMPLES + MOVEMENT_SAMPLES).step_by(block_samples) {
        let header = BlockHeader {
            trace: Trace { captured_ns: now_ns(), ..Trace::default() },
            first_sample,
            sample_rate_hz: config.acquisition.sample_rate_hz,
            channels: CHANNELS as u32,
            samples: block_samples as u32,
            ..BlockHeader::default()
        };
        let amplitudes = if first_sample < REST_SAMPLES { REST } else { MOVEMENT };
        let fill = |payload: &mut [f32]| {
            for sample in 0..block_samples {
                for (channel, value) in emg.frame(amplitudes).into_iter().enumerate() {
                    payload[channel * block_samples + sample] = value;
                }
            }
            if first_sample == NAN_SAMPLE {
                payload[..broken.len()].copy_from_slice(&broken);
            }
        };
        blocks.publish(header, config.block_length(), fill).unwrap();
        sink.take();
    }
    let windows = ((REST_SAMPLES + MOVEMENT_SAMPLES - 600) / 150 + 1) as usize;
    let replaced = broken.len() as u64;
    wait_until("all windows, commands and counts", || {
        sink.take();
        (sink.commands_seen.len() >= windows && sink.replaced_samples >= replaced).then_some(())
    });

    assert_eq!(sink.windows_seen.len(), windows);
    assert!(sink.windows_seen.iter().all(|window| window.all_finite));
    assert_eq!(sink.replaced_samples, replaced);
    let with_replaced = sink.windows_seen.iter().filter(|window| window.replaced_samples > 0).count();
    // Each sample lies in window / increment = 4 windows.
    assert_eq!(with_replaced, 4);
    let is_rest = |command: &&CommandHeader| command.gesture == Gesture::REST.paper_number().unwrap();
    let (broken, whole): (Vec<&CommandHeader>, Vec<&CommandHeader>) =
        sink.commands_seen.iter().partition(|command| command.context.replaced_samples > 0);
    assert_eq!(broken.len(), with_replaced);
    assert!(broken.iter().all(is_rest), "{broken:#?}");
    assert!(broken.iter().all(|command| command.context.activity == Activity::Move as u8), "{broken:#?}");
    // Otherwise everything is rest, and the one above says nothing.
    let moves = |command: &&&CommandHeader| !is_rest(command) && command.context.first_sample > NAN_SAMPLE;
    assert!(whole.iter().filter(moves).count() > 0);

    drop((sink, blocks, session));
    for stage in stages {
        let (exit_code, errors) = stage.stop();
        assert_eq!((exit_code, errors.as_str()), (Some(0), ""));
    }
    Leftovers::remove(&lock);
    drop(lock);
    assert_nothing_left(&name);
}

#[test]
fn with_a_network_an_electrode_that_is_off_is_no_rest_that_lets_the_arm_move() {
    let session = unique_session();
    let mut tendon = TendonBuilder::run_with_model(&session, &model("cnn-six-class"))
        .args(&["--strategy", "direct", "--script", "rest 1s, ulnar 1s"])
        .args(&["--set", "acquisition.simulate.dropouts_per_minute=6000"])
        .args(&["--set", "acquisition.simulate.dropout_ms=60000"])
        .start();
    tendon.wait_until_running();
    let mut observer = Observer::join(&session);
    // With all electrodes on, the arm follows after the first second.
    observer.look_on_until("50 commands", |observer| observer.commands_seen.len() >= 50);
    assert!(!observer.followed);
    drop(observer);
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert!(ended.errors.contains("is flat: check the electrodes"), "{ended:#?}");
    ended.report();
}
