//! The sources that come with Tendon.

use std::path::Path;

use anyhow::{Context, bail};
use tendon_config::{Config, Gestures, Source as SourceKind};
use tendon_emg_simulation::{Performance, Repeat, Script, SimulatedEmg};
use tendon_gesture::{Gesture, GestureSet};
use tendon_messages::Truth;
use tendon_process::SignalDescription;
use tendon_recordings::table::Rate;
use tendon_recordings::{LONGEST_SILENCE_S, ReplayStream, summed_up};
use tendon_source::{BlockMaker, MadeBlock, Pace, Paced, Source, SourceError};
use tendon_transport::Delivery;

use crate::recorded_session::{RecordedSession, is_recorded_session};

/// Gestures in a random sequence before it begins again.
const RANDOM_GESTURES: usize = 1000;

/// A source that is open.
pub struct Opened {
    pub source: Box<dyn Source>,
    /// What to tell the user.
    pub description: String,
    /// What it measures, if it knows.
    pub signal: Option<SignalDescription>,
}

/// Opens the source that the settings name. A recording is read through once, so that
/// a bad one is refused before anything moves.
pub fn open(config: &Config) -> anyhow::Result<Opened> {
    let settings = &config.acquisition;
    let pace = match config.delivery() {
        Delivery::Live => Pace::True {
            sample_rate_hz: settings.sample_rate_hz,
            jitter_ns: settings.simulate.jitter_ms * 1e6,
            seed: settings.simulate.seed,
            longest_silence_s: LONGEST_SILENCE_S,
        },
        Delivery::Lossless => Pace::Full,
    };
    let samples = settings.block_samples;
    let signal;
    let (source, description): (Box<dyn Source>, String) = match settings.source {
        SourceKind::Simulate => {
            let (person, description, measured) = SimulatedPerson::open(config)?;
            signal = Some(measured);
            (Box::new(Paced::new(person, pace, samples)), description)
        }
        SourceKind::Replay if is_recorded_session(settings) => {
            let session = RecordedSession::open(settings, config.delivery())?;
            let description = session.description();
            signal = session.signal();
            (Box::new(session), description)
        }
        SourceKind::Replay => {
            let (recording, description, measured) = Recording::open(config)?;
            signal = Some(measured);
            (Box::new(Paced::new(recording, pace, samples)), description)
        }
        amplifier => bail!(
            "acquisition.source = \"{}\": this program reads no amplifier; another one does (acquisition.program)",
            amplifier.name()
        ),
    };
    Ok(Opened { source, description, signal })
}

/// The simulated person at the simulated amplifier.
struct SimulatedPerson {
    /// Of the session.
    gestures: GestureSet,
    emg: SimulatedEmg,
    performance: Performance,
}

impl SimulatedPerson {
    fn open(config: &Config) -> anyhow::Result<(SimulatedPerson, String, SignalDescription)> {
        let settings = &config.acquisition;
        let simulate = &settings.simulate;
        let (emg, profile) = settings.open_simulation()?;
        let contraction = simulate.contraction();
        let gestures = emg.gestures();
        let of_script = |script| {
            Performance::of_script(gestures, script, Repeat::Forever, contraction, settings.sample_rate_hz)
        };
        let (performance, what) = match simulate.gestures {
            Gestures::Script => {
                let script: Script = simulate.script.parse().context("acquisition.simulate.script")?;
                script.check(gestures).context("acquisition.simulate.script")?;
                let description = format!("script of {:.0} s", script.duration().as_secs_f64());
                (of_script(script), description)
            }
            Gestures::Random => {
                let script = Script::random(gestures, simulate.seed, RANDOM_GESTURES);
                (of_script(script), "random gestures".to_owned())
            }
            Gestures::Keyboard => (
                Performance::at_rest(gestures, contraction, settings.sample_rate_hz),
                "gestures as told".to_owned(),
            ),
        };
        let description =
            format!("simulated amplifier, {what}, seed {}, profile: {}", simulate.seed, profile.source);
        // It has no names of its own. A table needs names that are no numbers.
        let channels = (0..settings.channels).map(|channel| format!("channel_{channel}")).collect();
        let signal = SignalDescription { channels, unit: profile.unit };
        let gestures = config.decision.gestures.clone();
        Ok((SimulatedPerson { gestures, emg, performance }, description, signal))
    }
}

impl BlockMaker for SimulatedPerson {
    fn make(&mut self, samples: &mut [f32]) -> Result<Option<MadeBlock>, SourceError> {
        self.emg.fill_block(&mut self.performance, samples);
        let truth = self.performance.truth();
        let truth = Truth::new(self.gestures.number(truth.gesture), truth.since_sample);
        Ok(Some(MadeBlock { lost_samples: 0, truth }))
    }

    fn set_gesture(&mut self, gesture: Gesture, effort: f32) {
        self.performance.set_gesture(gesture, effort);
    }
}

/// A recording; its cues say which gesture is made.
struct Recording {
    stream: ReplayStream,
    /// Index of the sample that comes next if none is missing.
    next_sample: u64,
    /// Of the session.
    gestures: GestureSet,
}

impl Recording {
    fn open(config: &Config) -> anyhow::Result<(Recording, String, SignalDescription)> {
        let settings = &config.acquisition;
        let (summary, stream) = settings.open_recording()?;
        let path = settings.replay.path.as_deref().unwrap_or(Path::new(""));
        // A folder may lack many files: one line for all of them.
        summed_up(&summary.notices).iter().for_each(|notice| tracing::warn!("{notice}"));
        if let Some(notice) = stream.rate_notice() {
            tracing::info!("{notice}");
        }
        let columns = summary.channels.join(", ");
        let description = format!(
            "{}, {:.1} s at {} Hz, columns {columns}{}",
            path.display(),
            summary.duration_s,
            Rate(summary.sample_rate_hz),
            if summary.unit.is_empty() { String::new() } else { format!(", in {}", summary.unit) }
        );
        let gestures = config.decision.gestures.clone();
        let signal = SignalDescription { channels: summary.channels, unit: summary.unit };
        Ok((Recording { stream, next_sample: 0, gestures }, description, signal))
    }
}

impl BlockMaker for Recording {
    fn make(&mut self, samples: &mut [f32]) -> Result<Option<MadeBlock>, SourceError> {
        let Some(block) = self.stream.next_block(samples).map_err(SourceError::new)? else { return Ok(None) };
        let lost_samples = block.first_sample - self.next_sample;
        self.next_sample = block.first_sample + (samples.len() / self.stream.source().channels()) as u64;
        let number = block.cue.and_then(|gesture| self.gestures.number(gesture));
        Ok(Some(MadeBlock { lost_samples, truth: Truth::new(number, block.cue_since) }))
    }
}
