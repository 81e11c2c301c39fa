//! What a person sees and presses while a session runs.

use std::io::{IsTerminal, Write};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use anyhow::Context;
use crossterm::event::{Event as TerminalEvent, KeyCode, KeyEventKind, KeyModifiers};
use nix::sys::termios::{OutputFlags, SetArg, tcgetattr, tcsetattr};
use nix::unistd::{getpgrp, tcgetpgrp};
use tendon_gesture::Gesture;
use tendon_messages::{Permission, STATE_LENGTH, Stage, StateHeader, StopReason};
use tendon_process::Order;
use tendon_xarm::Fault;

use crate::children::Event;

/// Time between two live lines where there is no terminal to rewrite one on.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

/// What the keys do, for the person at them.
pub const KEYS: &str = "keys: space STOP, a arm again, q quit";
/// With `--keyboard`, before those.
pub const GESTURE_KEYS: &str =
    "keys: e extension, f flexion, u ulnar, r radial, g grip, n none of them (rest)";

/// The live line on standard error.
#[derive(Debug)]
pub struct Screen {
    is_terminal: bool,
    last_plain: Option<Instant>,
}

impl Screen {
    pub fn new() -> Screen {
        Screen { is_terminal: std::io::stderr().is_terminal(), last_plain: None }
    }

    /// Shows a line, in place of the one before on a terminal.
    pub fn show(&mut self, line: &str) {
        // A line that cannot be shown is no reason to stop an arm's session.
        if self.is_terminal {
            let _ = write!(std::io::stderr(), "\r\x1b[2K{line}");
            let _ = std::io::stderr().flush();
        } else if self.last_plain.is_none_or(|last| last.elapsed() >= PLAIN_INTERVAL) {
            self.last_plain = Some(Instant::now());
            let _ = writeln!(std::io::stderr(), "{line}");
        }
    }

    /// Ends the live line, so that what follows starts on a line of its own.
    pub fn finish(&mut self) {
        if self.is_terminal {
            let _ = writeln!(std::io::stderr());
        }
    }
}

/// The live line: time, gesture, confidence, pose, gripper, age of the newest sample at the command.
pub fn live_line(elapsed: Duration, header: &StateHeader, state: &[f32]) -> String {
    let gesture = Gesture::from_index(header.gesture.into()).unwrap_or(Gesture::Rest);
    let position = state.get(7..10).filter(|_| state.len() == STATE_LENGTH).unwrap_or(&[0.0; 3]);
    let command_ns = header.trace.published_ns[Stage::Decision.index()];
    let latency_us = command_ns.saturating_sub(header.trace.captured_ns) as f64 / 1e3;
    format!(
        "{:6.1} s  {gesture:<9} {:3.0} %  x {:6.1}  y {:6.1}  z {:6.1} mm  gripper {:3.0}  sample to command {:5.0} us{}",
        elapsed.as_secs_f64(),
        100.0 * header.confidence,
        position[0],
        position[1],
        position[2],
        header.gripper_position,
        latency_us,
        standing(header)
    )
}

/// Why the arm does not move, empty if it may.
fn standing(header: &StateHeader) -> String {
    let reason = match (Fault::new(tendon_xarm::Source::Controller, header.fault_code), header.stop_reason) {
        (Some(fault), _) => fault.to_string(),
        (None, number) => StopReason::from_number(number).map_or(String::new(), |reason| reason.to_string()),
    };
    match Permission::from_number(header.permission) {
        Permission::Granted => String::new(),
        Permission::AwaitRest if reason.is_empty() => "  relax to begin".to_owned(),
        Permission::AwaitRest => format!("  ARM RESTS ({reason}): relax to go on"),
        Permission::Stopped => format!("  ARM STOPPED ({reason}): `tendon arm` or key a goes on"),
    }
}

/// The terminal in raw mode, keys as events; as it was before when dropped.
#[derive(Debug)]
pub struct Keyboard;

impl Keyboard {
    /// Whether somebody can press keys: standard input is a terminal, and it is this program that it is for.
    pub fn is_there() -> bool {
        tcgetpgrp(std::io::stdin()).is_ok_and(|group| group == getpgrp())
    }

    /// Listens to the keys for stop, arm and quit, and to those for gestures if `with_gestures`.
    pub fn listen(events: &Sender<Event>, with_gestures: bool) -> anyhow::Result<Keyboard> {
        crossterm::terminal::enable_raw_mode().context("--keyboard needs a terminal on standard input")?;
        let keyboard = Keyboard;
        // Lines that are printed meanwhile begin at the left all the same.
        let mut terminal = tcgetattr(std::io::stdin()).context("cannot set up the terminal")?;
        terminal.output_flags.insert(OutputFlags::OPOST);
        tcsetattr(std::io::stdin(), SetArg::TCSANOW, &terminal).context("cannot set up the terminal")?;
        let events = events.clone();
        std::thread::Builder::new()
            .name("keyboard".to_owned())
            .spawn(move || {
                while let Ok(event) = crossterm::event::read() {
                    if let Some(event) = meaning(&event, with_gestures)
                        && events.send(event).is_err()
                    {
                        break;
                    }
                }
            })
            .context("cannot start a thread")?;
        Ok(keyboard)
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // If it fails the user's `reset` has to do it; there is nothing else to try.
        let _ = crossterm::terminal::disable_raw_mode();
    }
}

fn meaning(event: &TerminalEvent, with_gestures: bool) -> Option<Event> {
    let TerminalEvent::Key(key) = event else { return None };
    if key.kind != KeyEventKind::Press {
        return None;
    }
    let gesture = match key.code {
        KeyCode::Char('e') => Some(Gesture::Extension),
        KeyCode::Char('f') => Some(Gesture::Flexion),
        KeyCode::Char('u') => Some(Gesture::Ulnar),
        KeyCode::Char('r') => Some(Gesture::Radial),
        KeyCode::Char('g') => Some(Gesture::Grip),
        KeyCode::Char('n') => Some(Gesture::Rest),
        _ => None,
    };
    if let Some(gesture) = gesture.filter(|_| with_gestures) {
        return Some(Event::Order(Stage::Acquisition, Order::Gesture(gesture)));
    }
    Some(match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Event::Stop,
        KeyCode::Char('q') | KeyCode::Esc => Event::Stop,
        KeyCode::Char(' ') => Event::Order(Stage::Robot, Order::Stop),
        KeyCode::Char('a') => Event::Order(Stage::Robot, Order::Arm),
        _ => return None,
    })
}
