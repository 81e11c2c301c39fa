//! Commands and replies: text that ends with an empty line.

/// Longest reply, bytes.
const LONGEST_REPLY: usize = 4096;
/// End of a command and of a reply.
const END: &[u8] = b"\r\n\r\n";
/// What the server says unasked when a trigger ends a run.
const UNASKED: &str = "STOPPED";
/// Types of sensors with several EMG channels, which move the columns of the sensors after them: Quattro, Galileo, Duo.
const SEVERAL_MUSCLES: [&str; 3] = ["Q", "R", "27"];

/// What the server said is no reply.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplyError {
    /// It does not end.
    #[error(
        "a reply of the server is longer than {LONGEST_REPLY} bytes: is this the command port of the Trigno Control Utility?"
    )]
    TooLong,
    /// It is no number.
    #[error("the server answered `{reply}` to {question}, which is no number that can be")]
    Number {
        /// What was asked.
        question: &'static str,
        /// What was answered.
        reply: String,
    },
}

/// A command as it is sent.
pub fn command(text: &str) -> Vec<u8> {
    [text.as_bytes(), END].concat()
}

/// Whether a reply means yes.
pub fn is_yes(reply: &str) -> bool {
    reply.eq_ignore_ascii_case("YES")
}

/// Whether a sensor of this type, as `SENSOR n TYPE?` answers it, has one EMG channel, in the column of its slot.
pub fn holds_one_muscle(sensor_type: &str) -> bool {
    !SEVERAL_MUSCLES.contains(&sensor_type.trim())
}

/// Rate of the EMG samples, Hz, from the replies to `FRAME INTERVAL?` (s) and `MAX SAMPLES EMG?`.
///
/// # Errors
///
/// [`ReplyError::Number`].
pub fn frame_rate_hz(interval: &str, samples: &str) -> Result<f64, ReplyError> {
    let number = |question, reply: &str, within: std::ops::RangeInclusive<f64>| {
        let number = reply.trim().parse::<f64>().ok().filter(|number| within.contains(number));
        number.ok_or_else(|| ReplyError::Number { question, reply: reply.to_owned() })
    };
    let interval_s = number("FRAME INTERVAL?", interval, 1e-4..=1.0)?;
    let samples = number("MAX SAMPLES EMG?", samples, 1.0..=1e4)?;
    // To the thousandth: 27 samples in 0.0135 s are 2000 Hz and not a hair more.
    Ok((samples / interval_s * 1e3).round() / 1e3)
}

/// Gathers bytes of the command port into replies.
#[derive(Clone, Debug, Default)]
pub struct Replies {
    bytes: Vec<u8>,
}

impl Replies {
    /// Takes the bytes of a read.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next reply that has come as a whole, without its end and blanks around it. What the server says unasked is passed
    /// over.
    ///
    /// # Errors
    ///
    /// [`ReplyError::TooLong`].
    pub fn next_reply(&mut self) -> Result<Option<String>, ReplyError> {
        loop {
            let Some(end) = self.bytes.windows(END.len()).position(|window| window == END) else {
                return if self.bytes.len() > LONGEST_REPLY { Err(ReplyError::TooLong) } else { Ok(None) };
            };
            let reply = String::from_utf8_lossy(&self.bytes[..end]).trim().to_owned();
            self.bytes.drain(..end + END.len());
            if !reply.is_empty() && reply != UNASKED {
                return Ok(Some(reply));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn replies(bytes: &[u8], read: usize) -> Vec<String> {
        let mut replies = Replies::default();
        let mut found = Vec::new();
        for read in bytes.chunks(read) {
            replies.push(read);
            while let Some(reply) = replies.next_reply().unwrap() {
                found.push(reply);
            }
        }
        found
    }

    #[test]
    fn a_command_ends_with_an_empty_line() {
        assert_eq!(command("START"), b"\x53\x54\x41\x52\x54\x0d\x0a\x0d\x0a");
    }

    #[test]
    fn replies_that_come_torn_or_joined_are_told_apart_and_what_is_unasked_is_passed_over() {
        let bytes = b"Delsys Trigno System Digital Protocol Version 3.6.0 \r\n\r\nOK\r\n\r\nSTOPPED\r\n\r\n0.0135\r\n\r\nYE";
        for read in [1, 3, 7, 1000] {
            let found = replies(bytes, read);
            assert_eq!(
                found,
                ["Delsys Trigno System Digital Protocol Version 3.6.0", "OK", "0.0135"],
                "{read}"
            );
        }
    }

    #[test]
    fn a_reply_without_end_is_refused() {
        let mut endless = Replies::default();
        endless.push(&[b'x'; LONGEST_REPLY + 1]);
        assert_eq!(endless.next_reply(), Err(ReplyError::TooLong));
    }

    #[test]
    fn rates_are_those_of_the_guide() {
        assert_eq!(frame_rate_hz("0.0135", "27"), Ok(2000.0));
        assert_eq!(frame_rate_hz("0.0135", "26"), Ok(1925.926));
        assert_eq!(frame_rate_hz("0.0135", "15"), Ok(1111.111));
        for (interval, samples) in
            [("0", "27"), ("NaN", "27"), ("0.0135", "0"), ("0.0135", "CANNOT COMPLETE")]
        {
            assert!(frame_rate_hz(interval, samples).is_err(), "{interval} {samples}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..6000)) {
            let mut replies = Replies::default();
            replies.push(&bytes);
            while let Ok(Some(_)) = replies.next_reply() {}
        }
    }
}
