//! Checks beyond the type of a key: ranges, and whether the settings fit each other.
//!
//! Ranges that concern one section stand in the library that the section belongs to.

use tendon_arm::ANGULAR_SPEED_LIMIT_RAD_PER_S;
use tendon_recordings::Channel;
use tendon_transport::Delivery;

use crate::{Backend, Config, ConfigError, Source};

/// Most channels a session may have; beyond it a header is more likely damaged than meant.
const MAXIMUM_CHANNELS: usize = 1024;
/// Most samples of all channels in a second: what the stages keep of them has to fit into memory.
const MAXIMUM_SAMPLES_PER_S: f64 = 1e7;
/// Longest block of a live session, ms: every sample in it would be too old to act upon at the end of a longer one.
const LONGEST_BLOCK_MS: f64 = 100.0;
/// Longest window, s.
const LONGEST_WINDOW_S: f64 = 10.0;

/// Refuses `value` of `key`.
fn refuse(key: &'static str, value: impl ToString, remedy: impl Into<String>) -> Result<(), ConfigError> {
    Err(ConfigError::Value { key, value: value.to_string(), remedy: remedy.into() })
}

/// What a library says of its section.
fn section<E: std::fmt::Display>(section: &'static str) -> impl FnOnce(E) -> ConfigError {
    move |error| ConfigError::Section { section, reason: error.to_string() }
}

impl Config {
    /// Checks what no single key can tell: ranges, and whether the settings fit each other.
    ///
    /// # Errors
    ///
    /// [`ConfigError::Value`] or [`ConfigError::Section`] for the first that does not.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_paths()?;
        self.check_samples()?;
        self.check_simulation()?;
        self.check_source()?;
        self.check_windows()?;
        let acquisition = &self.acquisition;
        tendon_signal::SignalChain::new(&self.dsp, acquisition.channels, acquisition.sample_rate_hz)
            .map_err(section("dsp"))?;
        self.decision.check().map_err(section("decision"))?;
        self.check_arm_on_the_network()?;
        self.robot.arm.check().map_err(section("robot.arm"))?;
        if self.robot.backend == Backend::XArm {
            self.robot.arm.check_for_real_arm().map_err(section("robot.arm"))?;
        }
        self.check_speed()?;
        if self.outlets.lsl && self.delivery() == Delivery::Lossless {
            let remedy =
                "a replay at full speed would wait for who reads the streams: replay at the true pace";
            return refuse("outlets.lsl", true, remedy);
        }
        self.task.check().map_err(section("task"))
    }

    /// Refuses a speed that the arm would not keep.
    fn check_speed(&self) -> Result<(), ConfigError> {
        let (fastest_mm_per_s, fastest_deg_per_s) = self.decision.fastest();
        let limit_deg_per_s = ANGULAR_SPEED_LIMIT_RAD_PER_S.to_degrees();
        if fastest_deg_per_s > limit_deg_per_s {
            let remedy = format!(
                "the arm turns no faster than {limit_deg_per_s:.1} deg/s: take a lower speed, here or in decision.modes"
            );
            return refuse("decision.rotation_speed_deg_per_s", fastest_deg_per_s, remedy);
        }
        let limit = self.robot.arm.linear_speed_limit_mm_per_s;
        let speed = fastest_mm_per_s.max(self.decision.speed_mm_per_s);
        if speed > limit {
            let remedy = format!(
                "the arm goes no faster than robot.arm.linear_speed_limit_mm_per_s = {limit}: take a lower speed, or \
                 raise the limit"
            );
            return refuse("decision.speed_mm_per_s", speed, remedy);
        }
        Ok(())
    }

    /// Refuses paths that no `tendon.toml` can hold.
    pub(crate) fn check_paths(&self) -> Result<(), ConfigError> {
        for (key, path) in [
            ("acquisition.program", &self.acquisition.program),
            ("acquisition.simulate.profile", &self.acquisition.simulate.profile),
            ("acquisition.replay.path", &self.acquisition.replay.path),
            ("acquisition.lsl.library", &self.acquisition.lsl.library),
            ("acquisition.nidaqmx.library", &self.acquisition.nidaqmx.library),
            ("inference.model", &self.inference.model),
            ("inference.rest_move_model", &self.inference.rest_move_model),
            ("inference.person", &self.inference.person),
            ("inference.runtime_library", &self.inference.runtime_library),
        ] {
            if let Some(path) = path.as_ref().filter(|path| path.to_str().is_none()) {
                let remedy =
                    "the path is not UTF-8, which a configuration cannot hold: rename the file or folder";
                return refuse(key, path.display(), remedy);
            }
        }
        Ok(())
    }

    fn check_samples(&self) -> Result<(), ConfigError> {
        let acquisition = &self.acquisition;
        let (channels, rate_hz) = (acquisition.channels, acquisition.sample_rate_hz);
        if !(1..=MAXIMUM_CHANNELS).contains(&channels) {
            return refuse("acquisition.channels", channels, "take 1 to 1024 channels");
        }
        if !(100.0..=100_000.0).contains(&rate_hz) {
            return refuse("acquisition.sample_rate_hz", rate_hz, "take 100 to 100000 Hz");
        }
        if channels as f64 * rate_hz > MAXIMUM_SAMPLES_PER_S {
            let remedy = format!(
                "with {channels} channels take at most {:.0} Hz",
                MAXIMUM_SAMPLES_PER_S / channels as f64
            );
            return refuse("acquisition.sample_rate_hz", rate_hz, remedy);
        }
        let block_samples = acquisition.block_samples;
        if !(1..=100_000).contains(&block_samples) {
            return refuse("acquisition.block_samples", block_samples, "take 1 to 100000 samples");
        }
        let block_ms = block_samples as f64 / rate_hz * 1e3;
        if self.delivery() == Delivery::Live && block_ms > LONGEST_BLOCK_MS {
            let most = (LONGEST_BLOCK_MS * 1e-3 * rate_hz).floor();
            return refuse(
                "acquisition.block_samples",
                block_samples,
                format!(
                    "a block of {block_ms:.0} ms is too old to act upon when it comes: take at most {most} samples \
                     ({LONGEST_BLOCK_MS} ms)"
                ),
            );
        }
        Ok(())
    }

    fn check_simulation(&self) -> Result<(), ConfigError> {
        let acquisition = &self.acquisition;
        let simulate = &acquisition.simulate;
        let jitter_ms = simulate.jitter_ms;
        if !(0.0..=1000.0).contains(&jitter_ms) {
            return refuse("acquisition.simulate.jitter_ms", jitter_ms, "take 0 to 1000 ms");
        }
        let mut simulation = simulate.simulation(acquisition.channels, acquisition.sample_rate_hz);
        if acquisition.source == Source::Replay {
            // A recording may have a rate at which no muscle is simulated.
            simulation.sample_rate_hz = tendon_emg_simulation::SimulationSettings::default().sample_rate_hz;
        }
        simulation.check().map_err(section("acquisition.simulate"))?;
        simulate.contraction().check().map_err(section("acquisition.simulate"))
    }

    fn check_source(&self) -> Result<(), ConfigError> {
        let acquisition = &self.acquisition;
        if acquisition.source == Source::Device && acquisition.program.is_none() {
            let remedy = "name the program that reads the device: acquisition.source is \"device\"";
            return refuse("acquisition.program", "(none)", remedy);
        }
        if let Some(rate_hz) = acquisition.replay.sample_rate_hz
            && !(1.0..=1_000_000.0).contains(&rate_hz)
        {
            return refuse("acquisition.replay.sample_rate_hz", rate_hz, "take 1 to 1000000 Hz");
        }
        if acquisition.source == Source::Replay {
            if acquisition.replay.path.is_none() {
                let remedy = "name the recording, or use --replay PATH";
                return refuse("acquisition.replay.path", "(none)", remedy);
            }
            self.check_channels("acquisition.replay.channels", acquisition.replay.channels.as_deref())?;
        }
        acquisition.lsl.check().map_err(section("acquisition.lsl"))?;
        acquisition.nidaqmx.check().map_err(section("acquisition.nidaqmx"))?;
        if acquisition.source == Source::Otb {
            acquisition.otb.amplifier(acquisition.sample_rate_hz).map_err(section("acquisition.otb"))?;
        }
        if acquisition.source.is_amplifier() {
            if acquisition.unit.as_ref().is_some_and(|unit| unit.trim().is_empty()) {
                let remedy = "name a unit, such as mV, or leave the key out";
                return refuse("acquisition.unit", "\"\"", remedy);
            }
            self.check_channels("acquisition.channel_selection", acquisition.channel_selection.as_deref())?;
        }
        Ok(())
    }

    /// Refuses a list of channels that is not as long as the session has channels.
    fn check_channels(&self, key: &'static str, named: Option<&[Channel]>) -> Result<(), ConfigError> {
        let channels = self.acquisition.channels;
        let Some(named) = named.filter(|named| named.len() != channels) else { return Ok(()) };
        let list = format!("[{}]", named.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "));
        let remedy = format!(
            "names {}, but acquisition.channels is {channels}: name as many, or change that number",
            named.len()
        );
        refuse(key, list, remedy)
    }

    fn check_windows(&self) -> Result<(), ConfigError> {
        let rate_hz = self.acquisition.sample_rate_hz;
        let windows = &self.dsp.windows;
        let longest = (LONGEST_WINDOW_S * rate_hz) as usize;
        for (key, samples) in [
            ("dsp.windows.window_samples", windows.window_samples),
            ("dsp.windows.increment_samples", windows.increment_samples),
        ] {
            if !(1..=longest).contains(&samples) {
                return refuse(key, samples, format!("take 1 to {longest} samples ({LONGEST_WINDOW_S} s)"));
            }
        }
        let increment_ms = windows.increment_samples as f64 / rate_hz * 1e3;
        let watchdog_ms = self.robot.arm.watchdog_ms;
        if increment_ms >= watchdog_ms as f64 {
            return refuse(
                "dsp.windows.increment_samples",
                windows.increment_samples,
                format!(
                    "a command would come every {increment_ms:.0} ms, but robot.arm.watchdog_ms = {watchdog_ms} stops the \
                     arm before the next: take fewer samples"
                ),
            );
        }
        Ok(())
    }

    fn check_arm_on_the_network(&self) -> Result<(), ConfigError> {
        let xarm = &self.robot.xarm;
        let start_speed = xarm.start_speed_deg_per_s;
        if !(0.1..=45.0).contains(&start_speed) {
            return refuse("robot.xarm.start_speed_deg_per_s", start_speed, "take 0.1 to 45 degrees/s");
        }
        for (key, port) in [
            ("robot.xarm.control_port", xarm.control_port),
            ("robot.xarm.normal_report_port", xarm.normal_report_port),
            ("robot.xarm.real_time_report_port", xarm.real_time_report_port),
        ] {
            if port == 0 {
                return refuse(key, port, "take 1 to 65535");
            }
        }
        if self.robot.backend != Backend::XArm {
            return Ok(());
        }
        if xarm.address.is_none() {
            let remedy = "give the address of the arm's control box, or 127.0.0.1 for xarm-emulator";
            return refuse("robot.xarm.address", "(none)", remedy);
        }
        if self.delivery() == Delivery::Lossless {
            let remedy =
                "a real arm takes its time: replay at the true pace, or set robot.backend = \"simulate\"";
            return refuse("acquisition.replay.pace", "full", remedy);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use tendon_emg_simulation::{Performance, Profile, SimulatedEmg};

    use super::*;

    /// Numbers that somebody may write by mistake.
    const ODD_NUMBERS: [&str; 9] =
        ["nan", "inf", "-inf", "-1", "-1.0", "0", "0.0", "1e300", "9223372036854775807"];

    fn refusal(config: &Config) -> String {
        config.check().unwrap_err().to_string()
    }

    #[test]
    fn settings_that_do_not_fit_each_other_are_refused() {
        let mut config = Config::default();
        config.acquisition.source = Source::Replay;
        assert!(refusal(&config).contains("--replay PATH"));
        config.acquisition.replay.path = Some("x".into());
        config.acquisition.replay.channels = Some(vec![Channel::Index(0)]);
        assert!(
            refusal(&config)
                .contains("acquisition.replay.channels = [0]: names 1, but acquisition.channels is 4")
        );
    }

    #[test]
    fn a_device_without_the_program_that_reads_it_is_refused() {
        let mut config = Config::default();
        config.acquisition.source = Source::Device;
        assert!(refusal(&config).contains("acquisition.program"), "{}", refusal(&config));
        config.acquisition.program = Some("acquire".into());
        config.check().unwrap();
    }

    #[test]
    fn channels_and_unit_of_an_amplifier_are_checked_and_of_nobody_else() {
        let mut config = Config::default();
        config.acquisition.channel_selection = Some(vec!["flexor".into(), "extensor".into()]);
        config.acquisition.unit = Some(" ".to_owned());
        config.check().unwrap();
        config.acquisition.source = Source::Device;
        config.acquisition.program = Some("acquire".into());
        assert!(refusal(&config).contains("acquisition.unit"), "{}", refusal(&config));
        config.acquisition.unit = Some("mV".to_owned());
        let refused = refusal(&config);
        assert!(
            refused.contains("acquisition.channel_selection = [`flexor`, `extensor`]: names 2"),
            "{refused}"
        );
        config.acquisition.channels = 2;
        config.check().unwrap();
    }

    #[test]
    fn blocks_too_old_to_act_upon_are_refused() {
        let mut config = Config::default();
        config.acquisition.block_samples = 200;
        config.check().unwrap();
        config.acquisition.block_samples = 201;
        assert!(refusal(&config).contains("block_samples = 201") && refusal(&config).contains("at most 200"));
    }

    #[test]
    fn a_speed_beyond_the_arms_limit_is_refused_with_both() {
        let mut config = Config::default();
        config.decision.speed_mm_per_s = 100.0;
        config.check().unwrap();
        config.decision.speed_mm_per_s = 101.0;
        let refused = refusal(&config);
        for part in ["decision.speed_mm_per_s = 101", "linear_speed_limit_mm_per_s = 100", "raise the limit"]
        {
            assert!(refused.contains(part), "{refused}");
        }
    }

    #[test]
    fn increments_beyond_the_watchdog_are_refused() {
        let mut config = Config::default();
        config.dsp.windows.increment_samples = 299;
        config.check().unwrap();
        config.dsp.windows.increment_samples = 300;
        assert!(refusal(&config).contains("watchdog_ms = 150"), "{}", refusal(&config));
    }

    #[test]
    fn what_would_disarm_a_real_arm_is_refused() {
        let mut config = Config::default();
        config.robot.arm.watchdog_ms = 10_000;
        config.robot.arm.linear_speed_limit_mm_per_s = 400.0;
        config.check().unwrap();
        config.robot.backend = Backend::XArm;
        config.robot.xarm.address = Some("127.0.0.1".parse().unwrap());
        assert!(
            refusal(&config).contains("watchdog_ms is 10000: a real arm near a person may have at most 300")
        );
        config.robot.arm.watchdog_ms = 300;
        assert!(refusal(&config).contains("linear_speed_limit_mm_per_s is 400"));
        config.robot.arm.linear_speed_limit_mm_per_s = 250.0;
        config.check().unwrap();
    }

    /// Keys of all numbers, `robot.arm.workspace_min_mm.1` for one in a list.
    fn numbers(value: &toml::Value, key: &str, into: &mut Vec<String>) {
        let inner = |name: &str| if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") };
        match value {
            toml::Value::Table(table) => {
                table.iter().for_each(|(name, value)| numbers(value, &inner(name), into))
            }
            toml::Value::Array(list) => {
                list.iter()
                    .enumerate()
                    .for_each(|(index, value)| numbers(value, &inner(&index.to_string()), into));
            }
            toml::Value::Integer(_) | toml::Value::Float(_) => into.push(key.to_owned()),
            _ => {}
        }
    }

    fn set(value: &mut toml::Value, key: &str, number: &toml::Value) {
        match (key.split_once('.').unwrap_or((key, "")), value) {
            ((_, _), value) if key.is_empty() => *value = number.clone(),
            ((name, rest), toml::Value::Table(table)) => set(&mut table[name], rest, number),
            ((name, rest), toml::Value::Array(list)) => {
                set(&mut list[name.parse::<usize>().unwrap()], rest, number)
            }
            _ => unreachable!("keys come from the same table"),
        }
    }

    /// What a session makes of its settings; none of it may panic once they have passed.
    fn build(config: &Config) {
        let acquisition = &config.acquisition;
        let simulation = acquisition.simulate.simulation(acquisition.channels, acquisition.sample_rate_hz);
        let _ = SimulatedEmg::new(&Profile::default(), &simulation);
        let _ = Performance::at_rest(
            &config.decision.gestures,
            acquisition.simulate.contraction(),
            acquisition.sample_rate_hz,
        );
        let _ = tendon_arm::SimulatedArm::new(config.robot.arm.clone(), 0);
    }

    #[test]
    fn every_number_that_cannot_work_is_refused_by_name() {
        for backend in [Backend::Simulate, Backend::XArm] {
            let mut config = Config::default();
            config.robot.backend = backend;
            config.robot.xarm.address = Some("127.0.0.1".parse().unwrap());
            config.acquisition.simulate.clip_at = Some(1.0);
            config.acquisition.replay.sample_rate_hz = Some(1000.0);
            config.acquisition.replay.repetition = Some(0);
            config.check().unwrap();
            let root: toml::Value = config.to_toml().parse::<toml::Table>().unwrap().into();
            let mut keys = Vec::new();
            numbers(&root, "", &mut keys);
            assert!(keys.len() > 60, "{keys:?}");
            for key in keys {
                for odd in ODD_NUMBERS {
                    let number = format!("number = {odd}").parse::<toml::Table>().unwrap()["number"].clone();
                    let mut changed = root.clone();
                    set(&mut changed, &key, &number);
                    let text = toml::to_string(&changed).unwrap();
                    let checked = Config::parse(&text, Path::new("tendon.toml"))
                        .and_then(|config| config.check().map(|()| config));
                    let name = key.split('.').rfind(|part| part.parse::<usize>().is_err()).unwrap();
                    match checked {
                        Ok(config) => {
                            assert!(!matches!(odd, "nan" | "inf" | "-inf"), "{key} = {odd} is let through");
                            build(&config);
                        }
                        Err(error) => {
                            let error = error.to_string();
                            // Bounds of the arm depend on one another: the error may name the other one.
                            let of_arm = key.starts_with("robot.arm.") && error.starts_with("[robot.arm]");
                            assert!(error.contains(name) || of_arm, "{key} = {odd}: {error}");
                        }
                    }
                }
            }
        }
    }
}
