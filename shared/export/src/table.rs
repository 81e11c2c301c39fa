//! A table of comma-separated values (RFC 4180) that R, MATLAB and pandas read at once: one line of names, then rows. What is
//! not known is an empty cell.

use std::fmt::{Display, Write as _};
use std::io::{self, Write};

use tendon_session_file::Number;

/// A table that is being written.
#[derive(Debug)]
pub(crate) struct Table<W: Write> {
    rows: csv::Writer<W>,
    cell: String,
}

impl<W: Write> Table<W> {
    /// Begins a table with these columns.
    pub(crate) fn begin(
        output: W,
        columns: impl IntoIterator<Item = impl AsRef<str>>,
    ) -> io::Result<Table<W>> {
        let mut table = Table {
            rows: csv::WriterBuilder::new().flexible(false).from_writer(output),
            cell: String::new(),
        };
        for column in columns {
            table.rows.write_field(column.as_ref())?;
        }
        table.end_row()?;
        Ok(table)
    }

    /// The next cell of the row.
    pub(crate) fn cell(&mut self, value: impl Display) -> io::Result<()> {
        self.cell.clear();
        // Writing to a text cannot fail.
        let _ = write!(self.cell, "{value}");
        Ok(self.rows.write_field(&self.cell)?)
    }

    /// A cell that may be empty.
    pub(crate) fn optional(&mut self, value: Option<impl Display>) -> io::Result<()> {
        match value {
            Some(value) => self.cell(value),
            None => Ok(self.rows.write_field("")?),
        }
    }

    /// A time in s, to 0.1 us.
    pub(crate) fn seconds(&mut self, time_s: f64) -> io::Result<()> {
        self.cell(format_args!("{time_s:.7}"))
    }

    /// A number; empty for NaN.
    pub(crate) fn number(&mut self, number: f32) -> io::Result<()> {
        self.optional(Some(number).filter(|number| !number.is_nan()))
    }

    /// So many cells of numbers; those that there are none for stay empty.
    pub(crate) fn numbers(&mut self, numbers: &[Number], count: usize) -> io::Result<()> {
        (0..count).try_for_each(|place| self.number(numbers.get(place).map_or(f32::NAN, |number| number.0)))
    }

    /// Ends the row.
    pub(crate) fn end_row(&mut self) -> io::Result<()> {
        Ok(self.rows.write_record(None::<&[u8]>)?)
    }

    /// Ends the table.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.rows.flush()
    }
}
