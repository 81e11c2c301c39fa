//! What the channels of a recording are, before any is chosen: which are muscles, and in which unit.

use std::path::Path;

use crate::error::RecordingError;
use crate::layout::segments;
use crate::recorder::is_recorded;
use crate::signals::is_signals;
use crate::source::{RecordingSettings, RecordingSource, common_unit};
use crate::table::{self, Channel, ColumnKind, Table, TableError};
use crate::text::Text;

/// The unit in which [`RecordingSource::of_table`] gives `channels` of the table at `path`; empty if it states none for them.
///
/// # Errors
/// When it cannot be opened, is no table, or lacks a channel.
pub fn unit_of_table(path: &Path, channels: &[Channel]) -> Result<String, RecordingError> {
    let (text, _) = Text::open(path)?;
    let table = Table::open(text.bytes(), channels).map_err(RecordingError::table(path))?;
    let columns = table::columns(text.bytes()).map_err(RecordingError::table(path))?;
    Ok(common_unit(&columns, &table.chosen_columns()).0)
}

/// The channels of the table at `path` that are muscles, as far as can be told; of a recording that Tendon made, all. The column
/// of labels, if one is given and there, is none.
///
/// # Errors
/// When it cannot be opened or is no table.
pub fn muscles(path: &Path, label_column: Option<&Channel>) -> Result<Vec<Channel>, RecordingError> {
    muscles_of(path, label_column, table::muscles)
}

/// The first `count` channels of the table at `path` that are muscles, as for [`muscles`].
///
/// # Errors
/// As for [`muscles`], or when there are too few.
pub fn first_muscles(
    path: &Path,
    count: usize,
    label_column: Option<&Channel>,
) -> Result<Vec<Channel>, RecordingError> {
    muscles_of(path, label_column, |columns| table::first_muscles(columns, count))
}

fn muscles_of(
    path: &Path,
    label_column: Option<&Channel>,
    choose: impl FnOnce(&[table::Column]) -> Result<Vec<Channel>, TableError>,
) -> Result<Vec<Channel>, RecordingError> {
    if is_signals(path) {
        let names = RecordingSource::open(
            path,
            &RecordingSettings { channels: vec![0.into()], ..RecordingSettings::default() },
        )?
        .file_names();
        return choose(&table::columns_by_name(&names)).map_err(RecordingError::table(path));
    }
    // What is no table is refused in its own words.
    segments(path, &RecordingSettings::default(), &mut Vec::new())?;
    let (text, _) = Text::open(path)?;
    let columns = table::columns(text.bytes()).and_then(|mut columns| {
        if is_recorded(path) {
            columns.iter_mut().for_each(|column| column.kind = ColumnKind::Muscle);
        }
        if let Some(Ok(place)) = label_column.map(|labels| table::find(&columns, labels)) {
            columns[place].kind = ColumnKind::Label;
        }
        choose(&columns)
    });
    columns.map_err(RecordingError::table(path))
}
