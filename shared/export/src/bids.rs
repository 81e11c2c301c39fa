//! A session in a BIDS data set: BIDS-EMG 1.11 (bids-specification 1.11.1), the signal as BDF+.
//!
//! ```text
//! FOLDER/dataset_description.json   README   participants.tsv, .json     made once, then added to
//!        sub-anna/ses-20260504T091233/emg/
//!          sub-anna_ses-20260504T091233_task-zones_emg.bdf, _emg.json, _channels.tsv, _events.tsv, _events.json
//! ```
//!
//! A person is a pseudonym of which only letters and digits are left. A session is named by when it began, so that further
//! sessions can be added. What nobody told is "n/a" where BIDS allows it.

mod events;
mod participants;
mod sidecars;
mod signal;

use std::path::{Path, PathBuf};

use crate::staging::Staging;
use crate::{ExportError, Survey};

use participants::Participants;
pub use participants::participant_of;

/// What a recording does not say.
#[derive(Clone, Debug, Default)]
pub struct BidsFacts {
    /// What was done, a word; `control` if nobody says, `zones` where there was such a task.
    pub task: Option<String>,
    /// Where the electrodes were, and how the places were found.
    pub placement: Option<String>,
    /// The reference electrode, or `Bipolar`.
    pub reference: Option<String>,
    /// Frequency of the mains, Hz.
    pub power_line_hz: Option<f64>,
}

/// Adds the session of `survey` to the data set in `folder`, which is made if it is not there. Gives the recording's path.
/// `has_read` is told how many bytes of the recording were read so far, in two passes, and may end the export.
///
/// # Errors
///
/// [`ExportError`]. Nothing is left of an export that failed. Without `replace`, a session that is there already is refused.
pub fn write_bids(
    survey: &Survey,
    facts: &BidsFacts,
    folder: &Path,
    replace: bool,
    mut has_read: impl FnMut(u64) -> Result<(), ExportError>,
) -> Result<PathBuf, ExportError> {
    let mut staging = Staging::begin(folder)?;
    let mut participants = Participants::read(folder)?;
    let subject = participants.subject(survey.person.as_ref().map(|person| person.as_str()));
    let name = Name::of(survey, facts, &subject);
    let recording = name.file("emg.bdf");
    check_replaceable(folder, &name, replace)?;
    // First, so that the files of an export that is killed say whose they are.
    staging.write(participants::FILE, participants.table().as_bytes())?;
    let events = events::gather(survey, signal::record_length(survey).samples, &mut has_read)?;
    let signals = sidecars::signals(survey)?;
    let output = staging.create(&recording)?;
    signal::write(survey, &signals, &events, output, |bytes| has_read(survey.bytes + bytes))?;
    staging.write(name.file("emg.json"), &sidecars::recording(survey, facts, &name.task))?;
    staging.write(name.file("channels.tsv"), sidecars::channels(survey, &signals).as_bytes())?;
    staging.write(name.file("events.tsv"), events::table(&events).as_bytes())?;
    staging.write(name.file("events.json"), &events::columns())?;
    for (file, text) in sidecars::of_the_data_set(folder) {
        if !folder.join(file).exists() {
            staging.write(file, text.as_bytes())?;
        }
    }
    staging.keep()?;
    Ok(folder.join(recording))
}

/// Files of a session, by how their names end; the recording first.
const FILES: [&str; 5] = ["emg.bdf", "emg.json", "channels.tsv", "events.tsv", "events.json"];

/// Refuses to write where there is something already, or, with `replace`, something that no export wrote.
fn check_replaceable(folder: &Path, name: &Name, replace: bool) -> Result<(), ExportError> {
    let mut files = FILES.iter().map(|ending| folder.join(name.file(ending)));
    let Some(path) = files.find(|file| std::fs::symlink_metadata(file).is_ok()) else { return Ok(()) };
    if !replace {
        return Err(ExportError::Exists { path });
    }
    // An export writes all of them together.
    let recording = folder.join(name.file(FILES[0]));
    let is_own = recording.is_file() && signal::is_exported(&recording);
    if is_own { Ok(()) } else { Err(ExportError::NoExport { path }) }
}

/// What the files of a session are called.
struct Name {
    folder: PathBuf,
    beginning: String,
    task: String,
}

impl Name {
    fn of(survey: &Survey, facts: &BidsFacts, subject: &str) -> Name {
        let task = match (&facts.task, &survey.task) {
            (Some(task), _) => task.clone(),
            (None, Some(_)) => "zones".to_owned(),
            (None, None) => "control".to_owned(),
        };
        let begun_at = humantime::format_rfc3339_seconds(survey.begun_at).to_string();
        let session = begun_at.trim_end_matches('Z').replace(['-', ':'], "");
        Name {
            folder: PathBuf::from(format!("sub-{subject}/ses-{session}/emg")),
            beginning: format!("sub-{subject}_ses-{session}_task-{}", label(&task)),
            task,
        }
    }

    /// Relative to the data set.
    fn file(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}_{ending}", self.beginning))
    }
}

/// Only letters and digits, as a part of a file's name has them.
fn label(text: &str) -> String {
    text.chars().filter(char::is_ascii_alphanumeric).collect()
}

/// Text in a cell of a table.
fn cell(text: &str) -> String {
    let text: String =
        text.chars().map(|character| if character.is_control() { ' ' } else { character }).collect();
    let text = text.trim();
    if text.is_empty() { "n/a".to_owned() } else { text.to_owned() }
}
