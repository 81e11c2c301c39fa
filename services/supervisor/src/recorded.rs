//! Recorded sessions: the configuration of a replay, what a recording begins with, and `tendon compare`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use tempfile::TempDir;
use tendon_classifier::ModelFiles;
use tendon_config::{Backend, Config, ReplaySettings, SimulateSettings, Source};
use tendon_gesture::Strategy;
use tendon_output::OutputFile;
use tendon_provenance::Provenance;
use tendon_session::RecordingPlan;
use tendon_session_file::{
    Differences, FILE_NAME, Head, MODEL, PERSON, REST_MOVE_MODEL, RecordingStart, compare as compare_files,
};

use crate::Failure;
use crate::output::{checked, counted, print, tell};
use crate::progress::Progress;

/// Sessions of a folder that a message names.
const SESSIONS_LISTED: usize = 10;
/// Largest model or person that is compared with an attached one.
const LARGEST_FILE: u64 = 200 << 20;

/// The file of a session that was named by it or by its folder; any other path as it is.
///
/// # Errors
///
/// When the folder holds the folders of sessions, which one of them is meant.
pub fn file_of(path: &Path) -> anyhow::Result<PathBuf> {
    let file = path.join(FILE_NAME);
    if file.is_file() {
        return Ok(file);
    }
    let folders = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut sessions: Vec<String> = folders
        .filter(|folder| folder.join(FILE_NAME).is_file())
        .map(|folder| folder.display().to_string())
        .collect();
    sessions.sort_unstable();
    let more = sessions.len().saturating_sub(SESSIONS_LISTED);
    sessions.truncate(SESSIONS_LISTED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    ensure!(
        sessions.is_empty(),
        "{}: name one of the recorded sessions in it: {}{more}",
        path.display(),
        sessions.join(", ")
    );
    Ok(path.to_owned())
}

/// The configuration for the replay of the session recorded in the file at `path`: that of the recording, with the arm
/// simulated. Models and person that are no longer where they were are taken out of the file, into the folder that comes
/// with it. `is_given` says of a model or the person, by its name in the recording, whether another one was asked for.
///
/// # Errors
///
/// When the file cannot be read or is none of a session, or what is needed of its models and person is damaged: the file
/// that lies where it was may be another one by now.
pub fn configuration_of(
    path: &Path,
    is_given: impl Fn(&str) -> bool,
) -> anyhow::Result<(Config, Option<TempDir>)> {
    let mut head = Head::read(path)?;
    let mut config = Config::parse(&head.configuration, path)
        .with_context(|| format!("{}: the recorded configuration", path.display()))?;
    config.session = Config::default().session;
    let acquisition = &mut config.acquisition;
    acquisition.source = Source::Replay;
    acquisition.program = None;
    acquisition.channel_selection = None;
    acquisition.unit = None;
    acquisition.simulate = SimulateSettings::default();
    acquisition.replay = ReplaySettings { path: Some(path.to_owned()), ..ReplaySettings::default() };
    // A replay must not move a real arm because the recorded session did.
    config.robot.backend = Backend::Simulate;
    let inference = &mut config.inference;
    inference.runtime_library = inference.runtime_library.take().filter(|library| library.exists());
    let needed: &[&str] = match config.decision.strategy {
        Strategy::Personal => &[PERSON],
        Strategy::Direct | Strategy::Threshold => &[MODEL],
        Strategy::TwoStage => &[MODEL, REST_MOVE_MODEL],
    };
    let now = files(&config).unwrap_or_default();
    let mut folder: Option<TempDir> = None;
    for (name, place) in [
        (MODEL, &mut config.inference.model),
        (REST_MOVE_MODEL, &mut config.inference.rest_move_model),
        (PERSON, &mut config.inference.person),
    ] {
        let Some(bytes) = head.files.remove(name) else {
            ensure!(
                head.is_whole || !needed.contains(&name) || is_given(name),
                "{}: the recording's copy of the {} is damaged: replay another copy of the recording, or name a {} with --{}",
                path.display(),
                name.replace('_', "-"),
                if name == PERSON { "person" } else { "model" },
                name.replace('_', "-")
            );
            continue;
        };
        let is_same = |path: &PathBuf| tendon_input::read(path, LARGEST_FILE).is_ok_and(|now| now == bytes);
        if now.get(name).is_some_and(is_same) {
            continue;
        }
        if folder.is_none() {
            folder = Some(tempfile::tempdir().context("cannot make a folder for the recorded models")?);
        }
        let Some(folder) = &folder else { continue };
        // The ending says what kind of file it is.
        let ending = if name == PERSON { "person" } else { "onnx" };
        let file = folder.path().join(format!("{name}.{ending}"));
        std::fs::write(&file, bytes).with_context(|| format!("cannot write {}", file.display()))?;
        *place = Some(file);
    }
    Ok((config, folder))
}

/// The models or the person of a session, by the names under which a recording keeps them.
///
/// # Errors
///
/// When a model is missing.
fn files(config: &Config) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let inference = &config.inference;
    if config.decision.strategy == Strategy::Personal {
        let person = inference.person.clone();
        return Ok(person.into_iter().map(|person| (PERSON.to_owned(), person)).collect());
    }
    let strategy = config.decision.strategy;
    let models =
        ModelFiles::find(strategy, inference.model.as_deref(), inference.rest_move_model.as_deref())?;
    let rest_move = models.rest_move.map(|rest_move| (REST_MOVE_MODEL.to_owned(), rest_move));
    Ok(rest_move.into_iter().chain([(MODEL.to_owned(), models.gestures)]).collect())
}

/// How a session is recorded: to `folder` from its beginning, or by key only.
///
/// # Errors
///
/// When a model is missing.
pub fn plan(
    config: &Config,
    folder: Option<&Path>,
    provenance: &Provenance,
) -> anyhow::Result<RecordingPlan> {
    let folder = folder.map(std::path::absolute).transpose().context("--record")?;
    let start = RecordingStart { provenance: provenance.clone(), files: files(config)? };
    Ok(RecordingPlan { folder, start })
}

/// Command line of `tendon compare`.
#[derive(Debug, Args)]
pub struct CompareOptions {
    /// A recorded session: its session.mcap, or the folder that holds it.
    first: PathBuf,
    /// Another one of the same samples, such as a replay of the first that was recorded.
    second: PathBuf,
    /// Write what differs as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Compares two recorded sessions. What differs is a failure, unless only one of them has the beginning of its session.
pub fn compare(options: &CompareOptions) -> Result<(), Failure> {
    let json = checked(options.json.as_deref())?;
    let [first, second] = [file_of(&options.first), file_of(&options.second)];
    let (first, second) = (first.map_err(Failure::input)?, second.map_err(Failure::input)?);
    let size = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let total = size(&first) + size(&second);
    let megabytes = |bytes: u64| (bytes / 1_000_000) as usize;
    let mut progress = Progress::of(megabytes(total), "MB");
    let compared = compare_files(&first, &second, |bytes| {
        progress.show(megabytes(bytes), String::new);
    });
    drop(progress);
    let found = compared.map_err(Failure::input)?;
    for (place, path) in [&first, &second].into_iter().enumerate() {
        tell_what_is_missing(path, found.damaged_pieces[place], found.is_whole[place]);
    }
    if found.is_empty() {
        let (first, second) = (first.display(), second.display());
        return Err(Failure::input(anyhow!(
            "nothing was compared: neither {first} nor {second} holds a prediction or a command"
        )));
    }
    let written = json.as_ref().map(|json| OutputFile::write_json(json, &found));
    print(table("predictions", &found.predictions)).map_err(Failure::running)?;
    print(table("commands", &found.commands)).map_err(Failure::running)?;
    written.transpose().map_err(Failure::running)?;
    let [first, second] = found.lacks_beginning;
    match found.differences() {
        0 => Ok(()),
        _ if !found.is_fair() => {
            let late = if first && !second { &options.first } else { &options.second };
            tell(format_args!(
                "{} was begun in a running session: what filters and detector had taken in before is not in it, so its replay \
                 begins anew, and these differences are no fault. Two replays of it can be compared",
                late.display()
            ));
            Ok(())
        }
        differences => Err(Failure::running(anyhow!(
            "the two recordings differ: {}",
            counted(differences as usize, "difference", "differences")
        ))),
    }
}

/// Says what could not be compared of a recording.
fn tell_what_is_missing(path: &Path, damaged_pieces: u64, is_whole: bool) {
    let path = path.display();
    if damaged_pieces > 0 {
        let pieces = counted(damaged_pieces as usize, "piece of it is", "pieces of it are");
        tell(format_args!("{path}: the file is damaged: {pieces} not compared"));
    }
    if !is_whole {
        tell(format_args!("{path}: {}: what came later is not compared", why_no_end(damaged_pieces)));
    }
}

/// Why a recording whose end was not found has none, where so many of its pieces are damaged.
pub fn why_no_end(damaged_pieces: u64) -> &'static str {
    match damaged_pieces {
        0 => "the recording has no end, as when the recorder was killed or is still writing it",
        _ => "the recording cannot be read to its end",
    }
}

fn table(topic: &str, found: &Differences) -> String {
    let counts = format!(
        "{topic:<12} {} the same, {} different, {} only in the first, {} only in the second",
        found.same, found.different, found.only_in_first, found.only_in_second
    );
    let first = found.first.iter().map(|difference| {
        let epoch = match difference.epoch {
            0 => String::new(),
            epoch => format!(" of source {}", epoch + 1),
        };
        format!(
            "\n  {:9.3} s, window at sample {}{epoch}: {}",
            difference.at_s, difference.first_sample, difference.what
        )
    });
    counts + &first.collect::<String>()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tendon_session_file::{CONFIGURATION, Writer};

    use super::*;

    #[test]
    fn recordings_of_nothing_are_not_called_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        let mut writer = Writer::begin(fs::File::create(&path).unwrap(), "test", 0).unwrap();
        writer.attach(CONFIGURATION, "application/toml", b"").unwrap();
        writer.finish().unwrap();
        drop(writer);
        let options = CompareOptions { first: path.clone(), second: path, json: None };
        let refused = compare(&options).unwrap_err().reason();
        assert!(refused.contains("nothing was compared"), "{refused}");
    }

    #[test]
    fn a_damaged_model_or_person_of_a_recording_is_refused_unless_another_one_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let (path, now) = (folder.path().join(FILE_NAME), folder.path().join("now"));
        fs::write(&now, "what lies there by now").unwrap();
        for (strategy, name) in
            [("direct", MODEL), ("two_stage", MODEL), ("two_stage", REST_MOVE_MODEL), ("personal", PERSON)]
        {
            let mut writer = Writer::begin(fs::File::create(&path).unwrap(), "test", 0).unwrap();
            let configuration = format!(
                "[inference]\nmodel = {now:?}\nrest_move_model = {now:?}\nperson = {now:?}\n\
                 [decision]\nstrategy = \"{strategy}\"\n"
            );
            writer.attach(CONFIGURATION, "application/toml", configuration.as_bytes()).unwrap();
            for file in if strategy == "personal" { vec![PERSON] } else { vec![MODEL, REST_MOVE_MODEL] } {
                writer
                    .attach(file, "application/octet-stream", format!("as run: {file};").as_bytes())
                    .unwrap();
            }
            writer.finish().unwrap();
            drop(writer);
            let (config, taken) = configuration_of(&path, |_| false).unwrap();
            let taken = taken.unwrap();
            let inference = config.inference;
            let file = match name {
                MODEL => inference.model,
                REST_MOVE_MODEL => inference.rest_move_model,
                _ => inference.person,
            };
            let file = file.unwrap();
            assert!(file.starts_with(taken.path()), "{}", file.display());

            let mut bytes = fs::read(&path).unwrap();
            let text = format!("as run: {name};");
            let place = bytes.windows(text.len()).position(|part| part == text.as_bytes()).unwrap();
            bytes[place] ^= 1;
            fs::write(&path, bytes).unwrap();
            let refused = configuration_of(&path, |other| other != name).unwrap_err().to_string();
            let option = format!("with --{}", name.replace('_', "-"));
            assert!(refused.contains(FILE_NAME) && refused.ends_with(&option), "{refused}");
            configuration_of(&path, |given| given == name).unwrap();
        }
    }
}
