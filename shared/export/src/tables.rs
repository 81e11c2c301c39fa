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

use crate::{ExportError, Staging, Survey};

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
pub const ZONES: &str = "zones.csv";
const SESSION: &str = "session.json";
const COLUMNS: &str = "columns.json";
const CONFIGURATION: &str = "tendon.toml";

/// Writes the session of `survey` as tables to `folder`, in place of those of the same names. `has_read` is told how many
/// bytes of the recording were read so far.
///
/// # Errors
///
/// [`ExportError`]. Nothing is left of an export that failed.
pub fn write_tables(
    survey: &Survey,
    folder: &Path,
    mut has_read: impl FnMut(u64),
) -> Result<(), ExportError> {
    let mut staging = Staging::begin(folder)?;
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
        has_read(reader.bytes_read());
    }
    rows.finish().map_err(&failed)?;
    if let Some(task) = &survey.task {
        let zones = staging.create(ZONES)?;
        rows::zones(task, &columns, zones).map_err(&failed)?;
    }
    staging.write(SESSION, &facts::session(survey))?;
    staging.write(COLUMNS, &columns.to_json())?;
    staging.write(CONFIGURATION, survey.configuration.as_bytes())?;
    staging.keep()
}
