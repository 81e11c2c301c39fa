//! `tendon doctor`: what this machine offers a session, and how to mend what is wrong.

use clap::Args;
use tendon_classifier::{Classifier, DEFAULT_REST_MOVE_MODEL_FILE};
use tendon_config::{Config, Realtime, SchedulingSettings};
use tendon_messages::Stage;
use tendon_process::Policy;
use tendon_transport::{Leftovers, Removed, SessionLock, SessionLockError, shared_memory_directory};

use crate::options::read_configuration;
use crate::output::print;
use crate::{Failure, checks};

/// Free shared memory that a session with default settings is comfortable with, bytes.
const COMFORTABLE_BYTES: u64 = 64_000_000;

/// Command line of `tendon doctor`.
#[derive(Debug, Args)]
pub struct Options {
    /// Remove what sessions that no longer run left in shared memory.
    #[arg(long)]
    clean: bool,
}

/// How a finding weighs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Weight {
    Good,
    /// Works, but not as well as it could.
    Weak,
    /// No session will run.
    Broken,
}

struct Findings {
    broken: usize,
    /// Whether they could be shown.
    printed: anyhow::Result<()>,
}

impl Findings {
    fn add(&mut self, weight: Weight, what: &str, finding: &str) {
        let mark = match weight {
            Weight::Good => "ok    ",
            Weight::Weak => "weak  ",
            Weight::Broken => "BROKEN",
        };
        let printed = print(format_args!("{mark}  {what:<18}{finding}"));
        self.printed = std::mem::replace(&mut self.printed, Ok(())).and(printed);
        self.broken += usize::from(weight == Weight::Broken);
    }
}

/// Examines the machine.
pub fn examine(options: &Options) -> Result<(), Failure> {
    let mut findings = Findings { broken: 0, printed: Ok(()) };
    programs(&mut findings);
    let config = configuration(&mut findings);
    folders(&mut findings);
    runtime_and_models(&mut findings, &config);
    shared_memory(&mut findings, &config);
    scheduling(&mut findings);
    leftovers(&mut findings, options.clean);
    findings.printed.map_err(Failure::running)?;
    if findings.broken > 0 {
        return Err(Failure::running(anyhow::anyhow!(
            "{} of these keep a session from running",
            findings.broken
        )));
    }
    Ok(())
}

fn programs(findings: &mut Findings) {
    match checks::programs() {
        Ok(folder) => {
            findings.add(Weight::Good, "programs", &format!("all stages are in {}", folder.display()));
        }
        Err(error) => findings.add(Weight::Broken, "programs", &format!("{error:#}")),
    }
}

/// The configuration that `tendon run` would read here; the default if it is broken.
fn configuration(findings: &mut Findings) -> Config {
    let read = read_configuration(None).and_then(|config| Ok(config.check().map(|()| config)?));
    match read {
        Ok(config) => {
            let finding = format!("good, for session `{}`", config.session);
            findings.add(Weight::Good, "configuration", &finding);
            config
        }
        Err(error) => {
            findings.add(Weight::Broken, "configuration", &format!("{error:#}"));
            Config::default()
        }
    }
}

fn folders(findings: &mut Findings) {
    for (what, folder) in
        [("run-time folder", tendon_paths::runtime_folder()), ("state folder", tendon_paths::state_folder())]
    {
        match folder {
            Ok(folder) => findings.add(Weight::Good, what, &folder.path().display().to_string()),
            Err(error) => findings.add(Weight::Broken, what, &format!("{:#}", anyhow::Error::from(error))),
        }
    }
}

fn runtime_and_models(findings: &mut Findings, config: &Config) {
    let library = match tendon_classifier::runtime_library(config.inference.runtime_library.as_deref()) {
        Ok(library) => library,
        Err(error) => return findings.add(Weight::Broken, "runtime library", &error.to_string()),
    };
    for file in ["cnn-five-gesture.onnx", "cnn-six-class.onnx", DEFAULT_REST_MOVE_MODEL_FILE] {
        let loaded = tendon_classifier::model_beside_program(file)
            .and_then(|model| Classifier::load(&library, &model).map(|_| model));
        match loaded {
            Ok(model) => {
                let finding = format!("{} runs in {}", model.display(), library.display());
                findings.add(Weight::Good, "model and runtime", &finding);
            }
            Err(error) => findings.add(Weight::Broken, "model and runtime", &error.to_string()),
        }
    }
}

fn shared_memory(findings: &mut Findings, config: &Config) {
    let folder = shared_memory_directory();
    match checks::shared_memory(config) {
        Ok((free, _)) => {
            let megabytes = free / 1_000_000;
            if free < COMFORTABLE_BYTES {
                let finding = format!(
                    "only {megabytes} MB free in {}: enlarge it with mount -o remount,size=256m {0}",
                    folder.display()
                );
                findings.add(Weight::Weak, "shared memory", &finding);
            } else {
                let finding = format!("{megabytes} MB free in {}", folder.display());
                findings.add(Weight::Good, "shared memory", &finding);
            }
        }
        Err(error) => findings.add(Weight::Broken, "shared memory", &format!("{error:#}")),
    }
}

fn scheduling(findings: &mut Findings) {
    let settings = SchedulingSettings { realtime: Realtime::Auto, ..Config::default().scheduling };
    match tendon_process::schedule(&settings, Stage::Acquisition) {
        Ok(scheduling) => {
            let (weight, remedy) = match scheduling.policy {
                Policy::Fifo(_) => (Weight::Good, ""),
                Policy::ShortSlice(_) => (
                    Weight::Good,
                    "; with real-time scheduling a command comes 0.3 ms earlier and waits under load are rarer: \
                     give the programs cap_sys_nice and cap_ipc_lock",
                ),
                Policy::Default => (
                    Weight::Weak,
                    "; under load messages may wait some ms: use Linux 6.12 or later, or give the programs \
                     cap_sys_nice and cap_ipc_lock",
                ),
            };
            let shortfall = &scheduling.shortfall;
            let remark = if shortfall.is_empty() { String::new() } else { format!(" ({shortfall})") };
            findings.add(weight, "scheduling", &format!("{scheduling}{remark}{remedy}"));
        }
        Err(error) => findings.add(Weight::Weak, "scheduling", &error.to_string()),
    }
}

fn leftovers(findings: &mut Findings, clean: bool) {
    let mut found = false;
    for session in Leftovers::of_all_sessions().sessions() {
        found = true;
        match SessionLock::take(&session) {
            Ok(lock) if clean => {
                let Removed { files, kept } = Leftovers::remove(&lock, &session);
                let finding = format!("session `{session}`: {files} files of a dead session removed");
                findings.add(Weight::Good, "leftovers", &finding);
                if let Some(first) = kept.first() {
                    let finding = format!(
                        "session `{session}`: {} files cannot be removed, such as {}: whose are they?",
                        kept.len(),
                        first.display()
                    );
                    findings.add(Weight::Weak, "leftovers", &finding);
                }
            }
            Ok(_) => {
                let Leftovers { files, bytes } = Leftovers::of(&session);
                let finding = format!(
                    "session `{session}` is dead but holds {} files, {} kB: `tendon doctor --clean` removes them",
                    files.len(),
                    bytes / 1000
                );
                findings.add(Weight::Weak, "leftovers", &finding);
            }
            Err(SessionLockError::InUse { holder, .. }) => {
                let finding = format!("none of session `{session}`: {holder} runs it");
                findings.add(Weight::Good, "leftovers", &finding);
            }
            Err(error) => findings.add(Weight::Weak, "leftovers", &error.to_string()),
        }
    }
    if !found {
        findings.add(Weight::Good, "leftovers", "none");
    }
}
