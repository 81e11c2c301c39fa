//! Which channels of recordings and amplifiers are taken where nobody says which.
//!
//! ```text
//! recorded by Tendon         all of them
//! your own recordings        the first four that look like EMG (see `tendon_recordings::muscles`), or all, if they are fewer
//! 3DC                        0, 3, 5, 8
//! Ozdemir                    0, 1, 2, 3: all that there are
//! ```

use std::path::PathBuf;

use anyhow::{bail, ensure};
use tendon_config::AcquisitionSettings;
use tendon_dataset::{DatasetSettings, Layout, Recording, list};
use tendon_recordings::{Channel, RecordedSession, muscles};

/// Of the 3DC armband, those that come nearest to the places of the paper's electrodes.
const DEFAULT: [usize; 4] = [0, 3, 5, 8];

/// The channels `given`, by the names that the recordings at or below `paths` give them, or else those that these are taken to
/// have. The channels of `settings` do not matter.
///
/// # Errors
///
/// The recordings cannot be listed, or have no channel that looks like EMG.
pub fn channels_or_default(
    given: &[Channel],
    settings: &DatasetSettings,
    paths: &[PathBuf],
) -> anyhow::Result<Vec<Channel>> {
    if !given.is_empty() {
        return named_by_recordings(given, settings, paths);
    }
    let found = list(settings, paths)?;
    match found.layout {
        Layout::ThreeDc => return Ok(of_three_dc()),
        Layout::OzdemirMat | Layout::OzdemirTrials => return Ok((0..4).map(Channel::Index).collect()),
        Layout::Labelled => {}
    }
    // What cannot be read is said when it is used, unless that is true of all.
    let readable = |recording: &Recording| recording.file_channels(settings).is_ok();
    let Some(recording) = found.recordings.iter().find(|recording| readable(recording)) else {
        let first = &found.recordings[0];
        let problem = first.file_channels(settings).err().map(|error| error.below(&first.path));
        bail!("{}: {}", first.path.display(), problem.unwrap_or_default());
    };
    let mut channels = muscles(&recording.path, settings.label_column.as_ref())?;
    if RecordedSession::beside(&recording.path)?.is_none() {
        channels.truncate(DEFAULT.len());
    }
    ensure!(
        !channels.is_empty(),
        "{}: no channel looks like EMG ({}): say which to take, such as --channels 0,1,2,3",
        recording.path.display(),
        listed(&recording.file_channels(settings)?)
    );
    Ok(channels)
}

/// Asks an amplifier for these channels, by name, and this unit, unless the user asks for others.
pub fn ask_for(acquisition: &mut AcquisitionSettings, channels: &[String], unit: &str) {
    if !acquisition.source.is_amplifier() {
        return;
    }
    if acquisition.channel_selection.is_none() {
        acquisition.channel_selection = Some(channels.iter().cloned().map(Channel::Name).collect());
    }
    if acquisition.unit.is_none() && !unit.is_empty() {
        acquisition.unit = Some(unit.to_owned());
    }
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
    fn of_a_table_the_first_muscles_are_taken() {
        let folder = tempfile::tempdir().unwrap();
        let four = ["flexor", "extensor", "thumb", "ulna"].map(Channel::from);
        for header in [
            "flexor,extensor,thumb,ulna",
            "Time,flexor,extensor,ACC X,thumb,ulna,brachioradialis,gesture",
            "flexor,extensor,thumb,ulna,a,b,c,d,e,f",
        ] {
            table(folder.path(), header);
            assert_eq!(channels(folder.path(), &[]).unwrap(), four, "{header}");
            let names: Vec<&str> = header.split(',').collect();
            assert_eq!(
                channels(folder.path(), &[2, 0]).unwrap(),
                [names[2], names[0]].map(Channel::from),
                "{header}"
            );
        }
        table(folder.path(), "flexor,time");
        assert_eq!(channels(folder.path(), &[]).unwrap(), [Channel::from("flexor")]);
        let ozdemir = tempfile::tempdir().unwrap();
        std::fs::write(ozdemir.path().join("P1_C0_G0.csv"), "1,2,3,4\n".repeat(100)).unwrap();
        assert_eq!(channels(ozdemir.path(), &[]).unwrap(), [0, 1, 2, 3].map(Channel::Index));
        table(folder.path(), "time,label,battery");
        let refused = channels(folder.path(), &[]).unwrap_err();
        assert!(
            refused.contains("(time, label, battery)") && refused.contains("--channels 0,1,2,3"),
            "{refused}"
        );
    }
}
