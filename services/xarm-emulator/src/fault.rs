//! Faults, each written as one line of text.

use std::str::FromStr;
use std::time::Duration;

use tendon_xarm::{Mode, StateOrder};

/// Something that goes wrong, or ends. [`FAULTS`] explains each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `emergency-stop`
    EmergencyStop,
    /// `release`
    Release,
    /// `collision`
    Collision,
    /// `error CODE`
    Error(u8),
    /// `warning CODE`
    Warning(u8),
    /// `runaway MM_PER_S`
    Runaway(i16),
    /// `creep MM_PER_S`
    Creep(i16),
    /// `mode N`
    Mode(Mode),
    /// `state N`
    State(StateOrder),
    /// `refuse [COUNT]`
    Refuse(u32),
    /// `gripper-late MS`
    GripperLate(Duration),
    /// `gripper-off`
    GripperOff,
    /// `object PULSES`
    Object(u16),
    /// `drop`
    Drop,
    /// `late MS [COUNT]`
    Late(Duration, u32),
    /// `torn [COUNT]`
    Torn(u32),
    /// `garbage [COUNT]`
    Garbage(u32),
    /// `silent [COUNT]`
    Silent(u32),
}

/// Every form and what it does. COUNT defaults to 1.
pub const FAULTS: [(&str, &str); 18] = [
    (
        "emergency-stop",
        "the emergency stop button is pressed and stays pressed: error 1, motors off; the error returns when cleared, \
         and the motors cannot be enabled",
    ),
    ("release", "the emergency stop button is released; the error stays until a client clears it"),
    ("collision", "error 31: the arm stops"),
    ("error CODE", "any error, 1 to 255: the arm stops in mode 0"),
    ("warning CODE", "any warning, 1 to 255: the arm goes on"),
    ("runaway MM_PER_S", "the flange moves along y regardless of commands until the arm is stopped"),
    (
        "creep MM_PER_S",
        "the flange creeps along y while the arm is commanded to rest and reports that it rests; 0 ends it",
    ),
    ("mode N", "another client sets mode N (0, 1, 2, 4, 5, 6, 7) and sets the arm running"),
    ("state N", "another client sets state N: 0 run, 3 pause, 4 stop, 6 slow down and stop"),
    ("refuse [COUNT]", "the arm refuses the next velocities"),
    (
        "gripper-late MS",
        "from now on the gripper replies this much later, while the arm replies at once; 0 ends it",
    ),
    ("gripper-off", "the gripper's motor is switched off: it stops and refuses to move until it is enabled"),
    ("object PULSES", "an object of this width is put between the fingers, which cannot close further"),
    ("drop", "all connections are cut"),
    ("late MS [COUNT]", "the next replies come this much later and delay all replies behind them"),
    ("torn [COUNT]", "the next replies arrive byte by byte"),
    ("garbage [COUNT]", "random bytes arrive instead of the next replies"),
    ("silent [COUNT]", "the next replies are lost"),
];

/// A line that is not a fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{line}` is not a fault: write {forms}", forms = forms())]
pub struct FaultError {
    line: String,
}

/// All forms in one line.
fn forms() -> String {
    let forms = FAULTS.map(|(form, _)| form);
    let (last, others) = forms.split_last().unwrap_or((&"", &[]));
    format!("{} or {last}", others.join(", "))
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(line: &str) -> Result<Fault, FaultError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        parse(&words).ok_or_else(|| FaultError { line: line.to_owned() })
    }
}

fn parse(words: &[&str]) -> Option<Fault> {
    let (&name, values) = words.split_first()?;
    let code = |word: &str| word.parse().ok().filter(|&code| code > 0);
    let duration = |word: &str| word.parse().ok().map(Duration::from_millis);
    let count = |values: &[&str]| match values {
        [] => Some(1),
        [count] => count.parse().ok(),
        _ => None,
    };
    match (name, values) {
        ("emergency-stop", []) => Some(Fault::EmergencyStop),
        ("release", []) => Some(Fault::Release),
        ("collision", []) => Some(Fault::Collision),
        ("error", [value]) => code(value).map(Fault::Error),
        ("warning", [value]) => code(value).map(Fault::Warning),
        ("runaway", [speed]) => speed.parse().ok().map(Fault::Runaway),
        ("creep", [speed]) => speed.parse().ok().map(Fault::Creep),
        ("mode", [number]) => Mode::from_number(number.parse().ok()?).map(Fault::Mode),
        ("state", [number]) => StateOrder::from_number(number.parse().ok()?).map(Fault::State),
        ("refuse", values) => count(values).map(Fault::Refuse),
        ("gripper-late", [ms]) => duration(ms).map(Fault::GripperLate),
        ("gripper-off", []) => Some(Fault::GripperOff),
        ("object", [width]) => width.parse().ok().map(Fault::Object),
        ("drop", []) => Some(Fault::Drop),
        ("late", [ms, values @ ..]) => Some(Fault::Late(duration(ms)?, count(values)?)),
        ("torn", values) => count(values).map(Fault::Torn),
        ("garbage", values) => count(values).map(Fault::Garbage),
        ("silent", values) => count(values).map(Fault::Silent),
        _ => None,
    }
}

/// Faults of the next replies.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ReplyFaults {
    gripper_late: Duration,
    late: Duration,
    late_count: u32,
    torn_count: u32,
    garbage_count: u32,
    silent_count: u32,
}

/// Fault of one reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReplyFault {
    None,
    Late(Duration),
    Torn,
    Garbage,
    Silent,
}

impl ReplyFaults {
    pub(crate) fn add(&mut self, fault: Fault) {
        match fault {
            Fault::GripperLate(late) => self.gripper_late = late,
            Fault::Late(late, count) => (self.late, self.late_count) = (late, count),
            Fault::Torn(count) => self.torn_count = count,
            Fault::Garbage(count) => self.garbage_count = count,
            Fault::Silent(count) => self.silent_count = count,
            _ => {}
        }
    }

    /// How late replies of the gripper are.
    pub(crate) fn gripper_late(&self) -> Duration {
        self.gripper_late
    }

    /// The fault of the next reply.
    pub(crate) fn take(&mut self) -> ReplyFault {
        for (count, fault) in [
            (&mut self.silent_count, ReplyFault::Silent),
            (&mut self.garbage_count, ReplyFault::Garbage),
            (&mut self.torn_count, ReplyFault::Torn),
            (&mut self.late_count, ReplyFault::Late(self.late)),
        ] {
            if *count > 0 {
                *count -= 1;
                return fault;
            }
        }
        ReplyFault::None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_faults_or_name_what_is_possible() {
        let late = Fault::Late(Duration::from_millis(300), 2);
        assert_eq!("late 300 2".parse(), Ok(late));
        assert_eq!("torn".parse(), Ok(Fault::Torn(1)));
        assert_eq!("error 23".parse(), Ok(Fault::Error(23)));
        assert_eq!("runaway -150".parse(), Ok(Fault::Runaway(-150)));
        assert_eq!("mode 0".parse(), Ok(Fault::Mode(Mode::Position)));
        assert_eq!("state 3".parse(), Ok(Fault::State(StateOrder::Pause)));
        assert_eq!("gripper-late 120".parse(), Ok(Fault::GripperLate(Duration::from_millis(120))));
        for wrong in ["", "late", "error 0", "error 300", "drop it", "runaway", "mode 3", "state 9", "boom"] {
            let error = wrong.parse::<Fault>().unwrap_err();
            assert!(error.to_string().contains("creep MM_PER_S, mode N"), "{error}");
        }
    }

    #[test]
    fn every_form_is_understood_and_explained() {
        for (form, explanation) in FAULTS {
            let line = form.replace("MM_PER_S", "20").replace("MS", "100").replace("CODE", "31");
            let line = line.replace("[COUNT]", "2").replace("PULSES", "400").replace(" N", " 0");
            assert!(line.parse::<Fault>().is_ok() && explanation.len() > 10, "{line}");
        }
    }
}
