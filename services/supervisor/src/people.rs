//! `tendon people`: whom this user has calibrated.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use tendon_output::collect;
use tendon_people::{People, Person, PersonName};

use crate::Failure;
use crate::output::{checked_private, print};

/// Command line of `tendon people`.
#[derive(Debug, Args)]
pub struct Options {
    /// Also write the list to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// A person in the list, or why their file cannot be used.
#[derive(Debug, Serialize)]
struct Entry {
    name: PersonName,
    file: String,
    #[serde(flatten)]
    known: Option<Known>,
    /// What is wrong with the file; `null` if nothing is.
    problem: Option<String>,
}

#[derive(Debug, Serialize)]
struct Known {
    made_at: String,
    gestures: Vec<String>,
    repetitions: usize,
    channels: Vec<String>,
    sample_rate_hz: f64,
    window_ms: f64,
    expected_accuracy: f64,
    findings: Vec<String>,
}

/// Lists the people.
pub fn list(options: &Options) -> Result<(), Failure> {
    let json = checked_private(options.json.as_deref())?;
    let people = People::open().map_err(Failure::input)?;
    let names = people.names().map_err(Failure::running)?;
    let entries: Vec<Entry> = names.into_iter().map(|name| entry(&people, name)).collect();
    let written = collect(json.iter().map(|json| json.write_json(&entries))).map_err(Failure::running);
    written.and(print(text(&entries)).map_err(Failure::running))
}

fn entry(people: &People, name: PersonName) -> Entry {
    let file = people.file_of(&name).display().to_string();
    match people.find(&name) {
        Ok(person) => Entry { name, file, known: Some(known(&person)), problem: None },
        Err(error) => Entry { name, file, known: None, problem: Some(error.to_string()) },
    }
}

fn known(person: &Person) -> Known {
    let signal = &person.signal;
    Known {
        made_at: person.made.at.clone(),
        gestures: person.gesture_set().iter().map(String::from).collect(),
        repetitions: person.repetitions(),
        channels: signal.channels.clone(),
        sample_rate_hz: signal.sample_rate_hz,
        window_ms: 1e3 * signal.window_samples as f64 / signal.sample_rate_hz,
        expected_accuracy: person.expected.accuracy,
        findings: person.findings.iter().map(ToString::to_string).collect(),
    }
}

fn text(entries: &[Entry]) -> String {
    if entries.is_empty() {
        return "nobody yet: `tendon calibrate NAME` makes a person".to_owned();
    }
    let mut text = format!(
        "{:<20} {:<12} {:>12} {:>12} {:>10}  {}\n",
        "name", "calibrated", "repetitions", "expected, %", "window, ms", "gestures; channels"
    );
    for entry in entries {
        let _ = match (&entry.known, &entry.problem) {
            (Some(known), _) => writeln!(
                text,
                "{:<20} {:<12} {:>12} {:>12.1} {:>10.0}  {}; {}",
                entry.name,
                known.made_at.get(..10).unwrap_or_default(),
                known.repetitions,
                100.0 * known.expected_accuracy,
                known.window_ms,
                known.gestures.join(", "),
                known.channels.join(", ")
            ),
            (None, problem) => {
                writeln!(text, "{:<20} {}", entry.name, problem.as_deref().unwrap_or_default())
            }
        };
    }
    text.trim_end().to_owned()
}
