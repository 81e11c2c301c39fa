//! `tendon delete`: removes all that is kept of a person, once its name was typed again.
//!
//! ```text
//! people/NAME            person, previous person, recordings of the calibration ┐
//! sessions/*/session.mcap   those that name the person                          ├─▶ list ─▶ asked ─▶ deleted
//! --in FOLDER            sessions, recordings, person files, exports, BIDS      ┘
//!                        data sets and models that learnt from the person ──────▶ said, and left
//! ```

mod find;

use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use tendon_paths::data_folder;
use tendon_people::{People, PersonName, user_of_person};

use crate::Failure;
use crate::output::{counted, print, tell};

use find::{Found, Kept};

/// Files and folders that could not be looked at which are named.
const UNKNOWN_SHOWN: usize = 20;

/// Command line of `tendon delete`.
#[derive(Debug, Args)]
pub struct Options {
    /// The person's name.
    person: PersonName,
    /// Also look for the person's sessions, recordings and exports here, and in all folders below; may be repeated.
    #[arg(long = "in", value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Do not ask.
    #[arg(long)]
    yes: bool,
}

/// Deletes what is kept of a person.
pub fn delete(options: &Options) -> Result<(), Failure> {
    let name = &options.person;
    let people = People::open().map_err(Failure::input)?;
    // Nobody calibrates the person meanwhile.
    let reserved = people.reserve(name).map_err(Failure::input)?;
    refuse_running_session(name).map_err(Failure::input)?;
    let found = look_for(&people, name, &options.folders).map_err(Failure::input)?;
    if found.kept.is_empty() {
        people.forget(name).map_err(Failure::running)?;
        let text = format!("nothing is kept of {name} in {}", places(&options.folders));
        return print(text + &left(&found)).map_err(Failure::running);
    }
    print(list(name, &found)).map_err(Failure::running)?;
    if !options.yes {
        ask(name).map_err(Failure::input)?;
    }
    // It may have begun while the question stood.
    refuse_running_session(name).map_err(Failure::input)?;
    let failures: Vec<String> = found
        .kept
        .iter()
        .filter_map(|kept| kept.delete().err().map(|error| format!("{}: {error}", kept.path.display())))
        .collect();
    people.forget(name).map_err(Failure::running)?;
    drop(reserved);
    if !failures.is_empty() {
        return Err(Failure::running(anyhow!(
            "not everything could be deleted:\n  {}",
            failures.join("\n  ")
        )));
    }
    print(format!("deleted {}", counted(found.kept.len(), "place", "places"))).map_err(Failure::running)
}

/// A session or an export that runs would go on writing.
fn refuse_running_session(name: &PersonName) -> anyhow::Result<()> {
    match user_of_person(name) {
        None => Ok(()),
        Some(process) => {
            Err(anyhow!("a session or an export of {name} runs (process {process}): end it first"))
        }
    }
}

fn look_for(people: &People, name: &PersonName, folders: &[PathBuf]) -> anyhow::Result<Found> {
    let mut found = Found::default();
    found.take_person(&people.folder_of(name))?;
    let sessions = data_folder()?.path().join("sessions");
    if sessions.is_dir() {
        found.search(&sessions, name);
    }
    for folder in folders {
        ensure!(folder.is_dir(), "{}: there is no such folder", folder.display());
        // Without links and dots, so that nothing is found twice.
        let folder = folder.canonicalize().with_context(|| format!("cannot open {}", folder.display()))?;
        found.search(&folder, name);
    }
    Ok(found)
}

fn list(name: &PersonName, found: &Found) -> String {
    let line = |kept: &Kept| {
        format!("\n  {:>9.1} MB  {}: {}", kept.bytes as f64 / 1e6, kept.path.display(), kept.what)
    };
    let bytes: u64 = found.kept.iter().map(|kept| kept.bytes).sum();
    let total =
        format!("{name}: {:.1} MB in {}", bytes as f64 / 1e6, counted(found.kept.len(), "place", "places"));
    total + &found.kept.iter().map(line).collect::<String>() + &left(found)
}

/// What is not deleted.
fn left(found: &Found) -> String {
    let line = |(path, what): &(PathBuf, String)| format!("\n  {}: {what}", path.display());
    let unknown = match found.unknown.as_slice() {
        [] => String::new(),
        unknown => {
            let shown: String = unknown.iter().take(UNKNOWN_SHOWN).map(line).collect();
            let more = match unknown.len().saturating_sub(UNKNOWN_SHOWN) {
                0 => String::new(),
                more => format!("\n  and {more} more"),
            };
            format!("\nmay be of this person, too: look yourself:{shown}{more}")
        }
    };
    let known = if found.left.is_empty() {
        String::new()
    } else {
        "\nstays, as it is of other people, too:".to_owned()
            + &found.left.iter().map(line).collect::<String>()
    };
    known + &unknown + "\nCopies, and what lies in folders that --in does not name, are not known."
}

fn places(folders: &[PathBuf]) -> String {
    let own = "your own data".to_owned();
    let all: Vec<String> = [own]
        .into_iter()
        .chain(folders.iter().map(|folder: &PathBuf| folder.display().to_string()))
        .collect();
    all.join(", ")
}

/// Has the name typed again.
fn ask(name: &PersonName) -> anyhow::Result<()> {
    let input = std::io::stdin();
    if input.is_terminal() {
        tell(format_args!("type {name} to delete all of this; nothing brings it back"));
    }
    let mut line = String::new();
    input.lock().read_line(&mut line).context("cannot read the answer")?;
    ensure!(
        line.trim() == name.as_str(),
        "nothing was deleted: the name was not typed. Where nobody can be asked, add --yes"
    );
    Ok(())
}

/// How many bytes the files at or below `path` have; links are not followed.
fn bytes_below(path: &Path) -> u64 {
    let Ok(metadata) = path.symlink_metadata() else { return 0 };
    if !metadata.is_dir() {
        return metadata.len();
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    entries.map(|entry| bytes_below(&entry.path())).sum()
}
