//! `tendon export`: a recorded session in the formats of others.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::{ArgGroup, Args};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use tendon_export::{
    BidsFacts, ExportError, Survey, check_tables, is_exported_xdf, write_bids, write_tables, write_xdf,
};
use tendon_output::{OutputFile, OutputFolder, check_distinct};
use tendon_people::PersonInUse;

use crate::Failure;
use crate::output::{counted, print, tell};
use crate::progress::Progress;
use crate::recorded::{file_of, why_no_end};

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
    let path = file_of(&options.session).map_err(Failure::input)?;
    if let Some(folder) = &options.csv {
        check_tables(folder, options.force).map_err(Failure::input)?;
    }
    let xdf = options.xdf.as_deref().map(|file| check_file(file, options.force)).transpose()?;
    let folders = options.csv.iter().chain(&options.bids).map(|folder| OutputFolder::check(folder));
    let folders: Vec<OutputFolder> = folders.collect::<Result<_, _>>().map_err(Failure::input)?;
    check_distinct(&xdf, &folders, [path.as_path()]).map_err(Failure::input)?;
    // The one that tells what is there, that of the tables, two of BIDS, that of XDF.
    let passes = 1
        + usize::from(options.csv.is_some())
        + 2 * usize::from(options.bids.is_some())
        + usize::from(xdf.is_some());
    let mut reading = Reading::of(&path, passes).map_err(Failure::running)?;
    let survey = Survey::read(&path, |bytes| reading.show(bytes)).map_err(failure)?;
    reading.passed(1);
    // What is exported now would outlive its deletion.
    let in_use = survey.person.as_ref().map(PersonInUse::claim).transpose().map_err(Failure::running)?;
    let mut written = vec![summary(&survey)];
    if let Some(folder) = &options.csv {
        write_tables(&survey, folder, options.force, |bytes| reading.show(bytes)).map_err(failure)?;
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
    drop((reading, in_use));
    tell_what_is_missing(&survey);
    print(written.join("\n  ")).map_err(Failure::running)
}

/// Says what the file of the session lacks.
fn tell_what_is_missing(survey: &Survey) {
    let path = survey.path.display();
    if survey.damaged_pieces > 0 {
        tell(format_args!(
            "{path}: the file is damaged: {} ({} bytes) left out; if there is another copy of it, export that one",
            counted(survey.damaged_pieces as usize, "piece of it is", "pieces of it are"),
            survey.damaged_bytes
        ));
    }
    if survey.is_damaged_elsewhere {
        tell(format_args!(
            "{path}: the file is damaged outside its samples, so what it says of the session (when it began, names of \
             channels, how the task went) may be wrong; if there is another copy of it, export that one"
        ));
    }
    if survey.lacks_person {
        tell(format_args!(
            "{path}: the session had a person, but who it was is damaged in the file: what was exported names nobody, so \
             `tendon delete` will not find it"
        ));
    }
    if !survey.is_whole {
        let no_end = why_no_end(survey.damaged_pieces);
        tell(format_args!("{path}: {no_end}: what came after {:.1} s is not in it", survey.duration_s));
    }
}

/// A file for this user alone. One that is there already is refused without `force`, and with it unless it is an export.
fn check_file(path: &Path, force: bool) -> Result<OutputFile, Failure> {
    let file = OutputFile::check(path).map_err(Failure::input)?.private();
    if !file.replaces() {
        return Ok(if force { file } else { file.only_new() });
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

fn failure(error: ExportError) -> Failure {
    match error {
        ExportError::Write { .. } | ExportError::Interrupted => Failure::running(error),
        _ => Failure::input(error),
    }
}

/// Progress of reading the recording, as often as that takes.
struct Reading {
    progress: Progress,
    bytes_of_a_pass: u64,
    bytes_before: u64,
    /// Set by the first signal to end; the second one ends the process at once.
    is_interrupted: Arc<AtomicBool>,
}

impl Reading {
    fn of(path: &Path, passes: usize) -> anyhow::Result<Reading> {
        let is_interrupted = Arc::new(AtomicBool::new(false));
        for signal in [SIGHUP, SIGINT, SIGTERM] {
            flag::register_conditional_default(signal, is_interrupted.clone())
                .and_then(|_| flag::register(signal, is_interrupted.clone()))
                .context("cannot handle signals")?;
        }
        let bytes_of_a_pass = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        let progress = Progress::of(megabytes(bytes_of_a_pass) * passes, "MB");
        Ok(Reading { progress, bytes_of_a_pass, bytes_before: 0, is_interrupted })
    }

    /// Shows that so many bytes of this pass were read, and ends the export after a signal.
    fn show(&mut self, bytes: u64) -> Result<(), ExportError> {
        self.progress.show(megabytes(self.bytes_before + bytes), String::new);
        if self.is_interrupted.load(Ordering::Relaxed) { Err(ExportError::Interrupted) } else { Ok(()) }
    }

    fn passed(&mut self, passes: u64) {
        self.bytes_before += passes * self.bytes_of_a_pass;
    }
}

fn megabytes(bytes: u64) -> usize {
    (bytes / 1_000_000) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_formats_in_one_place_are_refused_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let (same, link) = (folder.path().join("same"), folder.path().join("link/same"));
        std::os::unix::fs::symlink(".", folder.path().join("link")).unwrap();
        let refused = |csv: Option<&PathBuf>, bids: Option<&PathBuf>, xdf: Option<&PathBuf>| {
            let options = Options {
                session: folder.path().join("session.mcap"),
                csv: csv.cloned(),
                bids: bids.cloned(),
                xdf: xdf.cloned(),
                task: None,
                placement: None,
                reference: None,
                power_line_hz: None,
                force: true,
            };
            format!("{:?}", export(&options).unwrap_err())
        };
        for (csv, bids, xdf) in [
            (Some(&same), None, Some(&same)),
            (Some(&same), Some(&link), None),
            (None, Some(&link), Some(&same)),
            (Some(&same), Some(&same), Some(&same)),
        ] {
            let refused = refused(csv, bids, xdf);
            assert!(refused.contains("is named for two outputs"), "{refused}");
        }
        let below = refused(Some(&same.join("tables")), None, Some(&same));
        assert!(below.contains("lies below"), "{below}");
        assert!(!same.exists());
    }
}
