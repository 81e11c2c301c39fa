//! `tendon doctor`: what this machine offers a session, and how to mend what is wrong.

use clap::Args;
use tendon_config::{Backend, Config, Realtime, SchedulingSettings, Source};
use tendon_messages::Stage;
use tendon_paths::PrivateFolder;
use tendon_process::Policy;
use tendon_transport::{
    Leftovers, Removed, SessionLock, SessionLockError, SessionName, shared_memory_directory,
};

use crate::configuration::Base;
use crate::output::{counted, print};
use crate::{Failure, checks};

/// Free shared memory that a session with default settings is comfortable with, bytes.
const COMFORTABLE_BYTES: u64 = 64_000_000;

/// Command line of `tendon doctor`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    base: Base,
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

    /// What a check says, which keeps a session from running if it fails.
    fn add_checked(&mut self, what: &str, checked: anyhow::Result<String>) {
        match checked {
            Ok(finding) => self.add(Weight::Good, what, &finding),
            Err(error) => self.add(Weight::Broken, what, &format!("{error:#}")),
        }
    }
}

/// Examines the machine.
pub fn examine(options: &Options) -> Result<(), Failure> {
    let mut findings = Findings { broken: 0, printed: Ok(()) };
    programs(&mut findings);
    let config = configuration(&mut findings, &options.base);
    folders(&mut findings, &config);
    findings.add_checked("source", checks::source(&config));
    // Without it, only sessions with an NI device do not run, which the source's finding says.
    findings.add(Weight::Good, "NI-DAQmx", &checks::nidaqmx(&config.acquisition.nidaqmx));
    findings.add_checked("model and runtime", checks::models(&config));
    lsl(&mut findings, &config);
    shared_memory(&mut findings, &config);
    scheduling(&mut findings, &config);
    leftovers(&mut findings, options.clean);
    findings.printed.map_err(Failure::running)?;
    if findings.broken > 0 {
        return Err(Failure::running(anyhow::anyhow!(
            "{} a session from running",
            counted(findings.broken, "finding keeps", "findings keep")
        )));
    }
    Ok(())
}

fn programs(findings: &mut Findings) {
    let checked = checks::programs().map(|folder| format!("all stages are in {}", folder.display()));
    findings.add_checked("programs", checked);
}

/// The configuration that `tendon run` would read here; the default if it is broken.
fn configuration(findings: &mut Findings, base: &Base) -> Config {
    match base.configuration() {
        Ok(config) => {
            let finding = format!("good, for session `{}`", config.session);
            findings.add(Weight::Good, "configuration", &finding);
            config
        }
        Err(error) => {
            let finding = format!("{error:#} (all below is checked with the defaults)");
            findings.add(Weight::Broken, "configuration", &finding);
            Config::default()
        }
    }
}

/// The folders that a session needs: with a real arm, also those of how arms were left.
fn folders(findings: &mut Findings, config: &Config) {
    let private = |folder: PrivateFolder| folder.path().to_owned();
    let mut folders = vec![
        ("run-time folder", tendon_paths::runtime_folder().map(private)),
        ("state folder", tendon_paths::state_folder().map(private)),
    ];
    if config.robot.backend == Backend::XArm {
        folders.push(("records of arms", tendon_paths::arm_record_folder().map(private)));
        let shared = tendon_paths::shared_arm_folder().map(|folder| folder.path().to_owned());
        folders.push(("notes on arms", shared));
    }
    for (what, folder) in folders {
        findings.add_checked(what, folder.map(|path| path.display().to_string()).map_err(Into::into));
    }
}

/// Whether the Lab Streaming Layer could be used, where the session does not: that is said as its source.
fn lsl(findings: &mut Findings, config: &Config) {
    if config.acquisition.source == Source::Lsl {
        return;
    }
    match checks::lsl(&config.acquisition.lsl) {
        Ok(finding) => findings.add(Weight::Good, "LSL", &finding),
        Err(error) if config.outlets.lsl => findings.add(Weight::Broken, "LSL", &format!("{error:#}")),
        Err(error) => findings.add(Weight::Good, "LSL", &format!("not used here; {error:#}")),
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

fn scheduling(findings: &mut Findings, config: &Config) {
    // Where it is not demanded, what the machine would grant.
    let is_demanded = config.scheduling.realtime == Realtime::On;
    let realtime = if is_demanded { Realtime::On } else { Realtime::Auto };
    let settings = SchedulingSettings { realtime, ..config.scheduling.clone() };
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
        Err(error) => findings.add(Weight::Broken, "scheduling", &error.to_string()),
    }
}

/// What sessions left that nobody runs any more.
fn leftovers(findings: &mut Findings, clean: bool) {
    let mut found = false;
    for session in Leftovers::of_all_sessions().sessions() {
        let lock = match SessionLock::take(&session) {
            Ok(lock) => lock,
            // It runs: these are its own.
            Err(SessionLockError::InUse { .. }) => continue,
            Err(error) => {
                found = true;
                findings.add(Weight::Weak, "leftovers", &error.to_string());
                continue;
            }
        };
        // One that ended meanwhile took its files along.
        let left = Leftovers::beside(&lock);
        if left.files.is_empty() {
            continue;
        }
        found = true;
        if clean {
            remove(findings, &lock, &session);
        } else {
            let finding = format!(
                "session `{session}` is dead but holds {}, {} kB: `tendon doctor --clean` removes them",
                counted(left.files.len(), "file", "files"),
                left.bytes / 1000
            );
            findings.add(Weight::Weak, "leftovers", &finding);
        }
    }
    if !found {
        findings.add(Weight::Good, "leftovers", "none");
    }
}

fn remove(findings: &mut Findings, lock: &SessionLock, session: &SessionName) {
    let Removed { files, kept } = Leftovers::remove(lock);
    let finding =
        format!("session `{session}`: {} of a dead session removed", counted(files, "file", "files"));
    findings.add(Weight::Good, "leftovers", &finding);
    if let Some(first) = kept.first() {
        let finding = format!(
            "session `{session}`: {} cannot be removed, such as {}: whose are they?",
            counted(kept.len(), "file", "files"),
            first.display()
        );
        findings.add(Weight::Weak, "leftovers", &finding);
    }
}
