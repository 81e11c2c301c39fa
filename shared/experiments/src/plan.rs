//! What is to be built, trained and compared: the paper's section "Methodological Comparisons" and "Final Selected
//! System" as a list.

use tendon_dataset::DatasetSettings;
use tendon_recordings::Channel;
use tendon_signal::{FilterSettings, OnsetMethod, OnsetSettings, WindowInput, WindowSettings};

/// A way to cut recordings into windows.
#[derive(Clone, Copy, Debug)]
pub struct DatasetPlan {
    pub name: &'static str,
    pub input: WindowInput,
    pub onset: OnsetMethod,
    /// In ms.
    pub window_ms: f64,
    /// Share of a window that the next one has, too.
    pub overlap: f64,
}

const RAW: DatasetPlan = DatasetPlan {
    name: "raw",
    input: WindowInput::Raw,
    onset: OnsetMethod::Baseline,
    window_ms: 300.0,
    overlap: 0.75,
};

/// All data sets.
pub const DATASETS: [DatasetPlan; 5] = [
    RAW,
    DatasetPlan { name: "envelope", input: WindowInput::Envelope, ..RAW },
    DatasetPlan { name: "peak-percentile", onset: OnsetMethod::PeakPercentile, ..RAW },
    DatasetPlan { name: "window-250", window_ms: 250.0, overlap: 0.5, ..RAW },
    DatasetPlan { name: "window-350", window_ms: 350.0, ..RAW },
];

impl DatasetPlan {
    /// The settings of the data set, for recordings with these channels.
    pub fn settings(&self, channels: &[usize], filter: Option<FilterSettings>) -> DatasetSettings {
        let default = DatasetSettings::default();
        let window_samples = (self.window_ms * 1e-3 * default.sample_rate_hz).round() as usize;
        let increment_samples = (window_samples as f64 * (1.0 - self.overlap)).round() as usize;
        DatasetSettings {
            channels: channels.iter().copied().map(Channel::Index).collect(),
            filter,
            input: self.input,
            windows: WindowSettings { window_samples, increment_samples },
            onset: OnsetSettings { method: self.onset, ..default.onset.clone() },
            ..default
        }
    }
}

/// A model to be trained.
#[derive(Clone, Copy, Debug)]
pub struct ModelPlan {
    /// Its name in the report and in `paper.toml`.
    pub name: &'static str,
    /// `--network` of scripts/train.
    pub network: &'static str,
    /// Name of its [`DatasetPlan`].
    pub dataset: &'static str,
    /// `--classes` of scripts/train.
    pub classes: &'static str,
    /// Whether it is trained with every seed, for a comparison with its spread, or with the first only.
    pub every_seed: bool,
}

/// All models.
pub const MODELS: [ModelPlan; 11] = {
    const SIX: ModelPlan =
        ModelPlan { name: "", network: "cnn", dataset: "raw", classes: "six", every_seed: true };
    const ONCE: ModelPlan = ModelPlan { every_seed: false, ..SIX };
    [
        ModelPlan { name: "cnn-raw", ..SIX },
        ModelPlan { name: "five-gesture", classes: "five", ..ONCE },
        ModelPlan { name: "rest-move", classes: "rest-move", ..ONCE },
        ModelPlan { name: "cnn-percentile", dataset: "peak-percentile", ..SIX },
        ModelPlan { name: "cnn-envelope", dataset: "envelope", ..SIX },
        ModelPlan { name: "lstm-raw", network: "lstm", ..SIX },
        ModelPlan { name: "lstm-envelope", network: "lstm", dataset: "envelope", ..SIX },
        ModelPlan { name: "window-250", dataset: "window-250", ..ONCE },
        ModelPlan { name: "window-350", dataset: "window-350", ..ONCE },
        ModelPlan { name: "four-gesture", classes: "four", ..ONCE },
        ModelPlan { name: "two-gesture", classes: "extension,flexion", ..ONCE },
    ]
};

/// One training.
#[derive(Clone, Copy, Debug)]
pub struct Training {
    pub model: ModelPlan,
    pub seed: u64,
    pub epochs: u32,
}

impl Training {
    /// The trainings, the first seed's first: what is wanted soonest comes soonest.
    pub fn all(seeds: &[u64], epochs: u32) -> Vec<Training> {
        let of_seed = |(index, &seed): (usize, &u64)| {
            let models = MODELS.into_iter().filter(move |model| index == 0 || model.every_seed);
            models.map(move |model| Training { model, seed, epochs })
        };
        seeds.iter().enumerate().flat_map(of_seed).collect()
    }

    /// Name of the model's file, without its ending: another recipe, another name.
    pub fn name(&self) -> String {
        format!("{}-{}epochs-seed{}", self.model.name, self.epochs, self.seed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_has_its_data_set_and_windows_are_those_of_the_paper() {
        for model in MODELS {
            assert!(DATASETS.iter().any(|dataset| dataset.name == model.dataset), "{}", model.name);
        }
        let windows = DATASETS.map(|dataset| dataset.settings(&[0, 1, 2, 3], None).windows);
        let lengths = windows.map(|windows| (windows.window_samples, windows.increment_samples));
        assert_eq!(lengths, [(600, 150), (600, 150), (600, 150), (500, 250), (700, 175)]);
    }

    #[test]
    fn comparisons_are_trained_with_every_seed_and_the_rest_once() {
        let trainings = Training::all(&[0, 1, 2], 30);
        assert_eq!(trainings.len(), 6 + 5 * 3);
        assert_eq!(trainings[0].name(), "cnn-raw-30epochs-seed0");
        let names: std::collections::BTreeSet<String> = trainings.iter().map(Training::name).collect();
        assert_eq!(names.len(), trainings.len());
    }
}
