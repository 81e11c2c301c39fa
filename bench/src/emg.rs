//! Simulated EMG to work on, as acquisition makes it by default.

use anyhow::Context;
use tendon_config::AcquisitionSettings;
use tendon_emg_simulation::{Performance, Profile, Repeat, SimulatedEmg};

/// A simulated person with `channels` electrodes, and the default script over and over.
pub fn simulated(channels: usize) -> anyhow::Result<(SimulatedEmg, Performance)> {
    let AcquisitionSettings { sample_rate_hz, simulate, .. } = AcquisitionSettings::default();
    let emg = SimulatedEmg::new(&Profile::default(), &simulate.simulation(channels, sample_rate_hz))?;
    let script = simulate.script.parse().context("the default script")?;
    let contraction = simulate.contraction();
    let performance =
        Performance::of_script(emg.gestures(), script, Repeat::Forever, contraction, sample_rate_hz);
    Ok((emg, performance))
}
