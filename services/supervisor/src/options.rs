//! The command line of `tendon run`, and the configuration that comes of it.
//!
//! ```text
//! --config FILE, else ./tendon.toml, else defaults ─▶ --set KEY=VALUE ─▶ the other options ─▶ checked Config
//! ```

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use nix::unistd::User;
use tempfile::TempDir;
use tendon_classifier::{Adaptation, ClassifierError};
use tendon_config::{AcquisitionSettings, Config, Gestures, Pace, Realtime, Source};
use tendon_dataset::DatasetSettings;
use tendon_gesture::Strategy;
use tendon_people::Person;
use tendon_recordings::Channel;
use tendon_session_file::is_session_file;
use tendon_signal::{canonical_unit, known_units};
use tendon_transport::{Delivery, SessionName, own_user};
use tendon_zones::TaskKind;

use crate::Failure;
use crate::model_channels;
use crate::page;
use crate::personal::{check_person, set_person};
use crate::recorded::{configuration_of, file_of};

/// Read where no other is named.
const DEFAULT_FILE: &str = "tendon.toml";

/// Keys of the configuration that windows depend on.
pub const WINDOW_KEYS: [&str; 3] = ["acquisition.sample_rate_hz", "dsp.filter", "dsp.windows"];

/// The configuration as `tendon run` and `tendon doctor` read it.
#[derive(Debug, Args)]
pub struct Base {
    /// Configuration; without it, ./tendon.toml if there is one, else the defaults.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one key of the configuration, such as dsp.filter.notch_hz=50; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
}

impl Base {
    /// The configuration that a session without other options would have, checked. All paths absolute.
    ///
    /// # Errors
    ///
    /// What makes no sense, by name.
    pub fn configuration(&self) -> anyhow::Result<Config> {
        finish(self.read()?)
    }

    /// The same for a command that uses only some keys: `used`, or what begins with them.
    ///
    /// # Errors
    ///
    /// What makes no sense, by name; also a key that was set and that the command does not use.
    pub fn configuration_of(&self, command: &str, used: &[&str]) -> anyhow::Result<Config> {
        check_keys(&self.assignments, command, used)?;
        self.configuration()
    }

    /// The configuration that was named.
    pub fn file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// Whether a configuration was named or a key was set.
    pub fn is_given(&self) -> bool {
        self.config.is_some() || !self.assignments.is_empty()
    }

    /// The options again, as they are typed after a command.
    pub fn typed(&self) -> String {
        let config = self.config.iter().map(|config| format!(" --config {}", config.display()));
        config.chain(self.assignments.iter().map(|assignment| format!(" --set '{assignment}'"))).collect()
    }

    /// The same, a word each.
    pub fn words(&self) -> Vec<String> {
        let config = self.config.iter().map(|config| format!("--config={}", config.display()));
        config.chain(self.assignments.iter().map(|assignment| format!("--set={assignment}"))).collect()
    }

    /// Whether a key was set that begins with `beginning`.
    pub fn sets(&self, beginning: &str) -> bool {
        sets(&self.assignments, beginning)
    }

    /// The file, then what was set.
    fn read(&self) -> anyhow::Result<Config> {
        self.with_assignments(read_configuration(self.config.as_deref())?)
    }

    /// The value that `--set` gives this key last, as it was written, without quotation marks.
    fn assigned(&self, key: &str) -> Option<&str> {
        let assignments = self.assignments.iter().rev().filter_map(|assignment| assignment.split_once('='));
        let value = assignments.into_iter().find_map(|(own, value)| (own.trim() == key).then_some(value))?;
        Some(value.trim().trim_matches(['"', '\'']))
    }

    /// What was set, on top of `config`.
    fn with_assignments(&self, mut config: Config) -> anyhow::Result<Config> {
        for assignment in &self.assignments {
            config = config.with(assignment)?;
        }
        Ok(config)
    }
}

/// How recordings are read: the same options for every command that reads some.
#[derive(Clone, Debug, Default, Args)]
pub struct RecordingOptions {
    /// Channels of the recordings in this order, by number from 0 or by the name that the recordings give them [default: those
    /// that the model or person names; else all of what Tendon recorded, of your own recordings the first that look like EMG, of
    /// 3DC 0,3,5,8, of Ozdemir 2022 0,1,2,3].
    #[arg(long, value_name = "C,…", value_delimiter = ',', value_parser = named_channel)]
    pub channels: Vec<Channel>,
    /// Sampling rate of recordings that do not state it, Hz.
    #[arg(long, value_name = "HZ", alias = "replay-rate-hz")]
    pub recording_rate_hz: Option<f64>,
    /// Column of tables that says what was done, by name or by number from 0; each run of a label is a trial [default: labels.csv;
    /// to replay, a column of a name such as gesture or label].
    #[arg(long, value_name = "COLUMN", value_parser = named_channel)]
    pub label_column: Option<Channel>,
    /// Unit of recordings that do not state it: V, mV, uV, nV or adc_counts.
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    pub unit: Option<String>,
}

impl RecordingOptions {
    /// The first of these options that was given.
    pub fn given(&self) -> Option<&'static str> {
        let given = [
            ("--channels", !self.channels.is_empty()),
            ("--recording-rate-hz", self.recording_rate_hz.is_some()),
            ("--label-column", self.label_column.is_some()),
            ("--unit", self.unit.is_some()),
        ];
        given.into_iter().find_map(|(option, is_given)| is_given.then_some(option))
    }

    /// `settings` for recordings that are read as these options say; but for the channels.
    pub fn settings(&self, settings: DatasetSettings) -> DatasetSettings {
        let RecordingOptions { recording_rate_hz, label_column, .. } = self.clone();
        DatasetSettings { recording_rate_hz, label_column, ..settings }
    }

    /// The unit of recordings that state `own`, in its canonical spelling; empty if nobody knows.
    ///
    /// # Errors
    ///
    /// The option says another one.
    pub fn unit_of(&self, own: &str) -> anyhow::Result<String> {
        let own = canonical_unit(own);
        let Some(unit) = &self.unit else { return Ok(own.to_owned()) };
        ensure!(
            own.is_empty() || own == unit,
            "--unit {unit}: the recordings say that they are in {own}: leave --unit out"
        );
        Ok(unit.clone())
    }
}

/// Which running session is meant.
#[derive(Debug, Args)]
pub struct RunningSession {
    /// Name of the session.
    #[arg(long = "session", value_name = "SESSION", default_value = "tendon")]
    pub name: SessionName,
    /// Whose session, if several users run one of this name; for root.
    #[arg(long)]
    user: Option<String>,
}

impl RunningSession {
    /// The number of the user whose session it is, if one was given, by name or number.
    pub fn user(&self) -> Result<Option<u32>, Failure> {
        let number = |name: &String| {
            let user = User::from_name(name).ok().flatten();
            user.map(|user| user.uid.as_raw())
                .or(name.parse().ok())
                .with_context(|| format!("there is no user `{name}`"))
        };
        self.user.as_ref().map(number).transpose().map_err(Failure::input)
    }
}

/// What can be said on the command line of `tendon run`; the rest is in the configuration.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    pub base: Base,
    /// Name of the session; two at a time need two names.
    #[arg(long)]
    session: Option<SessionName>,
    /// Stop after this long, such as 20s or 10m; without it, on Ctrl-C or at the recording's end.
    #[arg(long, value_parser = duration)]
    pub duration: Option<Duration>,
    /// Write the report as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write all histograms in hdrhistogram's interval log format.
    #[arg(long, value_name = "FILE")]
    pub latency_log: Option<PathBuf>,
    /// Draw the histograms of newest sample to command and of window start to command there, as PNG and SVG.
    #[arg(long, value_name = "FOLDER")]
    pub figures: Option<PathBuf>,
    /// Record the session there, in a folder of its own: everything as it happens, for this user alone.
    #[arg(long, value_name = "FOLDER")]
    pub record: Option<PathBuf>,
    /// Replay a recording: a 3DC folder or file, a CSV, EDF, BDF or XDF file; or a recorded session, with its own configuration where
    /// --config and --set do not say otherwise.
    #[arg(long, value_name = "PATH")]
    replay: Option<PathBuf>,
    #[command(flatten)]
    recording: RecordingOptions,
    /// Replay only this repetition of a 3DC folder.
    #[arg(long, value_name = "N", requires = "replay")]
    repetition: Option<u32>,
    /// How fast to replay.
    #[arg(long, value_enum)]
    pace: Option<Pace>,
    /// Gestures of the simulated person, such as "rest 6s, grip 2s".
    #[arg(long, value_name = "STEPS", conflicts_with_all = ["replay", "random", "keyboard"])]
    script: Option<String>,
    /// The simulated person makes random gestures, set by --seed.
    #[arg(long, conflicts_with_all = ["replay", "keyboard"])]
    random: bool,
    /// The keys, and the buttons of the page, say which gesture the simulated person makes.
    #[arg(long, conflicts_with = "replay")]
    pub keyboard: bool,
    /// Steer the arm into zones and score how it went. With the simulated amplifier and none of --script, --random and
    /// --keyboard, a simulated user does it.
    #[arg(long, value_enum)]
    pub task: Option<TaskKind>,
    /// Seed of the simulated amplifier: the same seed gives the same samples.
    #[arg(long)]
    seed: Option<u64>,
    /// A person who was calibrated, by name, or a person file. Channels, rate, filter, windows and gestures are theirs
    /// where the configuration does not say otherwise.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["model", "rest_move_model", "strategy"])]
    person: Option<String>,
    /// How rest and movement are told apart.
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
    /// The ONNX model of the gestures.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// The ONNX model of rest and move, with --strategy two_stage.
    #[arg(long, value_name = "FILE")]
    rest_move_model: Option<PathBuf>,
    /// Give predictions, commands and markers as streams of the Lab Streaming Layer.
    #[arg(long)]
    lsl_out: bool,
    /// The page of the session.
    #[command(flatten)]
    pub page: page::RunOptions,
    /// Real-time scheduling.
    #[arg(long, value_enum)]
    realtime: Option<Realtime>,
}

impl Options {
    /// The session's configuration: the file, then the command line. All paths absolute. Beside it, a folder that has to stay
    /// as long as the session runs.
    ///
    /// # Errors
    ///
    /// What makes no sense, by name.
    pub fn configuration(&self) -> anyhow::Result<(Config, Option<TempDir>)> {
        let (mut config, folder) = self.read()?;
        if let Some(session) = &self.session {
            config.session = session.clone();
        }
        self.set_source(&mut config)?;
        self.check_effects_on_source(&config)?;
        if let Some(strategy) = self.strategy {
            config.decision.strategy = strategy;
        }
        if let Some(model) = &self.model {
            config.inference.model = Some(model.clone());
        }
        if let Some(model) = &self.rest_move_model {
            ensure!(
                config.decision.strategy == Strategy::TwoStage,
                "--rest-move-model is for the strategy two_stage, but decision.strategy is \"{}\": add --strategy \
                 two_stage, or leave --rest-move-model out",
                config.decision.strategy.name()
            );
            config.inference.rest_move_model = Some(model.clone());
        }
        let person = self.person.as_deref().map(|person| set_person(person, &self.base, &mut config));
        let person = person.transpose()?;
        if config.inference.adaptation != Adaptation::Off && config.decision.strategy != Strategy::Personal {
            return Err(ClassifierError::OnlyPersonsAdapt.into());
        }
        config.outlets.lsl |= self.lsl_out;
        ensure!(
            !self.page.page || config.delivery() == Delivery::Live,
            "--page shows sessions in the arm's own time: leave --pace full away"
        );
        if let Some(realtime) = self.realtime {
            config.scheduling.realtime = realtime;
        }
        if let Some(task) = self.task {
            config.task = task.settings(config.task);
            ensure!(
                config.delivery() == Delivery::Live,
                "--task is for the arm's own time: leave --pace full away"
            );
        }
        model_channels::choose(&mut config);
        let mut config = finish(config)?;
        if let Some((file, person)) = &person {
            check_person(file, person, &config)?;
        }
        model_channels::check_recording(&config)?;
        let inference = &mut config.inference;
        if let (Strategy::Personal, Some(file)) = (config.decision.strategy, &inference.person) {
            let person = person.map_or_else(|| Person::read(file), |(_, person)| Ok(person))?;
            inference.person_checksum.get_or_insert_with(|| person.checksum());
        }
        Ok((config, folder))
    }

    /// The configuration before the options: of a recorded session its own, if no other is named.
    fn read(&self) -> anyhow::Result<(Config, Option<TempDir>)> {
        let replay = self.replay.as_deref().map(file_of).transpose()?;
        let Some(recorded) = replay.as_deref().filter(|path| is_session_file(path)) else {
            return Ok((self.base.read()?, None));
        };
        ensure!(
            self.recording.given().is_none() && self.repetition.is_none(),
            "{} is for other recordings, {} is a recorded session: leave it out",
            self.recording.given().unwrap_or("--repetition"),
            recorded.display()
        );
        if self.base.config.is_some() {
            return Ok((self.base.read()?, None));
        }
        let (config, folder) = configuration_of(recorded)?;
        Ok((self.base.with_assignments(config)?, folder))
    }

    /// Where the samples come from.
    fn set_source(&self, config: &mut Config) -> anyhow::Result<()> {
        let acquisition = &mut config.acquisition;
        if let Some(path) = &self.replay {
            let other = self.base.assigned("acquisition.source").filter(|source| *source != "replay");
            ensure!(
                other.is_none(),
                "--replay takes the samples from a recording, and --set acquisition.source={} does not: leave one of the two out",
                other.unwrap_or_default()
            );
            acquisition.source = Source::Replay;
            acquisition.replay.path = Some(file_of(path)?);
        }
        if let Some(option) = self.recording.given() {
            ensure!(
                acquisition.source == Source::Replay,
                "{option} is for recordings: name one with --replay PATH, or leave {option} out"
            );
        }
        let RecordingOptions { channels, recording_rate_hz, label_column, unit } = &self.recording;
        if !channels.is_empty() {
            acquisition.replay.channels = Some(channels.clone());
            if acquisition.channels == AcquisitionSettings::default().channels
                && !self.base.sets("acquisition.channels")
            {
                acquisition.channels = channels.len();
            }
        }
        if recording_rate_hz.is_some() {
            acquisition.replay.sample_rate_hz = *recording_rate_hz;
        }
        if label_column.is_some() {
            acquisition.replay.label_column = label_column.clone();
        }
        if unit.is_some() {
            acquisition.unit = unit.clone();
        }
        if self.repetition.is_some() {
            acquisition.replay.repetition = self.repetition;
        }
        if let Some(pace) = self.pace {
            ensure!(
                acquisition.source == Source::Replay,
                "--pace is for recordings: name one with --replay PATH"
            );
            acquisition.replay.pace = pace;
        }
        if let Some(script) = &self.script {
            acquisition.simulate.gestures = Gestures::Script;
            acquisition.simulate.script = script.clone();
        }
        if self.random {
            acquisition.simulate.gestures = Gestures::Random;
        }
        if self.keyboard || self.has_simulated_user(acquisition.source) {
            acquisition.simulate.gestures = Gestures::Keyboard;
        }
        if let Some(seed) = self.seed {
            acquisition.simulate.seed = seed;
        }
        Ok(())
    }

    /// Refuses options that say what the simulated person does where nobody is simulated.
    fn check_effects_on_source(&self, config: &Config) -> anyhow::Result<()> {
        let given = [
            ("--seed", self.seed.is_some()),
            ("--script", self.script.is_some()),
            ("--random", self.random),
            ("--keyboard", self.keyboard),
        ];
        let source = config.acquisition.source;
        let Some((option, _)) = given.into_iter().find(|(_, is_given)| *is_given) else { return Ok(()) };
        ensure!(
            self.replay.is_none(),
            "{option} is for the simulated amplifier, but --replay takes the samples from a recording: leave one of the two out"
        );
        ensure!(
            source == Source::Simulate,
            "{option} is for the simulated amplifier, but acquisition.source is \"{}\": leave {option} out, or add --set \
             acquisition.source=simulate",
            source.name()
        );
        Ok(())
    }

    /// The files that the session reads: its outputs must not replace them.
    pub fn inputs(&self, config: &Config) -> Vec<PathBuf> {
        let named = config.clone().files_mut().map(|file| file.clone()).collect::<Vec<_>>();
        named.into_iter().chain(self.base.config.clone()).collect()
    }

    /// Whether the simulated user does the task: nobody else says which gestures are made.
    pub fn has_simulated_user(&self, source: Source) -> bool {
        let by_others = self.script.is_some() || self.random || self.keyboard;
        self.task.is_some() && source == Source::Simulate && !by_others
    }
}

/// The configuration in this file; without one, in `tendon.toml` here if it is there, else the default.
///
/// # Errors
///
/// What is wrong with the file, by its place.
fn read_configuration(file: Option<&Path>) -> anyhow::Result<Config> {
    let default = Path::new(DEFAULT_FILE);
    match file {
        Some(file) => Ok(Config::read(file)?),
        // Also when it is no file: what lies there is refused, not passed over.
        None if default.symlink_metadata().is_ok() => {
            // It names libraries that are loaded: somebody else's is read only when it is asked for.
            let owner = default.metadata().context("cannot look at ./tendon.toml")?.uid();
            ensure!(
                owner == own_user() || owner == 0,
                "./tendon.toml belongs to {}: if you trust it, name it with --config",
                tendon_paths::user_name(owner)
            );
            Ok(Config::read(default)?)
        }
        None => Ok(Config::default()),
    }
}

/// Whether one of the assignments sets a key that begins with `beginning`.
pub fn sets(assignments: &[String], beginning: &str) -> bool {
    assignments.iter().any(|assignment| assignment.trim_start().starts_with(beginning))
}

/// Refuses assignments of keys that `command` does not use: they would have no effect.
///
/// # Errors
///
/// The first such assignment.
pub fn check_keys(assignments: &[String], command: &str, used: &[&str]) -> anyhow::Result<()> {
    for assignment in assignments {
        let key = assignment.split('=').next().unwrap_or_default().trim();
        let is_used = |used: &&str| {
            key.strip_prefix(*used).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        ensure!(
            used.iter().any(is_used),
            "--set {assignment}: {command} does not use {key}, only {}: leave it out",
            used.join(", ")
        );
    }
    Ok(())
}

/// Makes all paths absolute, and checks the whole.
fn finish(mut config: Config) -> anyhow::Result<Config> {
    for path in config.files_mut() {
        *path = std::path::absolute(&path)
            .with_context(|| format!("cannot make {} an absolute path", path.display()))?;
    }
    config.check()?;
    Ok(config)
}

/// A unit of samples, in its canonical spelling.
///
/// # Errors
///
/// When it is none.
pub fn unit(text: &str) -> anyhow::Result<String> {
    let canonical = canonical_unit(text);
    let known: Vec<&str> = known_units().collect();
    ensure!(known.contains(&canonical), "take one of {}", known.join(", "));
    Ok(canonical.to_owned())
}

/// A channel by number, or by the name that the header of a table gives it.
///
/// # Errors
///
/// When there is nothing.
pub fn named_channel(text: &str) -> anyhow::Result<Channel> {
    let text = text.trim();
    ensure!(!text.is_empty(), "name each channel, or give its number, from 0");
    Ok(text.parse().map_or_else(|_| Channel::from(text), Channel::Index))
}

/// A number of seconds above 0.
///
/// # Errors
///
/// When it is none.
pub fn seconds(text: &str) -> anyhow::Result<f64> {
    let seconds = text.trim().parse().ok().filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| anyhow!("give a number of seconds above 0, such as 30"))
}

/// A time to wait or to run, such as `20s`.
///
/// # Errors
///
/// When it is none, or 0.
pub fn duration(text: &str) -> anyhow::Result<Duration> {
    let duration = humantime::parse_duration(text)?;
    ensure!(!duration.is_zero(), "must be longer than 0, such as 20s");
    Ok(duration)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_that_of_the_recordings_or_of_the_option() {
        let given = RecordingOptions { unit: Some("mV".to_owned()), ..RecordingOptions::default() };
        assert_eq!(RecordingOptions::default().unit_of("microvolts").unwrap(), "uV");
        assert_eq!((given.unit_of("").unwrap(), given.unit_of("mV").unwrap()), ("mV".into(), "mV".into()));
        assert!(given.unit_of("uV").unwrap_err().to_string().contains("leave --unit out"));
        assert_eq!((given.given(), RecordingOptions::default().given()), (Some("--unit"), None));
    }

    #[test]
    fn a_unit_is_kept_in_one_spelling_and_a_named_channel_may_have_a_number() {
        assert_eq!(unit("microvolts").unwrap(), "uV");
        assert_eq!(unit("ADC counts").unwrap(), "adc_counts");
        assert_eq!(unit("furlongs").unwrap_err().to_string(), "take one of V, mV, uV, nV, adc_counts");
        assert_eq!(named_channel(" 3 ").unwrap(), Channel::Index(3));
        assert_eq!(named_channel("flexor").unwrap(), Channel::from("flexor"));
        named_channel("").unwrap_err();
    }

    #[test]
    fn seconds_are_a_finite_number_above_0() {
        assert_eq!(seconds("30").unwrap(), 30.0);
        for text in ["0", "-1", "inf", "NaN", "soon"] {
            assert!(seconds(text).unwrap_err().to_string().contains("above 0"), "{text}");
        }
    }

    #[test]
    fn a_duration_is_longer_than_0() {
        assert_eq!(duration("20s").unwrap(), Duration::from_secs(20));
        assert_eq!(duration("1ns").unwrap(), Duration::from_nanos(1));
        for refused in ["0s", "0ms", "0"] {
            assert!(duration(refused).unwrap_err().to_string().contains("longer than 0"), "{refused}");
        }
        duration("soon").unwrap_err();
    }
}
