//! What may go wrong with an amplifier.

use std::str::FromStr;
use std::time::Duration;

/// All faults: how they are written, and what they do.
const FAULTS: [(&str, &str); 8] = [
    ("lose N", "the next N samples are lost, and counted as lost where the amplifier counts"),
    ("torn N", "the next N packets come byte by byte"),
    (
        "silent S",
        "nothing comes for S seconds, though the connection stands; what is measured meanwhile is lost",
    ),
    ("late S", "everything comes S seconds late from now on, until it is connected anew"),
    ("stuck S", "the first electrode holds its value for S seconds, as a sensor that is out of reach"),
    ("garbage", "1000 random bytes come between two packets"),
    ("close", "the amplifier closes the connection, and can be connected again at once"),
    ("away S", "it closes the connection and is away for S seconds"),
];

/// All faults as a command line's help lists them.
pub fn fault_help() -> String {
    let mut help = "Faults, on standard input:".to_owned();
    for (form, explanation) in FAULTS {
        help += &format!("\n  {form:<10} {explanation}");
    }
    help
}

/// A fault, as a user asks for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Samples are lost.
    Lose(u64),
    /// Packets come byte by byte.
    Torn(u64),
    /// Nothing comes for so long.
    Silent(Duration),
    /// Everything comes so late.
    Late(Duration),
    /// The first electrode holds its value for so long.
    Stuck(Duration),
    /// Random bytes come.
    Garbage,
    /// The connection is closed, and the amplifier is away for so long.
    Away(Duration),
}

/// No fault is written like this.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no fault: write lose N, torn N, silent S, late S, stuck S, garbage, close or away S")]
pub struct FaultError {
    text: String,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Fault, FaultError> {
        let wrong = || FaultError { text: text.to_owned() };
        let words: Vec<&str> = text.split_whitespace().collect();
        let count = |word: &str| word.parse().map_err(|_| wrong());
        let seconds = |word: &str| {
            let seconds = word.parse::<f64>().ok().filter(|seconds| (0.0..=3600.0).contains(seconds));
            seconds.map(Duration::from_secs_f64).ok_or_else(wrong)
        };
        match words[..] {
            ["lose", samples] => Ok(Fault::Lose(count(samples)?)),
            ["torn", packets] => Ok(Fault::Torn(count(packets)?)),
            ["silent", time] => Ok(Fault::Silent(seconds(time)?)),
            ["late", time] => Ok(Fault::Late(seconds(time)?)),
            ["stuck", time] => Ok(Fault::Stuck(seconds(time)?)),
            ["garbage"] => Ok(Fault::Garbage),
            ["close"] => Ok(Fault::Away(Duration::ZERO)),
            ["away", time] => Ok(Fault::Away(seconds(time)?)),
            _ => Err(wrong()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_as_the_help_writes_them() {
        for (form, _) in FAULTS {
            let text = form.replace(['N', 'S'], "2");
            text.parse::<Fault>().unwrap();
        }
        assert_eq!("silent 0.5".parse(), Ok(Fault::Silent(Duration::from_millis(500))));
        for wrong in ["", "lose", "lose -1", "silent NaN", "late 1e9", "close 1"] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }
}
