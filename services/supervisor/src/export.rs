//! `tendon export`: a recorded session in the formats of others.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{ArgGroup, Args};
use tendon_export::{
    BidsFacts, ExportError, Staging, Survey, check_replaceable, is_exported_xdf, write_bids, write_tables,
    write_xdf,
};
use tendon_output::OutputFile;
use tendon_session_file::FILE_NAME;

use crate::Failure;
use crate::output::{counted, print, tell};
use crate::progress::Progress;

/// Command line of `tendon export`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("formats").required(true).multiple(true).args(["csv", "bids", "xdf"])))]
pub struct Options {
    /// A recorded session: its session.mcap, or the folder that holds it.
    session: PathBuf,
    /// Write tables for R, MATLAB and pandas into this folder.
    #[arg(long, value_name = "FOLDER")]
    csv: Option<PathBuf>,
    /// Add the session to the BIDS data set in this folder, which is made if it is not there.
    #[arg(long, value_name = "FOLDER")]
    bids: Option<PathBuf>,
    /// Write signal, predictions, decisions, commands and markers as streams of an XDF file.
    #[arg(long, value_name = "FILE")]
    xdf: Option<PathBuf>,
    /// BIDS: what was done, in a word; by default `zones` after such a task, else `control`.
    #[arg(long, value_name = "WORD", requires = "bids", value_parser = task)]
    task: Option<String>,
    /// BIDS: where the electrodes were, and how the places were found.
    #[arg(long, value_name = "TEXT", requires = "bids")]
    placement: Option<String>,
    /// BIDS: the reference electrode, or Bipolar.
    #[arg(long, value_name = "TEXT", requires = "bids")]
    reference: Option<String>,
    /// BIDS: frequency of the mains, Hz.
    #[arg(long, value_name = "HZ", requires = "bids", value_parser = mains)]
    power_line_hz: Option<f64>,
    /// Replace an earlier export.
    #[arg(long)]
    force: bool,
}

/// A word of letters and digits.
fn task(text: &str) -> Result<String, String> {
    let is_word = !text.is_empty() && text.chars().all(|character| character.is_ascii_alphanumeric());
    is_word.then(|| text.to_owned()).ok_or_else(|| "use letters and digits only, such as reach".to_owned())
}

fn mains(text: &str) -> Result<f64, String> {
    let hz = text.parse().ok().filter(|hz: &f64| hz.is_finite() && *hz > 0.0);
    hz.ok_or_else(|| "give a frequency in Hz, such as 50".to_owned())
}

/// Exports a session.
pub fn export(options: &Options) -> Result<(), Failure> {
    let path = file_of(&options.session);
    if let Some(folder) = &options.csv {
        check_tables(folder, options.force)?;
    }
    let xdf = options.xdf.as_deref().map(|file| check_file(file, options.force)).transpose()?;
    // The one that tells what is there, that of the tables, two of BIDS, that of XDF.
    let passes = 1
        + usize::from(options.csv.is_some())
        + 2 * usize::from(options.bids.is_some())
        + usize::from(xdf.is_some());
    let mut reading = Reading::of(&path, passes);
    let survey = Survey::read(&path, |bytes| reading.show(bytes)).map_err(failure)?;
    reading.passed(1);
    let mut written = vec![summary(&survey)];
    if let Some(folder) = &options.csv {
        write_tables(&survey, folder, |bytes| reading.show(bytes)).map_err(failure)?;
        reading.passed(1);
        written.push(format!("tables in {}", folder.display()));
    }
    if let Some(folder) = &options.bids {
        let facts = BidsFacts {
            task: options.task.clone(),
            placement: options.placement.clone(),
            reference: options.reference.clone(),
            power_line_hz: options.power_line_hz,
        };
        let recording = write_bids(&survey, &facts, folder, options.force, |bytes| reading.show(bytes))
            .map_err(failure)?;
        reading.passed(2);
        written.push(recording.display().to_string());
    }
    if let Some(file) = &xdf {
        file.write(|output| write_xdf(&survey, output, |bytes| reading.show(bytes)))
            .map_err(Failure::running)?;
        written.push(file.path().display().to_string());
    }
    drop(reading);
    if !survey.is_whole {
        tell(format_args!(
            "{}: the recording was cut, as when the recorder is killed: what came after {:.1} s is not in it",
            path.display(),
            survey.duration_s
        ));
    }
    print(written.join("\n  ")).map_err(Failure::running)
}

/// A file for this user alone. One that is there already is refused without `force`, and with it unless it is an export.
fn check_file(path: &Path, force: bool) -> Result<OutputFile, Failure> {
    let file = OutputFile::check(path).map_err(Failure::input)?.private();
    if !file.replaces() {
        return Ok(file);
    }
    if !force {
        return Err(Failure::input(ExportError::Exists { path: path.to_owned() }));
    }
    let mut beginning = Vec::new();
    let read = File::open(path).and_then(|file| file.take(512).read_to_end(&mut beginning));
    read.with_context(|| format!("cannot read {}", path.display())).map_err(Failure::input)?;
    if !is_exported_xdf(&beginning) {
        return Err(Failure::input(ExportError::NoExport { path: path.to_owned() }));
    }
    Ok(file)
}

/// What was exported, in one line.
fn summary(survey: &Survey) -> String {
    let gaps = match survey.gaps.len() {
        0 => String::new(),
        gaps => format!(", with {}", counted(gaps, "gap", "gaps")),
    };
    format!(
        "exported {:.1} s of session {}, {} at {} Hz{gaps}",
        survey.duration_s,
        survey.session,
        counted(survey.channels.len(), "channel", "channels"),
        survey.sample_rate_hz
    )
}

/// The file of the session that was named by it or by its folder.
fn file_of(session: &Path) -> PathBuf {
    if session.is_dir() { session.join(FILE_NAME) } else { session.to_owned() }
}

/// Refuses a folder with anything in it, or, with `force`, with anything but an earlier export.
fn check_tables(folder: &Path, force: bool) -> Result<(), Failure> {
    if !Staging::is_occupied(folder).map_err(Failure::input)? {
        return Ok(());
    }
    if !force {
        return Err(Failure::input(ExportError::NotEmpty { path: folder.to_owned() }));
    }
    check_replaceable(folder).map_err(Failure::input)
}

fn failure(error: ExportError) -> Failure {
    match error {
        ExportError::Write { .. } => Failure::running(error),
        _ => Failure::input(error),
    }
}

/// Progress of reading the recording, as often as that takes.
struct Reading {
    progress: Progress,
    bytes_of_a_pass: u64,
    bytes_before: u64,
}

impl Reading {
    fn of(path: &Path, passes: usize) -> Reading {
        let bytes_of_a_pass = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        let progress = Progress::of(megabytes(bytes_of_a_pass) * passes, "MB");
        Reading { progress, bytes_of_a_pass, bytes_before: 0 }
    }

    fn show(&mut self, bytes: u64) {
        self.progress.show(megabytes(self.bytes_before + bytes), String::new);
    }

    fn passed(&mut self, passes: u64) {
        self.bytes_before += passes * self.bytes_of_a_pass;
    }
}

fn megabytes(bytes: u64) -> usize {
    (bytes / 1_000_000) as usize
}
