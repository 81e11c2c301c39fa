//! A strategy in a live session: one recording at its true pace through all processes.

use std::fs;
use std::io;
use std::path::Path;
use std::process::{Command, Stdio};

use tendon_gesture::Strategy;
use tendon_report::Report;

use crate::error::ExperimentError;

/// The models of the live sessions.
pub(crate) struct LiveModels<'a> {
    pub(crate) five_gesture: &'a Path,
    pub(crate) rest_move: &'a Path,
    pub(crate) six_class: &'a Path,
}

/// Runs `tendon run`, which is `program`, on `recording`; report and figures go to `out`.
pub(crate) fn run_live(
    program: &Path,
    strategy: Strategy,
    recording: &Path,
    models: &LiveModels<'_>,
    out: &Path,
) -> Result<Report, ExperimentError> {
    let json = out.join(format!("live-{}.json", strategy.name()));
    let mut command = session(program, strategy, recording, models);
    let output = command
        .arg("--json")
        .arg(&json)
        .arg("--figures")
        .arg(out.join("figures").join(strategy.name()))
        .stdin(Stdio::null())
        .output()
        .map_err(|reason| ExperimentError::Start { program: program.to_owned(), reason })?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Err(ExperimentError::Session { strategy, message });
    }
    let report =
        fs::read_to_string(&json).and_then(|text| serde_json::from_str(&text).map_err(io::Error::from));
    report.map_err(|reason| ExperimentError::Report { path: json, reason })
}

/// The session of a strategy with the models that it needs: `tendon run` refuses others.
fn session(program: &Path, strategy: Strategy, recording: &Path, models: &LiveModels<'_>) -> Command {
    let model = if strategy == Strategy::Direct { models.six_class } else { models.five_gesture };
    let mut command = Command::new(program);
    command
        .args(["run", "--session", &format!("experiments-{}", std::process::id()), "--replay"])
        .arg(recording)
        .args(["--repetition", "0", "--strategy", strategy.name(), "--model"])
        .arg(model);
    if strategy == Strategy::TwoStage {
        command.arg("--rest-move-model").arg(models.rest_move);
    }
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_names_the_models_of_its_strategy_only() {
        let path = Path::new;
        let models =
            LiveModels { five_gesture: path("five"), rest_move: path("two"), six_class: path("six") };
        for (strategy, expected) in [
            (Strategy::Threshold, vec!["five"]),
            (Strategy::TwoStage, vec!["five", "two"]),
            (Strategy::Direct, vec!["six"]),
        ] {
            let command = session(path("tendon"), strategy, path("emg"), &models);
            let named = command
                .get_args()
                .filter(|argument| ["five", "two", "six"].iter().any(|name| argument == name));
            assert_eq!(named.collect::<Vec<_>>(), expected, "{strategy:?}");
        }
    }
}
