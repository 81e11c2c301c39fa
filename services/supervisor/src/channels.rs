//! Which channels of recordings are taken where nobody says which.
//!
//! ```text
//! recorded by Tendon                 all of them
//! tables of at most four columns     all of them
//! others                             0, 3, 5, 8, or a refusal where there are not so many
//! ```

use std::path::PathBuf;

use anyhow::ensure;
use tendon_dataset::{DatasetSettings, Layout, list};
use tendon_recordings::{Channel, RecordedSession};

/// Of the 3DC armband, those that come nearest to the places of the paper's electrodes.
const DEFAULT: [usize; 4] = [0, 3, 5, 8];

/// The channels `given`, by the names that the recordings at or below `paths` give them, or else those that the recordings at or below `paths` are taken to have. The channels of `settings` do
/// not matter.
///
/// # Errors
///
/// The recordings cannot be listed, or have too few channels and too many to choose among them.
pub fn channels_or_default(
    given: &[Channel],
    settings: &DatasetSettings,
    paths: &[PathBuf],
) -> anyhow::Result<Vec<Channel>> {
    if !given.is_empty() {
        return named_by_recordings(given, settings, paths);
    }
    let found = list(settings, paths)?;
    if found.layout != Layout::Labelled {
        return Ok(of_three_dc());
    }
    // What cannot be read is said when it is used.
    let readable =
        |recording| Some((recording, tendon_dataset::Recording::file_channels(recording, settings).ok()?));
    let Some((recording, channels)) = found.recordings.iter().find_map(readable) else {
        return Ok(of_three_dc());
    };
    if channels.len() <= DEFAULT.len() || RecordedSession::beside(&recording.path)?.is_some() {
        return Ok(channels);
    }
    ensure!(
        DEFAULT.iter().all(|channel| *channel < channels.len()),
        "{} has {} channels ({}): say which to take, in which order, such as --channels 0,1,2,3",
        recording.path.display(),
        channels.len(),
        listed(&channels)
    );
    Ok(of_three_dc())
}

/// The channels of 3DC that are taken where nobody says which.
pub fn of_three_dc() -> Vec<Channel> {
    DEFAULT.map(Channel::Index).to_vec()
}

/// The channels `given`, by the names that the recordings at or below `paths` give them: a recording in which the columns lie
/// otherwise is then read rightly.
fn named_by_recordings(
    given: &[Channel],
    settings: &DatasetSettings,
    paths: &[PathBuf],
) -> anyhow::Result<Vec<Channel>> {
    let found = list(settings, paths)?;
    let own = found.recordings.iter().find_map(|recording| recording.file_channels(settings).ok());
    let own = own.filter(|_| found.layout == Layout::Labelled).unwrap_or_default();
    let named = |channel: &Channel| match channel {
        Channel::Index(index) => own.get(*index).unwrap_or(channel).clone(),
        Channel::Name(_) => channel.clone(),
    };
    Ok(given.iter().map(named).collect())
}

/// Channels by name, as messages list them.
pub fn listed(channels: &[Channel]) -> String {
    channels.iter().map(Channel::name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn table(folder: &Path, header: &str) {
        let row = vec!["0.5"; header.split(',').count()].join(",");
        std::fs::write(folder.join("a.csv"), format!("{header}\n{}", format!("{row}\n").repeat(100)))
            .unwrap();
        std::fs::write(folder.join("labels.csv"), "file,person,repetition,gesture\na.csv,1,0,rest\n")
            .unwrap();
    }

    fn channels(folder: &Path, given: &[usize]) -> Result<Vec<Channel>, String> {
        let given: Vec<Channel> = given.iter().copied().map(Channel::Index).collect();
        let settings = DatasetSettings { recording_rate_hz: Some(1000.0), ..DatasetSettings::default() };
        channels_or_default(&given, &settings, &[folder.to_owned()]).map_err(|error| error.to_string())
    }

    #[test]
    fn a_small_table_is_taken_whole_and_of_a_larger_one_nobody_guesses() {
        let folder = tempfile::tempdir().unwrap();
        table(folder.path(), "flexor,extensor,thumb,ulna");
        assert_eq!(
            channels(folder.path(), &[]).unwrap(),
            ["flexor", "extensor", "thumb", "ulna"].map(Channel::from)
        );
        assert_eq!(channels(folder.path(), &[2, 0]).unwrap(), ["thumb", "flexor"].map(Channel::from));
        table(folder.path(), "a,b,c,d,e,f");
        let refused = channels(folder.path(), &[]).unwrap_err();
        assert!(
            refused.contains("has 6 channels (a, b, c, d, e, f)") && refused.contains("--channels 0,1,2,3"),
            "{refused}"
        );
        assert_eq!(channels(folder.path(), &[5]).unwrap(), [Channel::from("f")]);
        table(folder.path(), "a,b,c,d,e,f,g,h,i");
        assert_eq!(channels(folder.path(), &[]).unwrap(), [0, 3, 5, 8].map(Channel::from));
    }
}
