//! What can be asked of a session while it runs, and how it stands for whoever shows it.
//!
//! ```text
//! page ─▶ RequestSocket ─▶ Event::Request ─▶ Watch ─▶ SessionDesk::turn ─▶ record, gesture, … ─▶ Answer
//!      ◀───────── Desk, the newest ◀──────────────────────────┘
//! ```

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};

use serde::Serialize;
use serde_json::json;
use tendon_config::{Config, Gestures, Source};
use tendon_gesture::{GestureSet, Strategy};
use tendon_messages::Stage;
use tendon_people::{People, PersonName};
use tendon_process::{Answer, Asked, GestureRequest, Next, Order, Request, RequestError, RequestSocket};
use tendon_session::{Event, Watch};
use tendon_session_file::is_session_file;
use tendon_transport::SessionName;
use tendon_zones::{TaskRun, TaskStatus};

use crate::calibrate::CalibrationStatus;
use crate::next::{self, Handover};
use crate::options::Options;
use crate::page::Page;

/// The most names of people that are told: more fit into no message.
const MOST_PEOPLE: usize = 500;

/// How a session or a calibration stands, as the page shows it. The JSON keys are a contract with the page.
#[derive(Clone, Debug, Serialize)]
pub struct Desk {
    /// What can be asked for.
    pub can: Can,
    /// Which of the two it is.
    pub kind: DeskKind,
    /// The file that it is being recorded to.
    pub recording: Option<PathBuf>,
    /// Why the last recording broke off or could not begin, if it did.
    pub recording_failure: Option<String>,
    /// Whose session it is.
    pub person: Option<String>,
    /// Name of the strategy.
    pub strategy: &'static str,
    /// What recognises gestures, as inference tells: files with commas between them. `None` before the session runs.
    pub model: Option<String>,
    /// Who has been calibrated.
    pub people: Vec<PersonName>,
    /// Names of the strategies there are.
    pub strategies: Vec<&'static str>,
    /// The task of the session, if it has one.
    pub task: Option<TaskStatus>,
    /// How the calibration stands, if it is one.
    pub calibration: Option<CalibrationStatus>,
    /// Why what was asked for could not begin.
    pub failed: Option<String>,
}

/// What can be asked for.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Can {
    /// Recordings.
    pub record: bool,
    /// Gestures of the simulated person.
    pub gestures: bool,
    /// Another mode.
    pub mode: bool,
    /// Another session or a calibration.
    pub next: bool,
}

/// What the page shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeskKind {
    /// A session of all stages.
    Session,
    /// A guided calibration.
    Calibration,
    /// A session that could not begin.
    Failed,
}

impl Desk {
    /// Of what has this configuration; nothing can be asked for.
    pub fn new(kind: DeskKind, config: &Config) -> Desk {
        let person = config.inference.person.as_deref().filter(|_| is_personal(config));
        let mut desk = Desk {
            can: Can::default(),
            kind,
            recording: None,
            recording_failure: None,
            person: person.and_then(person_of),
            strategy: config.decision.strategy.name(),
            model: None,
            strategies: Vec::new(),
            people: Vec::new(),
            task: None,
            calibration: None,
            failed: None,
        };
        desk.look_for_people();
        desk
    }

    /// Tells who has been calibrated by now.
    pub fn look_for_people(&mut self) {
        self.people = People::open().and_then(|people| people.names()).unwrap_or_default();
        self.people.truncate(MOST_PEOPLE);
        let personal = (!self.people.is_empty()).then_some(Strategy::Personal);
        self.strategies = Strategy::ALL.into_iter().chain(personal).map(Strategy::name).collect();
    }

    /// As the page reads it.
    pub fn text(&self) -> String {
        json!({ "desk": self }).to_string()
    }
}

fn is_personal(config: &Config) -> bool {
    config.decision.strategy == Strategy::Personal
}

/// The name of the person in a file of `People`, which is called people/NAME/person.toml; of another file its own name.
fn person_of(file: &std::path::Path) -> Option<String> {
    let folder = file.parent().and_then(std::path::Path::file_name);
    let name = if file.file_name()? == "person.toml" { folder? } else { file.file_stem()? };
    Some(name.to_string_lossy().into_owned())
}

/// The desk of a running session.
#[derive(Debug)]
pub struct SessionDesk {
    desk: Desk,
    gestures: GestureSet,
    /// Names of the modes.
    modes: Vec<String>,
    /// Whether the modes are those of a session that is replayed.
    repeats_modes: bool,
    socket: RequestSocket,
    /// The recording, what became of the last and the task, as they are shown; `None` before the session runs.
    shown: Option<(Option<PathBuf>, Option<String>, Option<TaskStatus>)>,
    session: SessionName,
    /// The session's command line.
    run: Vec<String>,
    strategy: Strategy,
    /// Why nothing can follow on the session, if nothing can.
    why_not_next: Option<String>,
    /// What was found to be in order in threads that check it.
    checked: Receiver<Checked>,
    checking: Sender<Checked>,
    /// The command line that follows on the session.
    next: Option<Vec<String>>,
}

/// What may follow on the session, and who asked for it.
#[derive(Debug)]
struct Checked {
    asked: Asked,
    command_line: Vec<String>,
}

impl SessionDesk {
    /// Listens to requests, which come as `events`.
    ///
    /// # Errors
    ///
    /// [`RequestError`] when the socket cannot be had.
    pub fn open(
        config: &Config,
        options: &Options,
        has_simulated_user: bool,
        events: &Sender<Event>,
    ) -> Result<SessionDesk, RequestError> {
        let own = next::own_command_line();
        let unreadable = own.as_ref().err().map(ToString::to_string);
        let why_not_next = next::why_not(options, config).map(str::to_owned).or(unreadable);
        let acquisition = &config.acquisition;
        let follows_keys = acquisition.source == Source::Simulate
            && acquisition.simulate.gestures == Gestures::Keyboard
            && !has_simulated_user;
        let modes: Vec<String> = config.decision.modes.iter().map(|mode| mode.name.clone()).collect();
        let repeats_modes = acquisition
            .replay
            .path
            .as_deref()
            .filter(|_| acquisition.source == Source::Replay)
            .is_some_and(is_session_file);
        let mut desk = Desk::new(DeskKind::Session, config);
        let starting = desk.text();
        desk.can = Can {
            record: true,
            gestures: follows_keys,
            mode: modes.len() > 1 && !repeats_modes,
            next: why_not_next.is_none(),
        };
        let events = events.clone();
        let on_request = move |asked: Asked| {
            // Once nobody listens any more the request is dropped, which says so.
            let _ = events.send(Event::Request(asked));
        };
        let socket = RequestSocket::listen(&config.session, starting, on_request)?;
        let (checking, checked) = channel();
        Ok(SessionDesk {
            desk,
            gestures: config.decision.gestures.clone(),
            modes,
            repeats_modes,
            socket,
            shown: None,
            session: config.session.clone(),
            run: own.unwrap_or_default(),
            strategy: config.decision.strategy,
            why_not_next,
            checked,
            checking,
            next: None,
        })
    }

    /// Answers what has been asked, and shows how the session stands now.
    pub fn turn(&mut self, watch: &mut Watch<'_>, task: Option<&TaskRun>) {
        while let Some(asked) = watch.take_request() {
            match asked.request.clone() {
                Request::Next(next) => self.check(asked, next),
                request => {
                    let answer = self.answer(&request, watch);
                    asked.answer(&answer);
                }
            }
        }
        while let Ok(Checked { asked, command_line }) = self.checked.try_recv() {
            if self.next.is_none() && asked.is_waited_for() {
                self.next = Some(command_line);
                asked.answer(&Answer::done("this session ends, and what was asked for begins"));
            }
        }
        let recording = watch.recording().map(PathBuf::from);
        let now = (recording, watch.recording_failure().map(str::to_owned), task.map(TaskRun::status));
        if self.shown.is_none() {
            self.desk.model = watch.ready().get(&Stage::Inference).map(|ready| ready.detail.clone());
        }
        if self.shown.as_ref() != Some(&now) {
            (self.desk.recording, self.desk.recording_failure, self.desk.task) = now.clone();
            self.shown = Some(now);
            self.socket.show(self.desk.text());
        }
    }

    fn answer(&self, request: &Request, watch: &mut Watch<'_>) -> Answer {
        match request {
            Request::Record(is_wanted) => watch.record(*is_wanted),
            Request::Gesture(gesture) => self.make(*gesture, watch),
            Request::Mode(name) => self.take_mode(name, watch),
            Request::Calibration(_) => Answer::refused("this is a session, and no calibration"),
            Request::Next(_) | Request::Status => unreachable!("they are seen to before"),
        }
    }

    /// Checks what is to follow, in a thread: it reads files, and the arm must not wait for that.
    fn check(&self, asked: Asked, next: Next) {
        if let Some(why_not) = &self.why_not_next {
            return asked.answer(&Answer::refused(why_not.clone()));
        }
        if next == Next::Back {
            return asked
                .answer(&Answer::refused("this is a session already: only a calibration leads back to one"));
        }
        let (run, strategy, checking) = (self.run.clone(), self.strategy, self.checking.clone());
        let check = move || match next::command_line_after(&run, strategy, &next) {
            // Nobody listens any more once the session is over; the request says so itself.
            Ok(command_line) => drop(checking.send(Checked { asked, command_line })),
            Err(error) => asked.answer(&next::refusal(&error)),
        };
        // Without the thread the request is dropped, and refused by that.
        let _ = std::thread::Builder::new().name("check next".to_owned()).spawn(check);
    }

    /// The command line of what follows, if somebody has asked for it.
    pub fn take_next(&mut self) -> Option<Vec<String>> {
        self.next.take()
    }

    /// What this session hands on.
    pub fn handover(&self, page: Option<&Page>) -> Handover {
        Handover {
            page: page.and_then(Page::keys).cloned(),
            run: self.run.clone(),
            session: self.session.clone(),
            is_recorded: self.desk.recording.is_some(),
            socket: page.map(|page| page.socket().clone()),
        }
    }

    /// Lets decision take the mode of this name.
    fn take_mode(&self, name: &str, watch: &mut Watch<'_>) -> Answer {
        if self.repeats_modes {
            return Answer::refused("this session replays another one, and repeats its modes");
        }
        let place = self.modes.iter().position(|mode| mode == name);
        let Some(place) = place.and_then(|place| u8::try_from(place).ok()) else {
            let text = format!("there is no mode `{name}`: this session has {}", self.modes.join(", "));
            return Answer::refused(text);
        };
        watch.order(Stage::Decision, Order::Mode(place));
        Answer::done(name)
    }

    /// Lets the simulated person make a gesture.
    fn make(&self, request: GestureRequest, watch: &mut Watch<'_>) -> Answer {
        let GestureRequest { gesture, effort } = request;
        if !self.desk.can.gestures {
            return Answer::refused(
                "nobody makes gestures by request in this session: start one with --keyboard",
            );
        }
        if self.gestures.number(gesture).is_none() {
            let known: Vec<String> = self.gestures.iter().map(|known| known.to_string()).collect();
            return Answer::refused(format!(
                "{gesture} is no gesture of this session: it has {}",
                known.join(", ")
            ));
        }
        if !(0.0..=1.0).contains(&effort) {
            return Answer::refused(format!("an effort of {effort}: give one from 0 to 1"));
        }
        watch.order(Stage::Acquisition, Order::Gesture { gesture, effort });
        Answer::done(gesture.to_string())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    #[test]
    fn a_desk_names_the_person_of_a_session_and_nothing_can_be_asked_before_it_runs() {
        let mut config = Config::default();
        config.inference.person = Some("/home/me/people/anna/person.toml".into());
        let desk = |config: &Config| -> Value {
            serde_json::from_str(&Desk::new(DeskKind::Session, config).text()).unwrap()
        };
        assert_eq!(desk(&config)["desk"]["person"], Value::Null, "the strategy is not theirs");
        config.decision.strategy = Strategy::Personal;
        let said = &desk(&config)["desk"];
        assert_eq!((&said["person"], &said["strategy"]), (&json!("anna"), &json!("personal")));
        assert_eq!((&said["kind"], &said["can"]["record"]), (&json!("session"), &json!(false)));
        config.inference.person = Some("/data/bert.toml".into());
        assert_eq!(desk(&config)["desk"]["person"], "bert");
    }
}
