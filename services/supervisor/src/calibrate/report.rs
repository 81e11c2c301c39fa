//! What a calibration has learnt, for the terminal and for `--json`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;
use tendon_evaluation::LeftOut;
use tendon_output::{OutputFile, collect};
use tendon_people::{ChannelQuality, ChannelShift, Expected, GestureFit, HeldOut, Person, PersonName};
use tendon_provenance::Provenance;
use tendon_recordings::SkippedKind;

use super::fit::Fitted;
use super::options::Options;
use super::scores::{CheckScores, UpdateScores};
use crate::Failure;
use crate::output::{left_out, print};

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Learnt<'a> {
    person: &'a PersonName,
    file: String,
    fit_s: f64,
    prior_people: usize,
    expected: &'a Expected,
    gestures: &'a [GestureFit],
    channels: &'a [ChannelQuality],
    findings: Vec<String>,
    skipped: &'a [LeftOut],
    skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// What an update changed; `null` if it is none.
    update: Option<&'a UpdateScores>,
    /// How the check round was recognised; `null` without one.
    check: Option<&'a CheckScores>,
    provenance: Provenance,
}

/// Says what was learnt.
pub fn report(
    options: &Options,
    fitted: &Fitted,
    file: &Path,
    check: Option<&CheckScores>,
    begun: Provenance,
    json: Option<&OutputFile>,
) -> Result<(), Failure> {
    let Fitted { person, fit_s, skipped, update } = fitted;
    let learnt = Learnt {
        person: &person.name,
        file: file.display().to_string(),
        fit_s: *fit_s,
        prior_people: person.made.prior_people.len(),
        expected: &person.expected,
        gestures: &person.gestures,
        channels: &person.channels,
        findings: person.findings.iter().map(ToString::to_string).collect(),
        skipped,
        skipped_by_kind: SkippedKind::count(skipped.iter().map(|left_out| left_out.kind)),
        update: update.as_ref(),
        check,
        provenance: begun,
    };
    let written = collect(json.iter().map(|json| json.write_json(&learnt))).map_err(Failure::running);
    written.and(print(text(options, &learnt, person)).map_err(Failure::running))
}

/// What was learnt, for people.
fn text(options: &Options, learnt: &Learnt, person: &Person) -> String {
    let signal = &person.signal;
    let unit = if signal.unit.is_empty() { String::new() } else { format!(" in {}", signal.unit) };
    let mut text = format!(
        "{}: {} gestures on channels {}{unit}, windows of {:.0} ms\n",
        person.name,
        person.gestures.len(),
        signal.channels.join(", "),
        1e3 * signal.window_samples as f64 / signal.sample_rate_hz
    );
    let prior = match learnt.prior_people {
        0 => "without other people".to_owned(),
        people => format!("with what {people} other people have in common"),
    };
    match learnt.update {
        Some(update) => text += &updated(update),
        None => {
            let _ = writeln!(text, "fitted in {:.2} s, {prior}", learnt.fit_s);
        }
    }
    text += &expected(&person.expected);
    text += &confusion(person);
    text += &channels(&person.channels);
    if !learnt.skipped.is_empty() {
        text += &format!("{}\n\n", left_out(learnt.skipped));
    }
    if let Some(CheckScores { before_by, before, after, after_by_gesture }) = learnt.check {
        let _ = write!(text, "check round: {:.1} % of the windows recognised", 100.0 * after);
        if let (Some(by), Some(before)) = (before_by, before) {
            let _ = write!(text, "; {by} recognises {:.1} %", 100.0 * before);
        }
        let shares =
            after_by_gesture.iter().map(|(gesture, share)| format!("{gesture} {:.0} %", 100.0 * share));
        let _ = writeln!(text, "\n  {}\n", shares.collect::<Vec<_>>().join(", "));
    }
    for finding in &learnt.findings {
        text += &format!("- {finding}\n");
    }
    text + &format!(
        "kept in {}\nnow: tendon run --person {}{}",
        learnt.file,
        person.name,
        options.base.typed()
    )
}

/// What an update changed, for people.
fn updated(UpdateScores { before, after, channels }: &UpdateScores) -> String {
    let mut text = format!(
        "updated to how rest and the gestures are now: of the windows of the update, {:.1} % were recognised before, and {:.1} \
         % are now (the update was made of them: --check asks for others)\n\n",
        100.0 * before,
        100.0 * after
    );
    let _ = writeln!(text, "{:<24} {:>12} {:>12}", "times the calibration's", "rest", "gestures");
    for ChannelShift { name, rest, gestures } in channels {
        let _ = writeln!(text, "{name:<24} {rest:>12.2} {gestures:>12.2}");
    }
    text + "\nwhat follows is of the calibration\n"
}

/// What can be expected, and what of, for people. The figures of moved electrodes are those of docs/person.md.
fn expected(Expected { accuracy, held_out, without_effort_share, if_alike, .. }: &Expected) -> String {
    let how = match (held_out, if_alike) {
        (HeldOut::Repetitions, _) => ": each repetition was recognised by a fit to the others".to_owned(),
        (HeldOut::MadeUpRepetitions, Some(if_alike)) => format!(
            " if the next repetitions differ from the only one as other people's do, {:.1} % if they are like it; repeat each \
             gesture to know",
            100.0 * if_alike
        ),
        (HeldOut::MadeUpRepetitions, None) => {
            " if the next repetitions differ from the only one as other people's do; repeat each gesture to know".to_owned()
        }
        (HeldOut::PartsOfOneRepetition, _) => {
            ", which is too much: there is one repetition only, and parts of it were recognised by a fit to the others; repeat \
             each gesture to know"
                .to_owned()
        }
    };
    let mut text = format!(
        "expected accuracy {:.1} %{how}\n\
         That is for now, with the electrodes as they are. Another day is usually lower: when the electrodes were moved by a tenth \
         of the way around the arm, fifteen people fell from 98 to 61 %, and --update brought them to 92 %.\n",
        100.0 * accuracy
    );
    if *without_effort_share > 0.0 {
        let _ = writeln!(
            text,
            "Not counted: {:.0} % of the windows of gestures, which are as weak as rest.",
            100.0 * without_effort_share
        );
    }
    text.push('\n');
    text
}

/// Percent of the windows of each gesture, by what they were recognised as.
fn confusion(person: &Person) -> String {
    let mut text = format!("{:<24}", "made \\ recognised, %");
    for gesture in &person.gestures {
        let _ = write!(text, " {:>10}", gesture.name);
    }
    text.push('\n');
    for (gesture, row) in person.gestures.iter().zip(&person.expected.confusion) {
        let _ = write!(text, "{:<24}", gesture.name);
        let windows = row.iter().sum::<usize>().max(1) as f64;
        for count in row {
            let _ = write!(text, " {:>10.1}", 100.0 * *count as f64 / windows);
        }
        text.push('\n');
    }
    text.push('\n');
    text
}

fn channels(channels: &[ChannelQuality]) -> String {
    let mut text =
        format!("{:<24} {:>12} {:>18} {:>10}\n", "channel", "SNR, dB", "mains at rest, %", "clipped, %");
    for quality in channels {
        let ChannelQuality { name, signal_to_noise_db, mains_share, clipped_share, .. } = quality;
        let (mains, clipped) = (100.0 * mains_share, 100.0 * clipped_share);
        let _ = writeln!(text, "{name:<24} {signal_to_noise_db:>12.1} {mains:>18.1} {clipped:>10.2}");
    }
    text.push('\n');
    text
}
