//! What can go wrong with LSL.

use std::path::PathBuf;

/// What can go wrong with LSL.
#[derive(Debug, thiserror::Error)]
pub enum LslError {
    /// There is no liblsl.
    #[error(
        "liblsl, which speaks LSL, was not found: run scripts/fetch-libraries lsl, or name a liblsl.so in \
         acquisition.lsl.library or LSL_LIBRARY"
    )]
    NoLibrary,
    /// A file cannot be used as liblsl.
    #[error("{}: cannot be used as liblsl: {reason}; scripts/fetch-libraries lsl fetches one that fits", path.display())]
    Library {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The stream ended, or its connection.
    #[error("the stream `{stream}` has ended, or the connection to it: start its program again")]
    Lost {
        /// Its name.
        stream: String,
    },
    /// The stream's computer did not answer in time.
    #[error(
        "the stream `{stream}` does not answer ({what}): do firewalls let UDP and TCP 16571 to 16604 pass, both ways?"
    )]
    Timeout {
        /// Its name.
        stream: String,
        /// What was asked.
        what: &'static str,
    },
    /// liblsl refuses.
    #[error("liblsl refuses {what} of `{stream}` (error {code})")]
    Refused {
        /// The stream's name.
        stream: String,
        /// What was asked.
        what: &'static str,
        /// liblsl's number of the error.
        code: i32,
    },
    /// A text with a zero byte in it.
    #[error("`{text}` holds a zero byte, which LSL cannot carry")]
    Text {
        /// The text.
        text: String,
    },
    /// No thread or socket pair for the reader.
    #[error("cannot start the thread that reads the stream")]
    Thread(#[source] std::io::Error),
}
