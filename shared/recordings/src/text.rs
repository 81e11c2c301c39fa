//! The text of a table, as far as it is read.

use std::path::Path;

use crate::error::RecordingError;
use crate::mapped::MappedFile;
use crate::recorder::is_recorded;
use crate::segment::Notice;

/// The text of a table that is read: of a recording that Tendon made, whole lines only.
#[derive(Debug)]
pub(crate) struct Text {
    file: MappedFile,
    /// Bytes of it that are read.
    length: usize,
}

impl Text {
    /// Maps the file at `path`, and says what is left out of it.
    pub(crate) fn open(path: &Path) -> Result<(Text, Option<Notice>), RecordingError> {
        let file = MappedFile::open(path).map_err(RecordingError::open(path))?;
        let bytes = file.bytes();
        // Only of these the end is looked for: a file of somebody else's may be of any size, without a line.
        if bytes.ends_with(b"\n") || !is_recorded(path) {
            let length = bytes.len();
            return Ok((Text { file, length }, None));
        }
        let length = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
        let newlines = bytes[..length].iter().filter(|byte| **byte == b'\n').count() as u64;
        // The first line has the names of the channels.
        let notice = Notice::CutShort { file: path.to_owned(), lines: newlines.saturating_sub(1) };
        Ok((Text { file, length }, Some(notice)))
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.file.bytes()[..self.length]
    }

    /// Gives memory back that holds what stands before `position`.
    pub(crate) fn release_before(&mut self, position: usize) {
        self.file.release_before(position);
    }
}
