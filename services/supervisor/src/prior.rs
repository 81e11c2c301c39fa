//! `tendon prior`: what people have in common, from their recordings, for the recognisers of others.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use tendon_dataset::DatasetSettings;
use tendon_evaluation::gather_cohort;
use tendon_features::MethodSettings;
use tendon_output::check_distinct;
use tendon_recordings::SkippedKind;

use crate::Failure;
use crate::channels::channels_or_default;
use crate::configuration::{Base, WINDOW_KEYS};
use crate::output::{checked_private, print};
use crate::personal::{WINDOWS, dataset_settings, personal_windows};
use crate::progress::Works;
use crate::recording_options::RecordingOptions;

/// Command line of `tendon prior`.
#[derive(Debug, Args)]
pub struct Options {
    /// Recordings with cues, of several people.
    #[arg(required = true, value_name = "PATH")]
    recordings: Vec<PathBuf>,
    #[command(flatten)]
    recording: RecordingOptions,
    #[command(flatten)]
    base: Base,
    /// The file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Gathers a prior and writes it.
pub fn gather(options: &Options) -> Result<(), Failure> {
    let out = checked_private(Some(&options.out))?;
    let inputs = options.recordings.iter().map(PathBuf::as_path).chain(options.base.file());
    check_distinct(&out, [], inputs).map_err(Failure::input)?;
    let config = options.base.configuration_of("tendon prior", &WINDOW_KEYS).map_err(Failure::input)?;
    let config = personal_windows(config, options.base.sets(WINDOWS));
    let settings = dataset_settings(&config, &[], &options.recording);
    let channels = channels_or_default(&options.recording.channels, &settings, &options.recordings);
    let settings = DatasetSettings { channels: channels.map_err(Failure::input)?, ..settings };
    let mut works = Works::default();
    let mut progress = |done, total| works.show(done, total, "people", String::new);
    let mut skipped = Vec::new();
    let gathered = gather_cohort(
        &options.recordings,
        &settings,
        &MethodSettings::default(),
        &mut skipped,
        &mut progress,
    );
    works.clear();
    let cohort = gathered.map_err(Failure::input)?;
    if cohort.prior(|_| true).map_err(Failure::input)?.is_none() {
        return Err(Failure::input(anyhow!(
            "these are too few people or windows for a prior: give more recordings"
        )));
    }
    let bytes = cohort.to_bytes().map_err(Failure::running)?;
    if let Some(file) = &out {
        file.write_bytes(&bytes).map_err(Failure::running)?;
    }
    let mut text =
        format!("{} people, {} kB in {}", cohort.members().len(), bytes.len() / 1000, options.out.display());
    for person in skipped.iter().filter(|left_out| left_out.kind == SkippedKind::Person) {
        text += &format!("\n{person}");
    }
    print(text).map_err(Failure::running)
}
