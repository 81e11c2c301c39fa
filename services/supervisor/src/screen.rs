//! What a person sees and presses while a session runs.

use std::io::{IsTerminal, Write};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use anyhow::Context;
use crossterm::event::{Event as TerminalEvent, KeyCode, KeyEventKind, KeyModifiers};
use tendon_gesture::Gesture;
use tendon_messages::{STATE_LENGTH, Stage, StateHeader};

use crate::children::Event;

/// Time between two live lines where there is no terminal to rewrite one on.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

/// What the keys do, for the person at them.
pub const KEYS: &str = "keys: e extension, f flexion, u ulnar, r radial, g grip, space rest, q quit";

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
        if header.halted_by_watchdog != 0 { "  NO COMMANDS: arm stopped" } else { "" }
    )
}

/// The terminal in raw mode, keys as events; as it was before when dropped.
#[derive(Debug)]
pub struct Keyboard;

impl Keyboard {
    pub fn listen(events: &Sender<Event>) -> anyhow::Result<Keyboard> {
        crossterm::terminal::enable_raw_mode().context("--keyboard needs a terminal on standard input")?;
        let keyboard = Keyboard;
        let events = events.clone();
        std::thread::Builder::new()
            .name("keyboard".to_owned())
            .spawn(move || {
                while let Ok(event) = crossterm::event::read() {
                    if let Some(event) = meaning(&event)
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

fn meaning(event: &TerminalEvent) -> Option<Event> {
    let TerminalEvent::Key(key) = event else { return None };
    if key.kind != KeyEventKind::Press {
        return None;
    }
    Some(match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Event::Stop,
        KeyCode::Char('q') | KeyCode::Esc => Event::Stop,
        KeyCode::Char('e') => Event::Gesture(Gesture::Extension),
        KeyCode::Char('f') => Event::Gesture(Gesture::Flexion),
        KeyCode::Char('u') => Event::Gesture(Gesture::Ulnar),
        KeyCode::Char('r') => Event::Gesture(Gesture::Radial),
        KeyCode::Char('g') => Event::Gesture(Gesture::Grip),
        KeyCode::Char(' ') => Event::Gesture(Gesture::Rest),
        _ => return None,
    })
}
