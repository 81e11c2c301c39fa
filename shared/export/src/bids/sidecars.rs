//! What BIDS wants to be said beside the samples.

use std::path::Path;

use serde_json::{Value, json};
use tendon_signal::canonical_unit;

use super::{BidsFacts, cell};
use crate::bdf::{BdfSignal, label, physical_range};
use crate::{ExportError, Survey};

/// Version of BIDS that the data set follows.
const BIDS_VERSION: &str = "1.11.1";

/// The signals of the file, each with the range of its own samples: what the amplifier's range was is not recorded.
pub(super) fn signals(survey: &Survey) -> Result<Vec<BdfSignal>, ExportError> {
    let mut signals: Vec<BdfSignal> = Vec::new();
    for (channel, (name, (low, high))) in survey.channels.iter().zip(&survey.ranges).enumerate() {
        let (low, high) = physical_range(*low, *high).ok_or_else(|| ExportError::TooLarge {
            channel: name.clone(),
            value: low.abs().max(high.abs()),
        })?;
        signals.push(BdfSignal {
            label: label(name, channel),
            // A header has room for 8 characters.
            unit: match canonical_unit(&survey.unit) {
                "adc_counts" => "counts".to_owned(),
                unit => unit.to_owned(),
            },
            low,
            high,
        });
    }
    Ok(signals)
}

/// The text of `_channels.tsv`.
pub(super) fn channels(survey: &Survey, signals: &[BdfSignal]) -> String {
    let mut text = "name\ttype\tunits\tdescription\n".to_owned();
    for (signal, name) in signals.iter().zip(&survey.channels) {
        text += &format!("{}\tEMG\t{}\t{}\n", cell(&signal.label), cell(&signal.unit), cell(name));
    }
    text
}

/// The text of `_emg.json`.
pub(super) fn recording(survey: &Survey, facts: &BidsFacts, task: &str) -> Vec<u8> {
    let version = survey.provenance["version"].as_str().unwrap_or("unknown");
    let commit = survey.provenance["commit"].as_str().unwrap_or("unknown");
    let recording = json!({
        "TaskName": task,
        "TaskDescription": "Muscle signals of a forearm steer a robot arm",
        "EMGPlacementScheme": "Other",
        "EMGPlacementSchemeDescription": facts.placement.as_deref().unwrap_or("not recorded"),
        "EMGReference": facts.reference.as_deref().unwrap_or("n/a"),
        "EMGChannelCount": survey.channels.len(),
        "SamplingFrequency": survey.sample_rate_hz,
        "PowerLineFrequency": facts.power_line_hz.map_or_else(|| json!("n/a"), Value::from),
        "RecordingType": if survey.gaps.is_empty() { "continuous" } else { "discontinuous" },
        "RecordingDuration": survey.duration_s,
        "SoftwareFilters": "n/a",
        "HardwareFilters": "n/a",
        "SoftwareVersions": format!("Tendon {version}, commit {commit}"),
        "TendonGaps": survey.gaps,
    });
    format!("{recording:#}\n").into_bytes()
}

/// The files that a data set has once.
pub(super) fn of_the_data_set(folder: &Path) -> [(&'static str, String); 3] {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or("Tendon".into(), |name| name.to_string_lossy().into_owned());
    let description = json!({
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{ "Name": "Tendon", "Description": "tendon export --bids" }],
    });
    let participants = json!({ "pseudonym": { "Description": "Name under which the person was recorded" } });
    let readme = "Sessions in which muscle signals of a forearm steered a robot arm, recorded by Tendon.\n\n\
        Onsets count from the first sample of a recording. Where a recording has gaps, the BDF file is discontinuous \
        (BDF+D): each of its records says when it begins. The end of a part before a gap is filled up to a whole record with \
        its last value, and an event says so. Values are scaled to the range of each channel's own samples.\n";
    [
        ("dataset_description.json", format!("{description:#}\n")),
        ("participants.json", format!("{participants:#}\n")),
        ("README", readme.to_owned()),
    ]
}
