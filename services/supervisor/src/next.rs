//! What comes after a session, where somebody at its page has asked for it: this program again, with other options.
//!
//! ```text
//! page ─ next ─▶ session_after ─ checked as if it were typed ─▶ the session ends and reports ─▶ Following::start ─▶ tendon run …
//!                    └── refused, in words: the session goes on                                   at the same page
//! ```

use std::net::TcpListener;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::{Arc, OnceLock};

use anyhow::{Context, anyhow, bail, ensure};
use clap::Parser;
use listenfd::ListenFd;
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use serde::{Deserialize, Serialize};
use tendon_config::{Config, Source};
use tendon_gesture::Strategy;
use tendon_people::{PeopleError, PersonName};
use tendon_process::{Answer, Next, NextCalibration, NextSession, PAGE_VARIABLE, PageKeys, socket_variables};
use tendon_transport::SessionName;

use crate::options::Options;
use crate::{Arguments, Failure, calibrate, provenance, zones};

/// Options of `tendon run` that the next session may have others of.
const PERSON: &str = "--person";
const STRATEGY: &str = "--strategy";
const TASK: &str = "--task";
/// Options that belong to the strategy for which they were given.
const MODELS: [&str; 2] = ["--model", "--rest-move-model"];

/// What a session hands on to what comes after it, in the environment.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Handover {
    /// The page, which is to be found again, if it was there.
    pub page: Option<PageKeys>,
    /// The command line of the session, to which a calibration leads back.
    pub run: Vec<String>,
    /// Whether it was being recorded; then the next session is, too.
    pub is_recorded: bool,
    /// The session's name.
    pub session: SessionName,
    /// Where the page listens. It stays open from one to the next, so that no other program can take its place, to which a
    /// browser would show its token.
    #[serde(skip)]
    pub socket: Option<Arc<TcpListener>>,
}

impl Handover {
    /// What the session before handed on, if this is not the first.
    ///
    /// # Errors
    ///
    /// When it makes no sense.
    pub fn received() -> anyhow::Result<Option<Handover>> {
        static SOCKET: OnceLock<Option<Arc<TcpListener>>> = OnceLock::new();
        let Ok(text) = std::env::var(PAGE_VARIABLE) else { return Ok(None) };
        let handover: Handover = serde_json::from_str(&text)
            .with_context(|| format!("{PAGE_VARIABLE} is set to what no session wrote: unset it"))?;
        // It can be taken out of the environment once only.
        let socket =
            SOCKET.get_or_init(|| ListenFd::from_env().take_tcp_listener(0).ok().flatten().map(Arc::new));
        Ok(Some(Handover { socket: socket.clone(), ..handover }))
    }
}

/// The command line of this program.
///
/// # Errors
///
/// When it holds what is no text.
pub fn own_command_line() -> anyhow::Result<Vec<String>> {
    let words = std::env::args_os().map(std::ffi::OsString::into_string);
    words.collect::<Result<_, _>>().map_err(|_| anyhow!("the session's command line is not UTF-8 text"))
}

/// What this program becomes once the session has ended.
#[derive(Clone, Debug)]
pub struct Following {
    /// Its command line, the program's name first.
    pub command_line: Vec<String>,
    /// What is handed on to it.
    pub handover: Handover,
}

impl Following {
    /// Goes on as that. It returns only if it cannot.
    pub fn start(self) -> Failure {
        let failed =
            |error: anyhow::Error| Failure::running(error.context("cannot go on with what was asked for"));
        let program = match std::env::current_exe() {
            Ok(program) => program,
            Err(error) => return failed(error.into()),
        };
        let mut command = Command::new(program);
        command.args(self.command_line.iter().skip(1));
        match serde_json::to_string(&self.handover) {
            Ok(handover) => command.env(PAGE_VARIABLE, handover),
            Err(error) => return failed(error.into()),
        };
        if let Some(socket) = &self.handover.socket {
            // It is closed at the start of any other program.
            if let Err(error) = fcntl(socket, FcntlArg::F_SETFD(FdFlag::empty())) {
                return failed(error.into());
            }
            command.envs(socket_variables(socket.as_raw_fd()));
        }
        failed(command.exec().into())
    }
}

/// Why nothing can follow on a session with these options; `None` if something can.
pub fn why_not(options: &Options, config: &Config) -> Option<&'static str> {
    if !options.page.page {
        return Some("this session was started without --page: end it, and start the next by hand");
    }
    if options.json.is_some() || options.latency_log.is_some() || options.figures.is_some() {
        return Some(
            "this session writes --json, --latency-log or --figures, which the next would replace: end it with q",
        );
    }
    if options.duration.is_some() {
        return Some("this session ends by itself after --duration: wait for that");
    }
    if config.acquisition.source == Source::Replay {
        return Some("this session replays a recording: end it, and start the next by hand");
    }
    None
}

/// The answer to somebody who asked for what cannot follow.
pub fn refusal(error: &anyhow::Error) -> Answer {
    let refused = Answer::refused(format!("{error:#}"));
    let (key, name) = match error.downcast_ref() {
        Some(PeopleError::Unknown { name, .. }) => ("person-unknown", name),
        Some(PeopleError::Exists { name, .. }) => ("person-exists", name),
        Some(PeopleError::Busy { name }) => ("person-busy", name),
        _ => return refused,
    };
    refused.with_key(key).with_value("name", name)
}

/// The strategy of the session of `run`; `None` where it could not begin any more, such as that of a person who is gone.
pub fn strategy_of(run: &[String]) -> Option<Strategy> {
    let Ok(crate::Command::Run(options)) = read(run) else { return None };
    options.configuration().ok().map(|(config, _)| config.decision.strategy)
}

/// The command line of what is to follow on the session of `run`, whose strategy is `strategy`.
///
/// # Errors
///
/// When it would be refused if it were typed; in words.
pub fn command_line_after(run: &[String], strategy: Strategy, next: &Next) -> anyhow::Result<Vec<String>> {
    match next {
        Next::Session(next) => session_after(run, strategy, next),
        Next::Calibrate(wanted) => calibration_after(run, wanted),
        Next::Back => session_again(run),
    }
}

/// The command line of a session as the one of `run`, whose strategy is `strategy`, but as `next` asks for.
///
/// # Errors
///
/// When it would be refused if it were typed; in words.
pub fn session_after(run: &[String], strategy: Strategy, next: &NextSession) -> anyhow::Result<Vec<String>> {
    let command_line = changed(run, strategy, next)?;
    check(&command_line)?;
    Ok(command_line)
}

/// The command line of a session as the one of `run`.
///
/// # Errors
///
/// When it would be refused if it were typed; in words.
pub fn session_again(run: &[String]) -> anyhow::Result<Vec<String>> {
    check(run)?;
    Ok(run.to_vec())
}

/// The same, without a look at what the options mean.
fn changed(run: &[String], strategy: Strategy, next: &NextSession) -> anyhow::Result<Vec<String>> {
    let mut command_line = without(run, &[PERSON, TASK]);
    if let Some(person) = &next.person {
        let person: PersonName = person.parse()?;
        ensure!(
            next.strategy.as_deref().is_none_or(|strategy| strategy == Strategy::Personal.name()),
            "a session with a person has the strategy personal: leave the person out, or take that"
        );
        command_line = without(&command_line, &[STRATEGY, MODELS[0], MODELS[1]]);
        command_line.push(format!("{PERSON}={person}"));
    } else if let Some(wanted) = &next.strategy {
        if wanted != strategy.name() {
            command_line = without(&command_line, &MODELS);
        }
        command_line = without(&command_line, &[STRATEGY]);
        command_line.push(format!("{STRATEGY}={wanted}"));
    }
    command_line.extend(next.task.iter().map(|task| format!("{TASK}={task}")));
    Ok(command_line)
}

/// The command line of a calibration with the source and settings of the session of `run`.
///
/// # Errors
///
/// When it would be refused if it were typed; in words.
fn calibration_after(run: &[String], wanted: &NextCalibration) -> anyhow::Result<Vec<String>> {
    let crate::Command::Run(options) = read(run)? else { bail!("a calibration follows on a session only") };
    let (config, _folder) = options.configuration()?;
    calibrate::command_line(wanted, (&options.base, &config), &options.page, &[])
}

/// Reads a command line.
///
/// # Errors
///
/// What is wrong with it, in words.
pub fn read(command_line: &[String]) -> anyhow::Result<crate::Command> {
    let read = Arguments::try_parse_from(command_line).map_err(|error| {
        let text = error.to_string();
        let first = text.lines().next().unwrap_or_default();
        anyhow!("{}", first.trim_start_matches("error: ").to_owned())
    })?;
    Ok(read.command)
}

/// Checks a session as far as it can be without beginning it.
fn check(command_line: &[String]) -> anyhow::Result<()> {
    let crate::Command::Run(options) = read(command_line)? else { bail!("tendon run is what follows") };
    let (config, _folder) = options.configuration()?;
    // It looks at the models and the person.
    provenance::of_session(&config)?;
    let has_simulated_user = options.has_simulated_user(config.acquisition.source);
    options.task.map(|kind| zones::task(kind, &config, has_simulated_user)).transpose()?;
    Ok(())
}

/// A command line without these options, each of which has a value.
pub fn without(command_line: &[String], options: &[&str]) -> Vec<String> {
    let mut kept = Vec::new();
    let mut words = command_line.iter();
    while let Some(word) = words.next() {
        if options.contains(&word.as_str()) {
            // Its value.
            words.next();
        } else if !options.iter().any(|option| is_with_value(word, option)) {
            kept.push(word.clone());
        }
    }
    kept
}

fn is_with_value(word: &str, option: &str) -> bool {
    word.strip_prefix(option).is_some_and(|rest| rest.starts_with('='))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<String> {
        line.split_whitespace().map(str::to_owned).collect()
    }

    fn after(run: &str, strategy: Strategy, next: &NextSession) -> String {
        changed(&words(run), strategy, next).unwrap().join(" ")
    }

    fn refused(run: &str, next: &NextSession) -> String {
        format!("{:#}", session_after(&words(run), Strategy::Direct, next).unwrap_err())
    }

    #[test]
    fn another_strategy_and_task_take_the_place_of_those_there_were() {
        let next = |strategy: Option<&str>, task: Option<&str>| NextSession {
            person: None,
            strategy: strategy.map(str::to_owned),
            task: task.map(str::to_owned),
        };
        let run = "tendon run --page --task zones --set session=a --strategy=direct --model x.onnx --seed 3";
        assert_eq!(
            after(run, Strategy::Direct, &next(Some("threshold"), None)),
            "tendon run --page --set session=a --seed 3 --strategy=threshold"
        );
        // A model stays with its strategy.
        assert_eq!(
            after(run, Strategy::Direct, &next(Some("direct"), Some("paper-zones"))),
            "tendon run --page --set session=a --model x.onnx --seed 3 --strategy=direct --task=paper-zones"
        );
        assert_eq!(
            after(run, Strategy::Direct, &next(None, None)),
            "tendon run --page --set session=a --strategy=direct --model x.onnx --seed 3"
        );
        for (strategy, task, why) in [
            (Some("magic"), None, "magic"),
            (Some("--json=/tmp/x"), None, "--json"),
            (None, Some("nothing"), "nothing"),
            (Some("personal"), None, "person"),
        ] {
            let refused = refused(run, &next(strategy, task));
            assert!(refused.contains(why), "{refused}");
        }
    }

    #[test]
    fn a_person_is_a_name_and_no_path_and_has_a_strategy_of_their_own() {
        let next = |person: &str, strategy: Option<&str>| NextSession {
            person: Some(person.to_owned()),
            strategy: strategy.map(str::to_owned),
            task: None,
        };
        let run = "tendon run --page";
        assert_eq!(
            after("tendon run --page --strategy direct --model x", Strategy::Direct, &next("anna", None)),
            "tendon run --page --person=anna"
        );
        for path in ["../x", "/etc/passwd", "", "--json=x", "anna.toml"] {
            assert!(refused(run, &next(path, None)).contains("a-z 0-9"), "{path}");
        }
        assert!(refused(run, &next("nobody-of-that-name", None)).contains("nobody-of-that-name"));
        assert!(refused(run, &next("anna", Some("direct"))).contains("personal"));
        let unknown = session_after(&words(run), Strategy::Direct, &next("nobody", None)).unwrap_err();
        let said = refusal(&unknown);
        assert_eq!((said.key.as_deref(), said.values["name"].as_str()), (Some("person-unknown"), "nobody"));
    }
}
