//! A session as tidy tables: one row an observation, one file a kind of it.
//!
//! ```text
//! blocks ────────▶ signal.csv        a row a sample
//! predictions ───▶ predictions.csv   ┐
//! commands ──────▶ decisions.csv     ├ a row a window, joined by `window`
//!             └──▶ commands.csv      ┘
//! states ────────▶ arm.csv           a row a state
//! cues ──────────▶ trials.csv        a row a gesture that was asked for
//! events, cues ──▶ events.csv        a row a stop, note, cue, restart, change of permission
//! task ──────────▶ zones.csv         a row a zone, where there was a task
//! Survey ────────▶ session.json, columns.json (units and meanings), tendon.toml
//! ```

mod columns;
mod facts;
mod rows;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde_json::Value;
use tendon_session_file::{Message, Reader};

use crate::staging::Staging;
use crate::{ExportError, Survey};

use columns::Columns;
use rows::Rows;

/// Everything that an export may consist of.
pub const TABLES: [&str; 11] = [
    "signal.csv",
    "predictions.csv",
    "decisions.csv",
    "commands.csv",
    "arm.csv",
    "events.csv",
    "trials.csv",
    ZONES,
    SESSION,
    COLUMNS,
    CONFIGURATION,
];

/// The table that there is only after a task.
const ZONES: &str = "zones.csv";
const SESSION: &str = "session.json";
const COLUMNS: &str = "columns.json";
const CONFIGURATION: &str = "tendon.toml";
/// More than any line of names or description of columns, bytes.
const LARGEST_HEAD: u64 = 4 << 20;

/// Refuses a folder whose files no export wrote, by their names and columns: other people's must not be replaced.
///
/// # Errors
///
/// [`ExportError::NoExport`] with the file that is none of an export, or the folder if one is missing.
pub(crate) fn check_replaceable(folder: &Path) -> Result<(), ExportError> {
    let columns: Value = head(&folder.join(COLUMNS))
        .and_then(|bytes| serde_json::from_slice(&bytes).ok())
        .ok_or_else(|| ExportError::NoExport { path: folder.to_owned() })?;
    for file in TABLES {
        let path = folder.join(file);
        let has_columns = |table: &str| {
            let bytes = head(&path).unwrap_or_default();
            let mut rows = csv::Reader::from_reader(&bytes[..]);
            let described =
                columns[table].as_array().into_iter().flatten().map(|column| column["name"].as_str());
            rows.headers().is_ok_and(|names| names.iter().map(Some).eq(described))
        };
        let is_missing = std::fs::symlink_metadata(&path).is_err();
        if is_missing && file != ZONES {
            return Err(ExportError::NoExport { path: folder.to_owned() });
        }
        let is_own = path.is_file() && file.strip_suffix(".csv").is_none_or(has_columns);
        if !(is_missing || is_own) {
            return Err(ExportError::NoExport { path });
        }
    }
    Ok(())
}

/// The beginning of a file; `None` where there is none to be read.
fn head(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let is_file = path.is_file();
    let file = is_file.then(|| File::open(path).ok()).flatten()?;
    file.take(LARGEST_HEAD).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// Refuses a folder with anything in it, or, with `replace`, with anything but an earlier export.
///
/// # Errors
///
/// [`ExportError::NotEmpty`], [`ExportError::NoExport`], and [`ExportError::Write`] where it cannot be looked at.
pub fn check_tables(folder: &Path, replace: bool) -> Result<(), ExportError> {
    if !Staging::is_occupied(folder)? {
        return Ok(());
    }
    if !replace {
        return Err(ExportError::NotEmpty { path: folder.to_owned() });
    }
    check_replaceable(folder)
}

/// Writes the session of `survey` as tables to `folder`; with `replace` in place of an earlier export. `has_read` is told how
/// many bytes of the recording were read so far, and may end the export.
///
/// # Errors
///
/// [`ExportError`], and as [`check_tables`]. Nothing is left of an export that failed.
pub fn write_tables(
    survey: &Survey,
    folder: &Path,
    replace: bool,
    mut has_read: impl FnMut(u64) -> Result<(), ExportError>,
) -> Result<(), ExportError> {
    let mut staging = Staging::begin(folder)?;
    // Another export may have been put there since it was looked at.
    check_tables(folder, replace)?;
    // First, so that the files of an export that is killed say whose they are.
    staging.write(SESSION, &facts::session(survey))?;
    let columns = Columns::of(survey);
    let mut rows = Rows::begin(survey, &columns, &mut staging)?;
    let mut reader = Reader::open(&survey.path)?;
    let failed = ExportError::writing(folder);
    while let Some(message) = reader.next_message()? {
        match &message {
            Message::Block(block) => rows.block(block),
            Message::Prediction(prediction) => rows.prediction(prediction),
            Message::Command(command) => rows.command(command),
            Message::State(state) => rows.state(state),
            Message::Event(event) => rows.event(event),
            Message::Cue(cue) => {
                rows.cue(cue);
                Ok(())
            }
            Message::Window(_) | Message::Measurement(_) => Ok(()),
        }
        .map_err(&failed)?;
        has_read(reader.bytes_read())?;
    }
    rows.finish().map_err(&failed)?;
    if let Some(task) = &survey.task {
        let zones = staging.create(ZONES)?;
        rows::zones(task, &columns, zones).map_err(&failed)?;
    }
    staging.write(COLUMNS, &columns.to_json())?;
    staging.write(CONFIGURATION, survey.configuration.as_bytes())?;
    staging.keep()?;
    remove_old_zones(folder, survey)
}

/// The zones of an earlier export are none of a session without a task.
fn remove_old_zones(folder: &Path, survey: &Survey) -> Result<(), ExportError> {
    let zones = folder.join(ZONES);
    if survey.task.is_none() && zones.is_file() {
        std::fs::remove_file(&zones).map_err(ExportError::writing(&zones))?;
    }
    Ok(())
}
