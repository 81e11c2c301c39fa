//! Where samples come from.

use std::path::Path;

use anyhow::Context;
use tendon_config::{AcquisitionSettings, Gestures, Source as SourceKind};
use tendon_emg_simulation::{Performance, Profile, Repeat, Script, SimulatedEmg};
use tendon_messages::Truth;
use tendon_recordings::ReplayStream;

/// Gestures in a random sequence before it begins again.
const RANDOM_GESTURES: usize = 1000;

/// An open source of samples.
#[allow(clippy::large_enum_variant, reason = "there is one of it in the process")]
pub enum Source {
    /// The simulated DAQ.
    Simulate {
        /// Makes the samples.
        emg: SimulatedEmg,
        /// Says which gesture is made.
        performance: Performance,
        /// What to tell the user.
        description: String,
    },
    /// A recording.
    Replay {
        /// Gives the samples.
        stream: ReplayStream,
        /// What to tell the user.
        description: String,
    },
}

impl Source {
    /// Opens the source that `settings` name. A recording is read through once, so that a bad one is refused
    /// before anything moves.
    pub fn open(settings: &AcquisitionSettings) -> anyhow::Result<Source> {
        match settings.source {
            SourceKind::Simulate => Source::simulate(settings),
            SourceKind::Replay => Source::replay(settings),
        }
    }

    fn simulate(settings: &AcquisitionSettings) -> anyhow::Result<Source> {
        let simulate = &settings.simulate;
        let profile = match &simulate.profile {
            None => Profile::default(),
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("{}: cannot read the profile", path.display()))?;
                Profile::from_toml(&text).with_context(|| path.display().to_string())?
            }
        };
        let emg =
            SimulatedEmg::new(&profile, &simulate.simulation(settings.channels, settings.sample_rate_hz))?;
        let contraction = simulate.contraction();
        let of_script =
            |script| Performance::of_script(script, Repeat::Forever, contraction, settings.sample_rate_hz);
        let (performance, gestures) = match simulate.gestures {
            Gestures::Script => {
                let script: Script = simulate.script.parse().context("acquisition.simulate.script")?;
                let description = format!("script of {:.0} s", script.duration().as_secs_f64());
                (of_script(script), description)
            }
            Gestures::Random => {
                let script = Script::random(simulate.seed, RANDOM_GESTURES);
                (of_script(script), "random gestures".to_owned())
            }
            Gestures::Keyboard => {
                (Performance::at_rest(contraction, settings.sample_rate_hz), "gestures as told".to_owned())
            }
        };
        let description =
            format!("simulated DAQ, {gestures}, seed {}, profile: {}", simulate.seed, profile.source);
        Ok(Source::Simulate { emg, performance, description })
    }

    fn replay(settings: &AcquisitionSettings) -> anyhow::Result<Source> {
        let recording = settings.replay.recording(settings.channels);
        let path = settings.replay.path.as_deref().unwrap_or(Path::new(""));
        let summary = tendon_recordings::check(path, &recording)?;
        for notice in &summary.notices {
            tracing::warn!("{notice}");
        }
        let stream = ReplayStream::open(path, &recording, settings.sample_rate_hz, settings.block_samples)?;
        let description =
            format!("{}, {:.1} s at {} Hz", path.display(), summary.duration_s, summary.sample_rate_hz);
        Ok(Source::Replay { stream, description })
    }

    /// What to tell the user.
    pub fn describe(&self) -> String {
        match self {
            Source::Simulate { description, .. } | Source::Replay { description, .. } => description.clone(),
        }
    }

    /// Fills the next block, channel-major; gives the truth at its newest sample, or `None` at the end.
    pub fn fill(&mut self, block: &mut [f32]) -> anyhow::Result<Option<Truth>> {
        match self {
            Source::Simulate { emg, performance, .. } => {
                emg.fill_block(performance, block);
                let truth = performance.truth();
                Ok(Some(Truth::new(Some(truth.gesture as u8), truth.since_sample)))
            }
            Source::Replay { stream, .. } => Ok(stream
                .next_block(block)?
                .map(|block| Truth::new(block.cue.map(|gesture| gesture as u8), block.cue_since))),
        }
    }
}
