//! What can be made to go wrong, each as one line of text.

use std::str::FromStr;
use std::time::Duration;

/// One thing that goes wrong, or is put right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `emergency-stop`: the button is pressed.
    EmergencyStop,
    /// `release`: the button is released; the error stays until it is cleared.
    Release,
    /// `collision`: error 31.
    Collision,
    /// `error CODE`: any error.
    Error(u8),
    /// `warning CODE`: any warning.
    Warning(u8),
    /// `runaway MM_PER_S`: the flange goes along y whatever it is told, until the arm is stopped.
    Runaway(i16),
    /// `drop`: all connections are cut.
    Drop,
    /// `late MS [COUNT]`: the next replies come so much later.
    Late(Duration, u32),
    /// `torn [COUNT]`: the next replies come byte by byte.
    Torn(u32),
    /// `garbage [COUNT]`: random bytes come in place of the next replies.
    Garbage(u32),
    /// `silent [COUNT]`: the next replies do not come.
    Silent(u32),
}

/// A line that is no fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{line}` is no fault: write emergency-stop, release, collision, error CODE, warning CODE, runaway MM_PER_S, drop, \
     late MS [COUNT], torn [COUNT], garbage [COUNT] or silent [COUNT]"
)]
pub struct FaultError {
    line: String,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(line: &str) -> Result<Fault, FaultError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = || FaultError { line: line.to_owned() };
        let count = |place: usize| match words.get(place) {
            None => Ok(1),
            Some(word) => word.parse().map_err(|_| wrong()),
        };
        let code =
            || words.get(1).and_then(|word| word.parse().ok()).filter(|&code| code > 0).ok_or_else(wrong);
        let (fault, most_words) = match words.first().copied() {
            Some("emergency-stop") => (Fault::EmergencyStop, 1),
            Some("release") => (Fault::Release, 1),
            Some("collision") => (Fault::Collision, 1),
            Some("drop") => (Fault::Drop, 1),
            Some("error") => (Fault::Error(code()?), 2),
            Some("warning") => (Fault::Warning(code()?), 2),
            Some("runaway") => {
                let speed = words.get(1).and_then(|word| word.parse().ok()).ok_or_else(wrong)?;
                (Fault::Runaway(speed), 2)
            }
            Some("late") => {
                let ms = words.get(1).and_then(|word| word.parse().ok()).ok_or_else(wrong)?;
                (Fault::Late(Duration::from_millis(ms), count(2)?), 3)
            }
            Some("torn") => (Fault::Torn(count(1)?), 2),
            Some("garbage") => (Fault::Garbage(count(1)?), 2),
            Some("silent") => (Fault::Silent(count(1)?), 2),
            _ => return Err(wrong()),
        };
        if words.len() <= most_words { Ok(fault) } else { Err(wrong()) }
    }
}

/// What goes wrong with the next replies.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ReplyFaults {
    late: Duration,
    late_count: u32,
    torn_count: u32,
    garbage_count: u32,
    silent_count: u32,
}

/// What goes wrong with one reply.
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
            Fault::Late(late, count) => (self.late, self.late_count) = (late, count),
            Fault::Torn(count) => self.torn_count = count,
            Fault::Garbage(count) => self.garbage_count = count,
            Fault::Silent(count) => self.silent_count = count,
            _ => {}
        }
    }

    /// What goes wrong with the next reply.
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
        for wrong in ["", "late", "error 0", "error 300", "drop it", "runaway", "boom"] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }
}
