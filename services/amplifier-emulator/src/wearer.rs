//! The simulated person who wears the amplifier.

use std::path::PathBuf;

use anyhow::Context;
use tendon_emg_simulation::{
    ContractionSettings, DEFAULT_SCRIPT, Performance, Profile, Repeat, Script, SimulatedEmg,
    SimulationSettings,
};
use tendon_gesture::Gesture;

/// Electrodes of the profiles. Further channels of an amplifier repeat them.
const ELECTRODES: usize = 4;

/// Who wears the amplifier, and what they do.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Person")]
pub struct WearerOptions {
    /// Gestures and how long each is held, repeated. A gesture typed on standard input ends it.
    #[arg(long, default_value = DEFAULT_SCRIPT)]
    script: String,
    /// A profile made by `tendon profile fit`, or stranger-19, -20, -22; without it, somebody whom the models know. A count
    /// of theirs is a microvolt here.
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// The same seed gives the same samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// The simulated person.
#[derive(Debug)]
pub struct Wearer {
    emg: SimulatedEmg,
    performance: Performance,
    microvolts: f32,
    sample: [f32; ELECTRODES],
}

impl WearerOptions {
    /// The person, sampled at `rate_hz`.
    ///
    /// # Errors
    ///
    /// When the profile or the script cannot be used.
    pub fn open(&self, rate_hz: f64) -> anyhow::Result<Wearer> {
        let profile = self.read_profile()?;
        let settings = SimulationSettings {
            channels: ELECTRODES,
            sample_rate_hz: rate_hz,
            seed: self.seed,
            ..SimulationSettings::default()
        };
        let emg = SimulatedEmg::new(&profile, &settings)?;
        let script: Script = self.script.parse().context("--script")?;
        script.check(emg.gestures()).context("--script")?;
        let contraction = ContractionSettings::default();
        let performance =
            Performance::of_script(emg.gestures(), script, Repeat::Forever, contraction, rate_hz);
        // What is no voltage is taken for microvolts.
        let microvolts = tendon_source::unit_factor(&profile.unit, "uV").unwrap_or(1.0) as f32;
        Ok(Wearer { emg, performance, microvolts, sample: [0.0; ELECTRODES] })
    }

    fn read_profile(&self) -> anyhow::Result<Profile> {
        let Some(path) = &self.profile else { return Ok(Profile::default()) };
        if let Some(stranger) = path.to_str().and_then(Profile::of_stranger) {
            return Ok(stranger);
        }
        let text =
            std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Profile::from_toml(&text).with_context(|| path.display().to_string())
    }
}

impl Wearer {
    /// Goes on by a sample, and gives what lies at the electrodes, uV.
    pub fn next_sample(&mut self) -> &[f32] {
        self.emg.fill_block(&mut self.performance, &mut self.sample);
        self.sample.iter_mut().for_each(|value| *value *= self.microvolts);
        &self.sample
    }

    /// Makes this gesture from now on.
    pub fn set_gesture(&mut self, gesture: Gesture) {
        self.performance.set_gesture(gesture, 1.0);
    }
}
