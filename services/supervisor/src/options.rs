//! The command line of `tendon run`, and the configuration that comes of it.
//!
//! ```text
//! Base: --config, --set ─▶ the other options ─▶ checked Config
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::ensure;
use clap::Args;
use tempfile::TempDir;
use tendon_classifier::{Adaptation, ClassifierError};
use tendon_config::{AcquisitionSettings, Config, Gestures, Pace, Realtime, Source};
use tendon_gesture::Strategy;
use tendon_people::Person;
use tendon_session_file::{MODEL, REST_MOVE_MODEL, is_session_file};
use tendon_transport::{Delivery, SessionName};
use tendon_zones::TaskKind;

use crate::configuration::{Base, finish};
use crate::model_channels;
use crate::page;
use crate::personal::{check_person, set_person};
use crate::recorded::{configuration_of, file_of};
use crate::recording_options::RecordingOptions;
use crate::times::duration;

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
        if self.base.file().is_some() {
            return Ok((self.base.read()?, None));
        }
        let (config, folder) = configuration_of(recorded, |file| self.names(file))?;
        Ok((self.base.with_assignments(config)?, folder))
    }

    /// Whether the command line names another model or person in place of this one of a recording. With a person there is
    /// no model.
    fn names(&self, file: &str) -> bool {
        let model = match file {
            MODEL => &self.model,
            REST_MOVE_MODEL => &self.rest_move_model,
            _ => &None,
        };
        model.is_some() || self.person.is_some() || self.base.assigned(&format!("inference.{file}")).is_some()
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
        named.into_iter().chain(self.base.file().map(Path::to_owned)).collect()
    }

    /// Whether the simulated user does the task: nobody else says which gestures are made.
    pub fn has_simulated_user(&self, source: Source) -> bool {
        let by_others = self.script.is_some() || self.random || self.keyboard;
        self.task.is_some() && source == Source::Simulate && !by_others
    }
}
