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

use std::path::Path;

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

/// Refuses a folder with anything in it, or, with `replace`, with anything but an earlier export.
///
/// # Errors
///
/// [`ExportError::NotEmpty`], [`ExportError::Foreign`], and [`ExportError::Write`] where it cannot be looked at.
pub fn check_tables(folder: &Path, replace: bool) -> Result<(), ExportError> {
    if !Staging::is_occupied(folder)? {
        return Ok(());
    }
    let path = folder.to_owned();
    if !replace {
        return Err(ExportError::NotEmpty { path });
    }
    // Such as a folder with the settings of somebody, which have the name of those of an export.
    let is_export = TABLES.iter().filter(|table| **table != ZONES).all(|table| folder.join(table).is_file());
    if is_export { Ok(()) } else { Err(ExportError::Foreign { path }) }
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
