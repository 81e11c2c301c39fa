//! The command line that calibrates somebody with the settings of a session or a calibration.
//!
//! ```text
//! NextCalibration, settings ─▶ command_line ─▶ read and checked as if typed ─▶ tendon calibrate … -- NAME
//! ```

use anyhow::bail;
use tendon_config::Config;
use tendon_gesture::Gesture;
use tendon_people::{People, PersonName};
use tendon_process::NextCalibration;

use super::plan::check;
use crate::configuration::Base;
use crate::{Command, next, page};

/// What is typed for this calibration with the source and the settings of a session: `base` is what it was started with, `config`
/// what came of that, `page` the options of its page; `more` is typed, too. The program's name comes first.
///
/// # Errors
///
/// What keeps the calibration from being begun, such as a name that somebody has already.
pub fn command_line(
    wanted: &NextCalibration,
    (base, config): (&Base, &Config),
    page: &page::RunOptions,
    more: &[String],
) -> anyhow::Result<Vec<String>> {
    let name: PersonName = wanted.name.parse()?;
    let mut words = vec!["tendon".to_owned(), "calibrate".to_owned()];
    words.extend(base.words());
    words.extend(settings(base, config)?);
    words.extend(page.words());
    words.extend_from_slice(more);
    let names = |gestures: &Vec<Gesture>| {
        let names: Vec<String> = gestures.iter().map(Gesture::to_string).collect();
        format!("--gestures={}", names.join(","))
    };
    words.extend(wanted.gestures.as_ref().map(names));
    words.extend(wanted.repetitions.map(|repetitions| format!("--repetitions={repetitions}")));
    words.extend(wanted.redo.map(|gesture| format!("--redo={gesture}")));
    let switches = [("--check", wanted.check), ("--update", wanted.update), ("--replace", wanted.replace)];
    words.extend(switches.iter().filter(|(_, is_on)| *is_on).map(|(switch, _)| (*switch).to_owned()));
    // Whatever the name begins with, it is no option.
    words.extend(["--".to_owned(), name.to_string()]);
    let Command::Calibrate(options) = next::read(&words)? else { bail!("tendon calibrate is what follows") };
    check(&options, &People::open()?)?;
    Ok(words)
}

/// Where a session differs from what its configuration and `--set` say, because of other options or its person.
fn settings(base: &Base, config: &Config) -> anyhow::Result<Vec<String>> {
    let plain = base.configuration()?;
    let of = |config: &Config| {
        let acquisition = &config.acquisition;
        [
            ("session", format!("\"{}\"", config.session)),
            ("acquisition.channels", acquisition.channels.to_string()),
            ("acquisition.sample_rate_hz", format!("{:?}", acquisition.sample_rate_hz)),
            ("acquisition.simulate.seed", acquisition.simulate.seed.to_string()),
        ]
    };
    let changed = of(config).into_iter().zip(of(&plain)).filter(|(now, plain)| now != plain);
    Ok(changed.map(|((key, value), _)| format!("--set={key}={value}")).collect())
}
