//! Files that a command writes: checked before the command starts, and written whole or not at all.
//!
//! ```text
//! before anything starts   OutputFile::check ─▶ folder there and writable? target no folder?
//! at the end               write ─▶ temporary file beside ─▶ fsync ─▶ rename over the target
//!                          collect ─▶ every file is written, whatever became of the others; all errors at once
//! ```
//!
//! The temporary file is locked, so that what a command that was killed has left is known and removed by the next one that
//! writes the same file.
//!
//! A file that is there already is replaced: people run a command again with the same options. It stays whole until the
//! new one is complete, and [`OutputFile::replaces`] lets the command say so before it starts. Devices and pipes, such
//! as /dev/stdout, are written to directly. [`OutputFile::only_new`] replaces nothing.
#![forbid(unsafe_code)]

mod distinct;
mod error;
mod file;
mod folder;

pub use distinct::check_distinct;
pub use error::{OutputError, OutputErrors, collect};
pub use file::{OutputFile, is_temporary};
pub use folder::OutputFolder;
