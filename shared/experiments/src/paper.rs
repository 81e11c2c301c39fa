//! The paper's own results.

use std::collections::BTreeMap;

use serde::Deserialize;

/// All of them.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paper {
    /// By name of the model's plan, and `window-300`.
    pub models: BTreeMap<String, PaperModel>,
    /// By method.
    pub onsets: BTreeMap<String, PaperOnsets>,
    /// By name of the strategy.
    pub strategies: BTreeMap<String, PaperStrategy>,
    pub latency: PaperLatency,
}

/// A table of scores.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperModel {
    pub accuracy: f64,
    pub loss: Option<f64>,
    pub validation_accuracy: Option<f64>,
    pub training_windows: Option<u64>,
    /// Precision, recall, F1, windows.
    pub per_class: BTreeMap<String, [f64; 4]>,
}

/// How one method found onsets: 200 recordings of each gesture.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperOnsets {
    pub fallbacks: BTreeMap<String, u64>,
    pub mean_ms: f64,
    pub sd_ms: f64,
    pub min_ms: f64,
    pub max_ms: f64,
}

/// Shares of windows, in percent.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperStrategy {
    #[serde(default)]
    pub moving_percent: BTreeMap<String, f64>,
    pub correct_percent: BTreeMap<String, f64>,
}

/// From the beginning of a window to its command.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperLatency {
    pub mean_ms: f64,
    pub sd_ms: f64,
    pub min_ms: f64,
    pub median_ms: f64,
    pub max_ms: f64,
}

impl Paper {
    /// The paper's results, as this program carries them.
    pub fn results() -> Paper {
        toml::from_str(include_str!("paper.toml")).expect("the file is part of this program: tested")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::MODELS;
    use tendon_gesture::Strategy;

    #[test]
    fn the_paper_says_something_on_every_plan_that_it_has_results_of() {
        let paper = Paper::results();
        let known = |name: &str| MODELS.iter().any(|model| model.name == name) || name == "window-300";
        assert!(paper.models.keys().all(|name| known(name)));
        assert_eq!(paper.models.len(), 9);
        assert!(
            paper
                .models
                .iter()
                .all(|(name, model)| { model.per_class.len() == if name == "five-gesture" { 5 } else { 6 } })
        );
        assert!(Strategy::ALL.iter().all(|strategy| paper.strategies.contains_key(strategy.name())));
        // Each table's accuracy is the mean recall, weighted by windows.
        for (name, model) in &paper.models {
            let windows: f64 = model.per_class.values().map(|scores| scores[3]).sum();
            let right: f64 = model.per_class.values().map(|scores| scores[1] * scores[3]).sum();
            assert!((right / windows - model.accuracy).abs() < 2e-4, "{name}");
        }
    }
}
