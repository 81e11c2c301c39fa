//! `tendon calibrate NAME`: records a person by cues, or takes recordings with cues, fits the person and keeps them.
//!
//! ```text
//! options ─┬─ --from ───────────────────────────────────▶ fit ─▶ findings? ─▶ people/NAME/person.toml ─▶ report
//!          └─ plan ─▶ guided ─▶ round of cues ─▶ recording ─▶ fit or update ─▶ … ─▶ check round ─▶ scores ─▶ report, learnt
//!                       └─ status, on the board and the page meanwhile; next: what is begun from the page
//! ```

mod board;
mod check;
mod fit;
mod guided;
mod in_words;
mod learnt;
mod next;
mod options;
mod page;
mod plan;
mod recording;
mod report;
mod round;
mod scores;
mod status;
mod update;

use std::path::PathBuf;

use anyhow::anyhow;
use tendon_output::check_distinct;
use tendon_people::People;
use tendon_provenance::Provenance;

use crate::Failure;
use crate::configuration::WINDOW_KEYS;
use crate::next::Following;
use crate::output::checked_private;
use crate::provenance::PROGRAM;

use fit::{Selection, fit};
pub use next::command_line;
pub use options::Options;
use report::report;
pub use status::CalibrationStatus;

/// Fits a person and keeps them; gives what is to follow, if somebody at the page has asked for something.
pub fn calibrate(options: &Options) -> Result<Option<Following>, Failure> {
    let json = checked_private(options.json.as_deref())?;
    let inputs = options.from.iter().map(PathBuf::as_path).chain(options.base.file());
    check_distinct(&json, [], inputs).map_err(Failure::input)?;
    let begun = Provenance::begin(PROGRAM);
    let people = People::open().map_err(Failure::input)?;
    let _reserved = people.reserve(&options.name).map_err(Failure::input)?;
    if options.from.is_empty() {
        if let Some(option) = options.recording.given() {
            return Err(Failure::input(anyhow!(
                "{option} is for recordings: name some with --from, or leave {option} out"
            )));
        }
        return guided::calibrate(options, &people, json.as_ref(), begun);
    }
    if !options.replace {
        people.check_new(&options.name).map_err(Failure::input)?;
    }
    let begun = begun.with_recording(&options.from).map_err(Failure::input)?;
    let config = options.base.configuration_of("tendon calibrate --from", &WINDOW_KEYS);
    let config = config.map_err(Failure::input)?;
    let selection =
        Selection { paths: &options.from, repetitions: options.repetitions, gestures: &options.gestures };
    let fitted = fit(options, &config, &selection, &[], &begun).map_err(Failure::input)?;
    if let Some(serious) = fitted.serious() {
        return Err(Failure::input(anyhow!(
            "{} is not kept: {serious}. Or leave out what is wrong with --gestures or --channels",
            options.name
        )));
    }
    let file = people.replace(&fitted.person).map_err(Failure::running)?;
    report(options, &fitted, &file, None, begun, json.as_ref()).map(|()| None)
}
