//! A file as bytes in memory that the system loads as they are read, and unloads again.

use std::io;
use std::path::Path;

use memmap2::{Advice, Mmap, UncheckedAdvice};

/// Pages are given back each time this many bytes have been read.
const RELEASE_BYTES: usize = 4 << 20;

/// A file that is mapped, not loaded. It must not be shortened while it is read: the system then ends the
/// process (SIGBUS), as for every memory map.
#[derive(Debug)]
pub(crate) struct MappedFile {
    map: Mmap,
    released: usize,
}

impl MappedFile {
    /// Maps the file at `path`.
    #[expect(unsafe_code, reason = "a memory map can be changed from outside")]
    pub(crate) fn open(path: &Path) -> io::Result<MappedFile> {
        let file = tendon_input::open(path)?;
        // SAFETY: the bytes are only ever read, and as bytes, for which every value is valid. Should another
        // process write to the file, the parser sees some old and some new bytes, each of which it checks
        // for itself: at worst it reports a broken line.
        let map = unsafe { Mmap::map(&file)? };
        // Only a hint for read-ahead: a file system that refuses it is read all the same.
        let _ = map.advise(Advice::Sequential);
        Ok(MappedFile { map, released: 0 })
    }

    /// The content.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Says that everything before `position` has been read, so that a long recording does not pile up in
    /// this process's memory.
    #[inline]
    pub(crate) fn release_before(&mut self, position: usize) {
        if position - self.released >= RELEASE_BYTES {
            self.release(position);
        }
    }

    #[cold]
    #[expect(unsafe_code, reason = "for other kinds of memory, this advice loses their content")]
    fn release(&mut self, position: usize) {
        let range = position - self.released;
        // SAFETY: the map is of a file and read-only, so released pages hold nothing of their own: if read
        // again, they come from the file with the same content.
        let advice =
            unsafe { self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, self.released, range) };
        // Only memory use depends on it.
        let _ = advice;
        self.released = position;
    }
}
