//! All histograms of a session as a log in hdrhistogram's interval format (version 1.3), which its other tools read.

use std::io::{Error, Result, Write};
use std::time::Duration;

use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};
use tendon_messages::Stage;

use crate::SessionMeasurements;

/// Writes all histograms as one interval from 0 to `length`: durations in ns, one tag a hop, stage and whole path.
///
/// # Errors
///
/// When `out` cannot be written.
pub fn write_latency_log(
    measurements: &SessionMeasurements,
    length: Duration,
    out: &mut impl Write,
) -> Result<()> {
    let mut serializer = V2DeflateSerializer::new();
    let mut log = IntervalLogWriterBuilder::new()
        .add_comment("Tendon: durations in ns, one tag a hop, stage and whole path")
        .begin_log_with(out, &mut serializer)?;
    let transits = Stage::ALL
        .into_iter()
        .filter_map(|stage| Some((format!("{}-to-{}", stage.upstream()?.name(), stage.name()), stage)))
        .map(|(name, stage)| (name, measurements.transit(stage)));
    let works =
        Stage::ALL.into_iter().map(|stage| (format!("{}-work", stage.name()), measurements.work(stage)));
    let whole = [
        ("newest-sample-to-command".to_owned(), &measurements.newest_sample_to_command),
        ("window-start-to-command".to_owned(), &measurements.window_start_to_command.histogram),
        ("control-tick".to_owned(), &measurements.control_tick),
        ("command-to-wire".to_owned(), &measurements.command_to_wire),
    ];
    for (name, histogram) in transits.chain(works).chain(whole) {
        log.write_histogram(histogram, Duration::ZERO, length, Tag::new(&name))
            .map_err(|error| Error::other(format!("{error:?}")))?;
    }
    Ok(())
}
