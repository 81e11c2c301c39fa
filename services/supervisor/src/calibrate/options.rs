//! Command line of `tendon calibrate`.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_people::PersonName;

use crate::configuration::Base;
use crate::page::RunOptions;
use crate::recording_options::RecordingOptions;
use crate::times::duration;

/// Command line of `tendon calibrate`.
#[derive(Debug, Args)]
pub struct Options {
    /// Name of the person, by which `tendon run --person` finds them: 1 to 40 of the characters a-z 0-9 - _. A pseudonym is
    /// enough.
    pub name: PersonName,
    #[command(flatten)]
    pub guided: GuidedOptions,
    /// Instead of recording now, take recordings with cues, in any layout that `tendon evaluate` reads.
    #[arg(long, num_args = 1.., value_name = "PATH", conflicts_with = "page")]
    pub from: Vec<PathBuf>,
    /// Number or name of the person in the recordings, where they are of several people.
    #[arg(long, value_name = "P", requires = "from")]
    pub person_number: Option<PersonId>,
    /// Only this session of the recordings, such as `train` of 3DC [default: all].
    #[arg(long, value_name = "SESSION", requires = "from")]
    pub session: Option<String>,
    /// How often each gesture is asked for [default: 1]; with --from, only the first N repetitions [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub repetitions: Option<u32>,
    /// The gestures, of any names, besides rest [default: those of the configuration; with --from, all that were
    /// recorded].
    #[arg(long, value_name = "GESTURE,…", value_delimiter = ',')]
    pub gestures: Vec<Gesture>,
    #[command(flatten)]
    pub recording: RecordingOptions,
    #[command(flatten)]
    pub base: Base,
    /// The page of the calibration.
    #[command(flatten)]
    pub page: RunOptions,
    /// Put the person in the place of the one who has this name.
    #[arg(long)]
    pub replace: bool,
    /// Also write what was learnt to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What can be said of a guided calibration.
#[derive(Debug, Args)]
pub struct GuidedOptions {
    /// Then ask for each gesture once more, and say how well it is recognised with the calibration, and by what was there
    /// without it.
    #[arg(long, conflicts_with = "from")]
    pub check: bool,
    /// Ask for this gesture alone, in place of what the recording of the calibration has of it. `rest` is 5 s of
    /// it, in place of all rest.
    #[arg(long, value_name = "GESTURE", conflicts_with_all = ["from", "gestures"])]
    pub redo: Option<Gesture>,
    /// Correct the person for a new day or electrodes that sit a little differently: a few seconds of rest and of each
    /// gesture (18 s for five gestures) move the person by the step that they show.
    #[arg(long, conflicts_with_all = ["from", "gestures", "repetitions", "redo", "replace"])]
    pub update: bool,
    /// How long to rest at the beginning [default: 5s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pub rest: Option<Duration>,
    /// How long each gesture is held [default: 5s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pub hold: Option<Duration>,
    /// How long to rest before each gesture [default: 4s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pub pause: Option<Duration>,
}

impl GuidedOptions {
    /// The times again, a word each.
    pub fn times(&self) -> Vec<String> {
        let times = [("--rest", self.rest), ("--hold", self.hold), ("--pause", self.pause)];
        let given = times.into_iter().filter_map(|(option, time)| Some((option, time?)));
        given.map(|(option, time)| format!("{option}={}", humantime::format_duration(time))).collect()
    }
}
