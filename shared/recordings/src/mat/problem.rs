//! What can be wrong with a MAT-file.

use std::io;

/// What can be wrong with a MAT-file. Each message says what to do.
#[derive(Debug, thiserror::Error)]
pub enum MatError {
    /// What the system says of the file.
    #[error("cannot be read ({0}); check its permissions, or copy it again if it was cut off")]
    Read(io::Error),
    /// A kind of HDF5 that MATLAB 7.3 does not write.
    #[error("is not read: {0}; load it in MATLAB and save it again with `save -v7`")]
    Hdf5(&'static str),
    /// Something else.
    #[error("is not a MAT-file: save it with `save -v7` or `save -v7.3`")]
    NoMatFile,
    /// Written on a machine of another byte order.
    #[error("has its bytes in big-endian order: load it in MATLAB and save it again with `save -v7`")]
    BigEndian,
    /// Contents that contradict themselves.
    #[error("is damaged: {0}; copy it again")]
    Damaged(&'static str),
    /// A variable that is not there.
    #[error("has no variable `{name}` (it has: {})", .available.join(", "))]
    NoVariable {
        /// The variable asked for.
        name: &'static str,
        /// Those that are there.
        available: Vec<String>,
    },
    /// A variable that is not a matrix of real numbers.
    #[error("variable `{name}` is {found}, not {expected}")]
    Shape {
        /// The variable.
        name: &'static str,
        /// What it is.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A column beyond the last one.
    #[error("there is no channel {channel}: variable `{name}` has {columns} (channels 0 to {last}); choose among them", last = .columns - 1)]
    NoColumn {
        /// The variable.
        name: &'static str,
        /// The channel asked for.
        channel: usize,
        /// Columns of the matrix.
        columns: usize,
    },
    /// One column chosen twice.
    #[error("channel {0} is chosen twice: choose each channel once")]
    ChosenTwice(usize),
    /// NaN, infinity, or a number too large for 32-bit floating point.
    #[error(
        "sample {row} of channel {column} is not finite: cut the recording there or choose other channels"
    )]
    NotFinite {
        /// Row, counted from 0.
        row: usize,
        /// Column, counted from 0.
        column: usize,
    },
}

/// Said of values where they are read.
pub(super) const OTHER_COUNT: &str = "the values are not as many as the dimensions say";

// Not `#[from]`: that would make the system's words a source, too, and they would be said twice.
impl From<io::Error> for MatError {
    fn from(error: io::Error) -> MatError {
        MatError::Read(error)
    }
}
