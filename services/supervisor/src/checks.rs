//! What keeps a session from running on this machine: `tendon run` refuses it, `tendon doctor` shows it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, ensure};
use tendon_classifier::{Recogniser, RecogniserFiles, WindowSource};
use tendon_config::{Config, Gestures, Source};
use tendon_daqmx::{Daqmx, NidaqmxSettings};
use tendon_emg_simulation::Script;
use tendon_gesture::Strategy;
use tendon_lsl::{Lsl, LslSettings};
use tendon_messages::{
    BLOCKS, COMMANDS, MEASUREMENTS, PREDICTIONS, STATE_LENGTH, STATES, Stage, TWIST_LENGTH, WINDOWS,
};
use tendon_otb::Dialling;
use tendon_process::BATCH_LENGTH;
use tendon_session::{RECORDER_PROGRAM, check_source_program};
use tendon_session_file::{Head, is_session_file};
use tendon_transport::{required_bytes, shared_memory_directory};

use crate::provenance;

/// How long a stream of LSL is looked for.
const LSL_LOOK: Duration = Duration::from_millis(500);

/// Refuses a session that would run out of shared memory, because that kills the process which touches the
/// page that is missing (SIGBUS). Returns the free and the needed bytes.
///
/// # Errors
///
/// When there is too little, or none can be seen.
pub fn shared_memory(config: &Config) -> anyhow::Result<(u64, u64)> {
    let needed = required_bytes(&BLOCKS, config.block_length())
        + required_bytes(&WINDOWS, config.window_length())
        + required_bytes(&PREDICTIONS, 2 * config.decision.gestures.len())
        + required_bytes(&COMMANDS, TWIST_LENGTH)
        + required_bytes(&STATES, STATE_LENGTH)
        + Stage::ALL.len() as u64 * required_bytes(&MEASUREMENTS, BATCH_LENGTH);
    let folder = shared_memory_directory();
    let status = nix::sys::statvfs::statvfs(folder)
        .with_context(|| format!("cannot look at {}: is it mounted?", folder.display()))?;
    let free = status.blocks_available() * status.fragment_size();
    let megabytes = |bytes: u64| bytes.div_ceil(1_000_000);
    ensure!(
        needed <= free,
        "{}: {} MB free, but the session may need {} MB: free some (`tendon doctor`), enlarge it (mount -o \
         remount,size=… {0}), or take fewer channels or shorter blocks",
        folder.display(),
        megabytes(free),
        megabytes(needed)
    );
    Ok((free, needed))
}

/// The folder of this program, in which all stages lie.
///
/// # Errors
///
/// With the names of those that are missing.
pub fn programs() -> anyhow::Result<PathBuf> {
    let program = std::env::current_exe().context("cannot find this program's own folder")?;
    let folder = program.parent().unwrap_or(Path::new("/")).to_owned();
    let stages = Stage::ALL.map(|stage| format!("tendon-{}", stage.name()));
    let missing: Vec<&str> = stages
        .iter()
        .map(String::as_str)
        .chain([RECORDER_PROGRAM])
        .filter(|program| !folder.join(program).is_file())
        .collect();
    ensure!(
        missing.is_empty(),
        "{} not in {}: build them with ./scripts/run or `cargo build --release`",
        missing.join(", "),
        folder.display()
    );
    Ok(folder)
}

/// Loads the models of this configuration in ONNX Runtime, or its person, and compares them with the session, as the stage inference does
/// when it starts. Says which run.
///
/// # Errors
///
/// When one is missing, broken or made for another session.
pub fn models(config: &Config) -> anyhow::Result<String> {
    let Config { acquisition, inference, decision, dsp, .. } = config;
    provenance::models(config)?;
    let files = RecogniserFiles {
        runtime_library: inference.runtime_library.as_deref(),
        model: inference.model.as_deref(),
        rest_move_model: inference.rest_move_model.as_deref(),
        person: inference.person.as_deref(),
        person_checksum: inference.person_checksum.as_deref(),
    };
    let recogniser =
        Recogniser::open(decision, &dsp.windows, &files)?.with_adaptation(inference.adaptation)?;
    let (channels, rate_hz) = (acquisition.channels, acquisition.sample_rate_hz);
    recogniser.check_fit(&WindowSource::of_chain("the session", channels, rate_hz, dsp))?;
    let models: Vec<String> = recogniser.models().iter().map(|path| path.display().to_string()).collect();
    if decision.strategy == Strategy::Personal {
        return Ok(models.join(", "));
    }
    let library = tendon_classifier::runtime_library(files.runtime_library)?;
    Ok(format!("{} in {}", models.join(", "), library.display()))
}

/// Opens the source of the samples, as the stage acquisition does when it starts. Says what it is.
///
/// # Errors
///
/// When the program, the recording, the profile or the script cannot be used.
pub fn source(config: &Config) -> anyhow::Result<String> {
    let acquisition = &config.acquisition;
    if let Some(program) = &acquisition.program {
        check_source_program(config)?;
        return Ok(format!("{} can be started", program.display()));
    }
    match acquisition.source {
        Source::Simulate => {
            let (emg, profile) = acquisition.open_simulation()?;
            if acquisition.simulate.gestures == Gestures::Script {
                let script: Script =
                    acquisition.simulate.script.parse().context("acquisition.simulate.script")?;
                script.check(emg.gestures()).context("acquisition.simulate.script")?;
            }
            Ok(format!("simulated amplifier, profile: {}", profile.source))
        }
        Source::Replay if acquisition.replay.path.as_deref().is_some_and(is_session_file) => {
            let path = acquisition.replay.path.as_deref().unwrap_or(Path::new(""));
            Head::read(path)?;
            Ok(format!("recorded session {}", path.display()))
        }
        Source::Replay => {
            let (summary, stream) = acquisition.open_recording()?;
            let first = &stream.source().segments()[0].file;
            let columns = summary.channels.join(", ");
            Ok(format!("{}, {:.1} s, columns {columns}", first.display(), summary.duration_s))
        }
        Source::Lsl => lsl(&acquisition.lsl),
        Source::Nidaqmx => {
            let daqmx = Daqmx::load(acquisition.nidaqmx.library.as_deref())?;
            Ok(format!("NI-DAQmx {}, {}", daqmx.version()?, acquisition.nidaqmx.channels))
        }
        Source::Otb => {
            let amplifier = acquisition.otb.amplifier(acquisition.sample_rate_hz)?;
            let (name, address) = (amplifier.name(), acquisition.otb.address_of(&amplifier));
            Ok(match amplifier.dialling() {
                Dialling::Device { .. } => format!("{name}, which dials in at {address}"),
                Dialling::Computer { .. } => format!("{name} at {address}"),
            })
        }
        Source::Delsys => Ok(format!(
            "Delsys Trigno at {}, port {}",
            acquisition.delsys.address, acquisition.delsys.command_port
        )),
        Source::Stream => Ok(format!("a program that connects to {}", acquisition.stream.address)),
        Source::Device => Ok("a device".to_owned()),
    }
}

/// NI's driver and its devices.
pub fn nidaqmx(settings: &NidaqmxSettings) -> String {
    let daqmx = match Daqmx::load(settings.library.as_deref()) {
        Ok(daqmx) => daqmx,
        Err(error) => return format!("not there, needed only for NI devices ({error})"),
    };
    let library = daqmx.path().display();
    match daqmx.version().and_then(|version| Ok((version, daqmx.devices()?))) {
        Err(error) => format!("{library} does not answer: {error}"),
        Ok((version, devices)) => {
            let devices: Vec<String> =
                devices.iter().map(|device| format!("{} ({})", device.name, device.product)).collect();
            let devices = if devices.is_empty() { "none".to_owned() } else { devices.join(", ") };
            format!("{library} found, version {version}; devices: {devices}")
        }
    }
}

/// Loads what gives a session's results to other programs, if that is asked for.
///
/// # Errors
///
/// When it is not there.
pub fn outlets(config: &Config) -> anyhow::Result<()> {
    if config.outlets.lsl {
        let library = tendon_lsl::find_library(config.acquisition.lsl.library.as_deref());
        library.and_then(|library| Lsl::load(&library)).context("outlets.lsl (--lsl-out)")?;
    }
    Ok(())
}

/// Loads liblsl and looks for the stream that a session would read, for a moment only. Says what is there.
///
/// # Errors
///
/// When there is no liblsl.
pub fn lsl(settings: &LslSettings) -> anyhow::Result<String> {
    let library = tendon_lsl::find_library(settings.library.as_deref())?;
    let lsl = Lsl::load(&library)?;
    let found = lsl.find(settings, LSL_LOOK)?;
    let streams: Vec<String> = found.iter().map(|stream| stream.facts.to_string()).collect();
    let streams = if streams.is_empty() {
        format!("no stream with {} now: `tendon sources` lists those there are", settings.describe())
    } else {
        streams.join("; ")
    };
    Ok(format!("{}, version {}; {streams}", library.display(), lsl.version()))
}
