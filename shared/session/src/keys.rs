//! Keys and signals. Whoever hears one tells the robot first, then the supervisor's loop.
//!
//! ```text
//! space, a ─────────────────────▶ RobotLine::order
//! q, Esc, Ctrl-C ──────────────┐
//! SIGINT, SIGTERM, SIGHUP ─────┼▶ RobotLine::end, then Event::Stop
//! the terminal is gone ────────┘
//! w ───────────────────────────▶ Event::Record
//! e f u r g n, 0 to 9 (with --keyboard) ▶ Event::Order to acquisition
//!
//! In a calibration, which has no arm: space, Enter ▶ Event::GoOn; r ▶ Event::Redo
//! ```

use std::os::fd::AsFd;
use std::sync::mpsc::Sender;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{OutputFlags, SetArg, Termios, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd::{getpgrp, read, tcgetpgrp};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use tendon_gesture::{Gesture, GestureSet};
use tendon_messages::Stage;
use tendon_process::Order;
use tendon_transport::now_ns;

use crate::children::Event;
use crate::robot_line::RobotLine;

/// So long after an Esc comes the rest of what an arrow or function key sends, ms.
const SEQUENCE_MS: u8 = 20;

const ESCAPE: u8 = 0x1b;
const CONTROL_C: u8 = 0x03;
const CONTROL_BACKSLASH: u8 = 0x1c;
const CONTROL_Z: u8 = 0x1a;

/// Letters of the paper's gestures, `n` for none of them.
const GESTURE_LETTERS: [(u8, Gesture); 6] = [
    (b'n', Gesture::REST),
    (b'e', Gesture::EXTENSION),
    (b'f', Gesture::FLEXION),
    (b'u', Gesture::ULNAR),
    (b'r', Gesture::RADIAL),
    (b'g', Gesture::GRIP),
];

/// Why the keys cannot be heard.
#[derive(Debug, thiserror::Error)]
pub enum KeyboardError {
    /// There is no terminal.
    #[error("keys need a terminal on standard input")]
    NoTerminal,
    /// The system grants no thread.
    #[error("cannot listen to the keys")]
    Thread(#[source] std::io::Error),
}

/// Lets SIGINT, SIGTERM and SIGHUP (the terminal was closed) end the session. A SIGHUP that is ignored, as by nohup(1),
/// stays so.
///
/// # Errors
///
/// When the system grants no handler or thread.
pub fn stop_on_signals(robot: &RobotLine, events: &Sender<Event>) -> std::io::Result<()> {
    let ends =
        [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| *signal != SIGHUP || !is_ignored(SIGHUP));
    let mut signals = Signals::new(ends)?;
    let (robot, events) = (robot.clone(), events.clone());
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        for _ in signals.forever() {
            robot.end();
            // Nobody listens any more once the session is over.
            let _ = events.send(Event::Stop);
        }
    })?;
    Ok(())
}

/// Whether this process was started with the signal ignored: proc(5).
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// The terminal in raw mode, keys as orders and events; as it was before when dropped.
#[derive(Debug)]
pub struct Keyboard {
    before: Termios,
}

impl Keyboard {
    /// Whether somebody can press keys: standard input is a terminal, and it is this program that it is for.
    pub fn is_there() -> bool {
        tcgetpgrp(std::io::stdin()).is_ok_and(|group| group == getpgrp())
    }

    /// Listens to these keys.
    ///
    /// # Errors
    ///
    /// [`KeyboardError`] when standard input is no terminal.
    pub fn listen(robot: &RobotLine, events: &Sender<Event>, keys: Keys) -> Result<Keyboard, KeyboardError> {
        let before = tcgetattr(std::io::stdin()).map_err(|_| KeyboardError::NoTerminal)?;
        let mut raw = before.clone();
        cfmakeraw(&mut raw);
        // Lines that are printed meanwhile begin at the left all the same.
        raw.output_flags.insert(OutputFlags::OPOST);
        tcsetattr(std::io::stdin(), SetArg::TCSANOW, &raw).map_err(|_| KeyboardError::NoTerminal)?;
        let keyboard = Keyboard { before };
        let (robot, events) = (robot.clone(), events.clone());
        std::thread::Builder::new()
            .name("keyboard".to_owned())
            .spawn(move || hear(&robot, &events, &keys))
            .map_err(KeyboardError::Thread)?;
        Ok(keyboard)
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // If it fails the user's `reset` has to do it; there is nothing else to try.
        let _ = tcsetattr(std::io::stdin(), SetArg::TCSANOW, &self.before);
    }
}

/// Which keys mean something.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Keys {
    /// Stop, arm, record and quit.
    Arm,
    /// The same, and those for the gestures of the simulated person.
    Gestures(GestureSet),
    /// Go on, redo and quit.
    Guide,
}

/// What a key means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Stop,
    Arm,
    Quit,
    Record,
    Gesture(Gesture),
    GoOn,
    Redo,
}

/// The thread: obeys keys until the terminal is gone.
fn hear(robot: &RobotLine, events: &Sender<Event>, keys: &Keys) {
    let mut bytes = [0; 64];
    loop {
        let count = match read(std::io::stdin(), &mut bytes) {
            Err(Errno::EINTR) => continue,
            Err(Errno::EAGAIN) => {
                wait_for_input(PollTimeout::NONE);
                continue;
            }
            // The terminal was closed, or never gives anything again: nobody could stop the arm from it.
            Ok(0) | Err(_) => 0,
            Ok(count) => count,
        };
        let is_heard = |key: &Key| match *key {
            Key::Stop => {
                robot.order(Order::Stop);
                true
            }
            Key::Arm if robot.stood_still() => events.send(Event::LateArm).is_ok(),
            Key::Arm => {
                robot.order(Order::arm_shown_at(now_ns()));
                true
            }
            Key::Quit => quit(robot, events),
            Key::Record => events.send(Event::Record).is_ok(),
            Key::Gesture(gesture) => {
                let order = Order::Gesture { gesture, effort: 1.0 };
                events.send(Event::Order(Stage::Acquisition, order)).is_ok()
            }
            Key::GoOn => events.send(Event::GoOn).is_ok(),
            Key::Redo => events.send(Event::Redo).is_ok(),
        };
        if count == 0 {
            quit(robot, events);
            return;
        }
        if !meaning(&bytes[..count], keys).iter().all(is_heard) {
            return;
        }
    }
}

fn quit(robot: &RobotLine, events: &Sender<Event>) -> bool {
    robot.end();
    events.send(Event::Stop).is_ok()
}

/// Waits for another byte; whether there is one.
fn wait_for_input(timeout: PollTimeout) -> bool {
    let input = std::io::stdin();
    poll(&mut [PollFd::new(input.as_fd(), PollFlags::POLLIN)], timeout).is_ok_and(|count| count > 0)
}

/// The gesture of a key: a letter for the paper's, the class number for any.
fn gesture_of(gestures: &GestureSet, key: u8) -> Option<Gesture> {
    let with_letter = GESTURE_LETTERS.iter().find(|(letter, _)| *letter == key).map(|(_, gesture)| *gesture);
    match with_letter {
        Some(gesture) => gestures.number(gesture).map(|_| gesture),
        None => key.checked_sub(b'0').filter(|number| *number <= 9).and_then(|number| gestures.get(number)),
    }
}

/// What the keys of gestures do, for the person at them.
pub fn gesture_keys(gestures: &GestureSet) -> String {
    let key = |(number, gesture): (usize, Gesture)| {
        let letter = GESTURE_LETTERS.iter().find(|(_, other)| *other == gesture);
        match letter {
            Some((letter, _)) => Some(format!("{} {gesture}", char::from(*letter))),
            None => (number <= 9).then(|| format!("{number} {gesture}")),
        }
    };
    let keys: Vec<String> = gestures.iter().enumerate().filter_map(key).collect();
    format!("keys: {}", keys.join(", "))
}

/// What these bytes mean together, in the order in which to obey: a stop comes before all else, and counts also where the
/// session is to end.
fn meaning(bytes: &[u8], keys: &Keys) -> Vec<Key> {
    let is_guide = *keys == Keys::Guide;
    let is_stop = !is_guide && bytes.contains(&b' ');
    if bytes.first() == Some(&ESCAPE) {
        // Alone it quits; an arrow key sends it before other bytes, which mean nothing here.
        let is_alone = bytes.len() == 1 && !wait_for_input(PollTimeout::from(SEQUENCE_MS));
        return is_stop.then_some(Key::Stop).into_iter().chain(is_alone.then_some(Key::Quit)).collect();
    }
    let pressed = bytes.iter().map(|byte| match *byte {
        // Also what ends or stops a program elsewhere: Ctrl-\\ and Ctrl-Z.
        CONTROL_C | CONTROL_BACKSLASH | CONTROL_Z | b'q' | b'Q' => Some(Key::Quit),
        b' ' | b'\r' | b'\n' if is_guide => Some(Key::GoOn),
        b'r' | b'R' if is_guide => Some(Key::Redo),
        _ if is_guide => None,
        b'a' | b'A' => Some(Key::Arm),
        b'w' | b'W' => Some(Key::Record),
        byte => match keys {
            Keys::Gestures(gestures) => gesture_of(gestures, byte).map(Key::Gesture),
            Keys::Arm | Keys::Guide => None,
        },
    });
    let pressed: Vec<Key> = pressed.flatten().collect();
    match (is_stop, pressed.contains(&Key::Quit)) {
        (true, true) => vec![Key::Stop, Key::Quit],
        (true, false) => vec![Key::Stop],
        (false, true) => vec![Key::Quit],
        (false, false) => pressed.last().copied().into_iter().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_mean_what_the_help_line_says_and_a_stop_comes_before_all_else() {
        assert_eq!(meaning(b" ", &Keys::Arm), [Key::Stop]);
        assert_eq!(meaning(b"a", &Keys::Arm), [Key::Arm]);
        assert_eq!(meaning(b"q", &Keys::Arm), [Key::Quit]);
        assert_eq!(meaning(&[CONTROL_C], &Keys::Arm), [Key::Quit]);
        assert_eq!(meaning(b"w", &Keys::Arm), [Key::Record]);
        assert_eq!(meaning(b"x", &Keys::Arm), []);
        assert_eq!(meaning(b"e", &Keys::Arm), []);
        assert_eq!(meaning(b"e", &Keys::Gestures(GestureSet::default())), [Key::Gesture(Gesture::EXTENSION)]);
        assert_eq!(meaning(b"an r", &Keys::Gestures(GestureSet::default())), [Key::Stop]);
        assert_eq!(meaning(b"aa", &Keys::Gestures(GestureSet::default())), [Key::Arm]);
        assert_eq!(meaning(b"2", &Keys::Gestures(GestureSet::default())), [Key::Gesture(Gesture::FLEXION)]);
        assert_eq!(meaning(b"6", &Keys::Gestures(GestureSet::default())), []);
        assert_eq!(meaning(b"\x1b[A", &Keys::Arm), [], "an arrow key");
    }

    #[test]
    fn in_a_calibration_space_goes_on_and_nothing_speaks_of_an_arm() {
        for bytes in [&b" "[..], b"\r", b"\n"] {
            assert_eq!(meaning(bytes, &Keys::Guide), [Key::GoOn], "{bytes:?}");
        }
        assert_eq!(meaning(b"r", &Keys::Guide), [Key::Redo]);
        assert_eq!(meaning(b"aew0", &Keys::Guide), []);
        assert_eq!(meaning(b" q", &Keys::Guide), [Key::Quit]);
    }

    #[test]
    fn every_gesture_of_a_session_has_a_key() {
        let gestures = ["rest", "fist", "grip"].map(|name| name.parse().unwrap());
        let gestures = GestureSet::new(gestures.to_vec()).unwrap();
        assert_eq!(gesture_keys(&gestures), "keys: n rest, 1 fist, g grip");
        let keys = Keys::Gestures(gestures);
        assert_eq!(meaning(b"1", &keys), [Key::Gesture("fist".parse().unwrap())]);
        assert_eq!(meaning(b"e", &keys), []);
    }

    #[test]
    fn a_stop_counts_whatever_comes_with_it() {
        for bytes in [&b" q"[..], b"q ", b" \x03", b"a q"] {
            assert_eq!(meaning(bytes, &Keys::Arm), [Key::Stop, Key::Quit], "{bytes:?}");
        }
        assert_eq!(meaning(b"\x1b ", &Keys::Arm), [Key::Stop]);
    }
}
