//! A configuration from its file, and with the changes of a command line.

use std::path::{Path, PathBuf};

use tendon_emg_simulation::Profile;

use crate::{Config, ConfigError};

impl Config {
    /// Reads the configuration at `path`. Relative paths in it become absolute, from its folder.
    ///
    /// # Errors
    ///
    /// [`ConfigError`], naming file, line and key.
    pub fn read(path: &Path) -> Result<Config, ConfigError> {
        let text = tendon_input::read_text(path, tendon_input::LARGEST_SETTINGS)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let mut config = Config::parse(&text, path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for file in config.files_mut() {
            *file = folder.join(&file);
        }
        config.check_paths()?;
        Ok(config)
    }

    /// Every file that the configuration names. A profile that comes with Tendon is none.
    pub fn files_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let is_file = |profile: &&mut PathBuf| !profile.to_str().is_some_and(Profile::is_stranger);
        let profile = self.acquisition.simulate.profile.as_mut().filter(is_file);
        [
            &mut self.acquisition.program,
            &mut self.acquisition.replay.path,
            &mut self.acquisition.lsl.library,
            &mut self.acquisition.nidaqmx.library,
            &mut self.inference.model,
            &mut self.inference.rest_move_model,
            &mut self.inference.person,
            &mut self.inference.runtime_library,
        ]
        .into_iter()
        .flatten()
        .chain(profile)
    }

    /// The configuration with one key changed, given as on the command line: `acquisition.channels=8`.
    /// Anything that is not a TOML value counts as text, and so do the items of a list: a shell takes their quotes away.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Assignment`] when there is no such key or the value does not fit it, [`ConfigError::Value`] when a
    /// path is not UTF-8.
    pub fn with(&self, assignment: &str) -> Result<Config, ConfigError> {
        let refused =
            |message: String| ConfigError::Assignment { assignment: assignment.to_owned(), message };
        let no_assignment = || refused("write KEY=VALUE, such as acquisition.channels=8".to_owned());
        let no_table = |key: &str| {
            refused(format!(
                "`{key}` has no keys of its own: set it as a whole, or write it in a configuration file"
            ))
        };
        let (key, value) = assignment.split_once('=').ok_or_else(no_assignment)?;
        let value = value_of(value);
        self.check_paths()?;
        let mut root = toml::Table::try_from(self).expect("paths are UTF-8, all else TOML can say: tested");
        let mut table = &mut root;
        let mut keys = key.trim().split('.').peekable();
        while let Some(key) = keys.next() {
            if keys.peek().is_none() {
                table.insert(key.to_owned(), value);
                break;
            }
            table = table
                .entry(key)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                .as_table_mut()
                .ok_or_else(|| no_table(key))?;
        }
        let text = toml::to_string(&root).map_err(|_| no_assignment())?;
        // Its line and column are of a text that nobody wrote.
        toml::from_str(&text).map_err(|error| refused(without_place(error.message())))
    }

    /// Reads a configuration from `text`; `path` is only for messages.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Parse`].
    pub fn parse(text: &str, path: &Path) -> Result<Config, ConfigError> {
        toml::from_str(text).map_err(|error| {
            let message = error.to_string();
            let lines = [message.trim_end().to_owned(), suggestion(&message)];
            let message = lines.into_iter().filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n");
            ConfigError::Parse { path: path.to_owned(), message }
        })
    }

    /// The configuration as the text of a `tendon.toml`.
    ///
    /// # Panics
    ///
    /// When a path is not UTF-8, which [`Config::check`] refuses.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("paths are UTF-8: checked; all else TOML can say: tested")
    }
}

/// A value as it was typed.
fn value_of(typed: &str) -> toml::Value {
    let toml = format!("value = {typed}").parse::<toml::Table>().ok();
    if let Some(value) = toml.and_then(|mut table| table.remove("value")) {
        return value;
    }
    match typed.trim().strip_prefix('[').and_then(|typed| typed.strip_suffix(']')) {
        // What looks like a table in it is none that can be read.
        Some(items) if !items.contains(['[', '{']) => {
            items.split(',').map(|item| value_of(item.trim())).collect::<Vec<toml::Value>>().into()
        }
        _ => typed.into(),
    }
}

/// What is wrong with the one key that was set, in a line: with the nearest known one if there is one, else with all.
fn without_place(message: &str) -> String {
    if message.contains("expected a sequence") {
        return format!("{}; write a list as KEY=[ITEM,ITEM]", message.trim_end());
    }
    match suggestion(message) {
        near if near.is_empty() => message.trim_end().to_owned(),
        near => {
            let problem = message.split(", expected").next().unwrap_or(message);
            format!("{}; {near}", problem.replace("unknown field", "unknown key"))
        }
    }
}

/// A sentence with the known key or value nearest to the unknown one in `message`. serde lists the known ones
/// in backticks after the unknown one.
fn suggestion(message: &str) -> String {
    let Some(start) = message.find("unknown field").or_else(|| message.find("unknown variant")) else {
        return String::new();
    };
    let mut names = message[start..].split('`').skip(1).step_by(2);
    let Some(unknown) = names.next() else {
        return String::new();
    };
    names
        .map(|known| (strsim::damerau_levenshtein(unknown, known), known))
        .min()
        .filter(|(distance, known)| *distance <= 2.max(known.len() / 3))
        .map_or_else(String::new, |(_, known)| format!("did you mean `{known}`?"))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;
    use tendon_recordings::Channel;

    use super::*;

    fn parse(text: &str) -> Result<Config, String> {
        Config::parse(text, Path::new("tendon.toml")).map_err(|error| error.to_string())
    }

    /// A configuration in which every key has a value, those too that are left out by default.
    fn every_key() -> Config {
        let mut config = Config::default();
        config.acquisition.program = Some("x".into());
        config.acquisition.channel_selection = Some(vec![]);
        config.acquisition.unit = Some("x".into());
        config.acquisition.simulate.profile = Some("x".into());
        config.acquisition.simulate.clip_at = Some(1.0);
        config.acquisition.otb.address = Some(([127, 0, 0, 1], 1).into());
        config.acquisition.otb.inputs = Some(8);
        config.acquisition.replay.path = Some("x".into());
        config.acquisition.replay.sample_rate_hz = Some(1.0);
        config.acquisition.replay.channels = Some(vec![]);
        config.acquisition.replay.label_column = Some(Channel::Index(0));
        config.acquisition.replay.repetition = Some(0);
        config.acquisition.lsl.library = Some("x".into());
        config.acquisition.nidaqmx.library = Some("x".into());
        config.inference.model = Some("x".into());
        config.inference.rest_move_model = Some("x".into());
        config.inference.person = Some("x".into());
        config.inference.person_checksum = Some("x".into());
        config.inference.runtime_library = Some("x".into());
        config.decision.long_grip_s = Some(1.0);
        config.robot.xarm.address = Some("127.0.0.1".parse().unwrap());
        config
    }

    /// The keys of a table with the sections that they are in: `acquisition.simulate.seed`.
    fn keys(table: &toml::Table, section: &str) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        for (key, value) in table {
            match value {
                toml::Value::Table(table) => found.extend(keys(table, &format!("{section}{key}."))),
                _ => drop(found.insert(format!("{section}{key}"))),
            }
        }
        found
    }

    #[test]
    fn an_empty_file_is_the_default_and_the_default_is_valid() {
        assert_eq!(parse("").unwrap(), Config::default());
        Config::default().check().unwrap();
    }

    #[test]
    fn the_documented_file_holds_every_key_at_its_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tendon.toml");
        let text = std::fs::read_to_string(path).unwrap();
        assert_eq!(parse(&text).unwrap(), Config::default());
        // What is left out by default stands there as a comment: `# key = value`.
        let is_key = |line: &str| {
            let name = line.split(" = ").next().filter(|name| name.len() < line.len());
            name.is_some_and(|name| {
                name.bytes().all(|byte| byte.is_ascii_lowercase() || b"_0123456789".contains(&byte))
            })
        };
        let uncommented: Vec<&str> = text
            .lines()
            .map(|line| line.strip_prefix("# ").filter(|line| is_key(line)).unwrap_or(line))
            .collect();
        let documented = keys(&uncommented.join("\n").parse().unwrap(), "");
        let known = keys(&every_key().to_toml().parse().unwrap(), "");
        assert_eq!(documented, known);
        let without_a_seed = text.replacen("\nseed = 0 ", "\n", 1);
        assert_ne!(keys(&without_a_seed.parse().unwrap(), "").len(), keys(&text.parse().unwrap(), "").len());
    }

    #[test]
    fn a_configuration_reads_back_from_its_text() {
        let mut config = every_key();
        config.acquisition.replay.channels = Some(vec![Channel::Index(2), Channel::Name("biceps".into())]);
        assert_eq!(parse(&config.to_toml()).unwrap(), config);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_the_nearest_known_one() {
        let error = parse("[acquisition]\nblock_sample = 5\n").unwrap_err();
        for part in ["tendon.toml", "line 2", "block_sample", "did you mean `block_samples`?"] {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
        let error = parse("[robot]\nbackend = \"foo\"\n").unwrap_err();
        assert_eq!(error, error.trim_end());
    }

    #[test]
    fn one_key_is_changed_as_on_the_command_line() {
        let config = Config::default().with("acquisition.channels=8").unwrap();
        assert_eq!(config.acquisition.channels, 8);
        let config = config.with("acquisition.simulate.script=rest 1s, grip 2s").unwrap();
        assert_eq!(config.acquisition.simulate.script, "rest 1s, grip 2s");
        assert_eq!(config.acquisition.channels, 8);
        for (assignment, expected) in [
            ("acquisition.chanels=8", "did you mean `channels`?"),
            ("acquisition.channels=many", "invalid type"),
            ("channels", "write KEY=VALUE"),
        ] {
            let error = config.with(assignment).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains(assignment), "{error}");
            assert!(!error.contains("line ") && !error.contains('\n'), "{error}");
        }
        assert_eq!(
            config.with("robot.bakend=xarm").unwrap_err().to_string(),
            "--set robot.bakend=xarm: unknown key `bakend`; did you mean `backend`?"
        );
        assert_eq!(
            config.with("robot.backend=foo").unwrap_err().to_string(),
            "--set robot.backend=foo: unknown variant `foo`, expected `simulate` or `xarm`"
        );
    }

    #[test]
    fn a_list_is_set_with_the_quotes_that_a_shell_takes_away_or_without() {
        let gestures = ["rest", "fist", "point"].map(|name| name.parse().unwrap());
        for list in ["[\"rest\",\"fist\",\"point\"]", "[rest, fist,point]"] {
            let config = Config::default().with(&format!("decision.gestures={list}")).unwrap();
            assert!(config.decision.gestures.iter().eq(gestures), "{list}");
        }
        let config = Config::default().with("acquisition.replay.channels=[2,flexor]").unwrap();
        let channels = vec![Channel::Index(2), Channel::Name("flexor".into())];
        assert_eq!(config.acquisition.replay.channels, Some(channels));
        let config = config.with("dsp.filter.band_pass_hz=[20, 450]").unwrap();
        assert_eq!(config.dsp.filter.band_pass_hz, [20.0, 450.0]);
        for (assignment, expected) in [
            ("decision.gestures=rest,fist", "write a list as KEY=[ITEM,ITEM]"),
            ("decision.modes.name=a", "`modes` has no keys of its own"),
        ] {
            let error = config.with(assignment).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn an_error_in_the_second_mode_is_shown_where_it_is() {
        let first = "[[decision.modes]]\nname = \"a\"\ngrip = \"gripper\"\n";
        for line in
            ["ulnar = \"up\"", "ulnar = 3", "ulnar = { motion = \"+z\", sped = 1.0 }", "Ulnar = \"+y\""]
        {
            let error = parse(&format!("{first}[[decision.modes]]\nname = \"b\"\n{line}\n")).unwrap_err();
            assert!(error.contains("line 6"), "{error}");
        }
        let nameless = parse(&format!("{first}[[decision.modes]]\nulnar = \"+y\"\n")).unwrap_err();
        assert!(nameless.contains("line 4") && nameless.contains("missing field `name`"), "{nameless}");
    }

    #[test]
    fn a_path_that_is_not_utf_8_is_refused_and_makes_nothing_panic() {
        use std::os::unix::ffi::OsStrExt;
        let odd = Path::new(std::ffi::OsStr::from_bytes(b"m\xfcller"));
        let mut config = Config::default();
        config.acquisition.replay.path = Some(odd.join("emg.csv"));
        for refused in [config.check(), config.with("session=other").map(drop)] {
            let message = refused.unwrap_err().to_string();
            assert!(
                message.starts_with("acquisition.replay.path = ") && message.contains("rename"),
                "{message}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join(odd)).unwrap();
        let path = folder.path().join(odd).join("tendon.toml");
        std::fs::write(&path, "[inference]\nmodel = \"x.onnx\"\n").unwrap();
        assert!(Config::read(&path).unwrap_err().to_string().contains("inference.model = "));
        std::fs::write(&path, "[inference]\nmodel = \"/x.onnx\"\n").unwrap();
        Config::read(&path).unwrap();
    }

    #[test]
    fn the_text_of_an_error_appears_once() {
        let error = Config::read(Path::new("/nowhere/tendon.toml")).unwrap_err();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(!error.to_string().contains(&source), "{error}");
    }

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in "[\\x00-\\x7f]{0,200}") {
            let _ = parse(&text);
        }
    }
}
