//! Requests to a running session, to its supervisor, from whoever shows it: all that is no order to the robot.
//!
//! ```text
//! tendon-page ──"status"──────▶ socket of the session ─▶ thread ─ the newest status, at once
//!             ──{"record":true}─────────▶               ─▶ Asked ─▶ the supervisor's loop ─▶ Answer
//! ```
//! The supervisor waits for none of it.

use std::net::Shutdown;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixDatagram;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::socket::{UnixAddr, connect};
use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_transport::{SessionName, own_user};

use crate::answer::Answer;
use crate::datagrams::{AskError, Socket, ask_by_name, send};

/// Longest request, bytes.
const LONGEST_REQUEST: usize = 4096;
/// Longest answer, bytes: a status with the report of a calibration in it.
const LONGEST_ANSWER: usize = 128 << 10;
/// How long the supervisor may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// Requests that may wait for the supervisor's loop.
const MOST_WAITING: usize = 16;

/// What a session can be asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// How things stand. The answer is the status itself.
    Status,
    /// Begin or end a recording.
    Record(bool),
    /// Let the simulated person make a gesture.
    Gesture(GestureRequest),
    /// Go over to the mode of this name.
    Mode(String),
    /// End in good order and go on with something else.
    Next(Next),
    /// What a guided calibration waits for.
    Calibration(CalibrationRequest),
}

impl Request {
    /// Its name in the text of a request.
    pub fn name(&self) -> &'static str {
        match self {
            Request::Status => "status",
            Request::Record(_) => "record",
            Request::Gesture(_) => "gesture",
            Request::Mode(_) => "mode",
            Request::Next(_) => "next",
            Request::Calibration(_) => "calibration",
        }
    }
}

/// A gesture of the simulated person.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GestureRequest {
    /// Which.
    pub gesture: Gesture,
    /// Its share of the amplitude of a full contraction, from 0 to 1.
    #[serde(default = "full_effort")]
    pub effort: f32,
}

fn full_effort() -> f32 {
    1.0
}

/// What comes after a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Next {
    /// Another session.
    Session(NextSession),
    /// The calibration of a person.
    Calibrate(NextCalibration),
    /// After a calibration, the session from which it was begun: its person, strategy and task.
    Back,
}

/// A session with the same source and settings, but for these. Names are checked by the supervisor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NextSession {
    /// Name of the person.
    pub person: Option<String>,
    /// Name of the strategy; without one, that of the person or the configuration.
    pub strategy: Option<String>,
    /// Name of the task.
    pub task: Option<String>,
}

/// A guided calibration, as the options of `tendon calibrate` describe it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NextCalibration {
    /// Name of the person.
    pub name: String,
    /// Gestures besides rest; `None` for those of the configuration.
    pub gestures: Option<Vec<Gesture>>,
    /// How often each is asked for.
    pub repetitions: Option<u32>,
    /// Whether a check round follows.
    pub check: bool,
    /// The only gesture that is asked for again.
    pub redo: Option<Gesture>,
    /// Whether the person is there and is updated.
    pub update: bool,
    /// Whether the person is there and is replaced.
    pub replace: bool,
}

/// What a guided calibration can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CalibrationRequest {
    /// Go on.
    GoOn,
    /// The last gesture once more.
    Redo,
    /// Stop, and keep what was recorded.
    Stop,
}

/// Why a request has no answer.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// There is no such session.
    #[error("session `{0}` does not run, or is ending: start it with tendon run")]
    NotRunning(SessionName),
    /// Its supervisor is there but does not answer.
    #[error("session `{0}` does not answer: look at the terminal that it was started in")]
    NoAnswer(SessionName),
    /// The answer is none.
    #[error(
        "session `{0}` gave an answer that makes no sense: are the page and the session of the same version?"
    )]
    Nonsense(SessionName),
    /// Its socket cannot be made.
    #[error(
        "cannot listen for requests at the socket @{name}: if another program holds that name, perhaps another user's, choose \
         another session name with --session"
    )]
    Listen {
        /// The socket's name in the kernel.
        name: String,
        /// The system's word.
        source: std::io::Error,
    },
    /// The socket could not be used.
    #[error("cannot use the socket for requests to session `{session}`")]
    Socket {
        /// Session name.
        session: SessionName,
        /// The system's word.
        source: std::io::Error,
    },
}

/// What the supervisor's socket is called in the kernel. It is no file, so nobody can remove it.
fn listening_name(session: &SessionName) -> String {
    format!("tendon.{}.{session}.requests", own_user())
}

/// A request that waits for its answer. If it is dropped without one, the session has come to its end, and that is said.
#[derive(Debug)]
pub struct Asked {
    /// What is asked for.
    pub request: Request,
    reply: Option<Reply>,
    _waiting: Arc<()>,
}

impl Asked {
    /// Whether somebody still waits for the answer. Whoever asked a session that hangs was told that it does not answer, and
    /// has perhaps done something else: what they asked for then is left alone.
    pub fn is_waited_for(&self) -> bool {
        self.reply.as_ref().is_some_and(Reply::is_waited_for)
    }

    /// Says what came of it.
    pub fn answer(mut self, answer: &Answer) {
        if let Some(reply) = self.reply.take() {
            reply.answer(answer);
        }
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        if let Some(reply) = self.reply.take() {
            reply.answer(&Answer::refused("the session is ending").with_key("session-ending"));
        }
    }
}

/// The way back to somebody who asked.
#[derive(Debug)]
struct Reply {
    socket: Arc<UnixDatagram>,
    to: UnixAddr,
}

impl Reply {
    fn is_waited_for(&self) -> bool {
        // Who waits has a socket, and closes it with the wait.
        UnixDatagram::unbound().is_ok_and(|probe| connect(probe.as_raw_fd(), &self.to).is_ok())
    }

    fn answer(&self, answer: &Answer) {
        // It is a flag and a text.
        if let Ok(text) = serde_json::to_string(answer) {
            self.send(&text);
        }
    }

    fn send(&self, text: &str) {
        // One that is gone, or does not read, needs no answer.
        let _ = send(&self.socket, text, &self.to);
    }
}

/// The supervisor's end. Nobody is heard any more once it is dropped.
#[derive(Debug)]
pub struct RequestSocket {
    socket: Arc<UnixDatagram>,
    status: Arc<Mutex<String>>,
    thread: Option<JoinHandle<()>>,
}

impl RequestSocket {
    /// Listens for requests to this session of this user, from them or root. `status` is the answer to [`Request::Status`];
    /// every other request goes to `on_request`.
    ///
    /// # Errors
    ///
    /// [`RequestError::Listen`] when somebody else holds the socket's name, or the system refuses.
    pub fn listen(
        session: &SessionName,
        status: String,
        on_request: impl FnMut(Asked) + Send + 'static,
    ) -> Result<RequestSocket, RequestError> {
        let name = listening_name(session);
        let failed = |source| RequestError::Listen { name: name.clone(), source };
        let socket = Socket::at(&name).map_err(failed)?;
        let replies = Arc::new(socket.socket.try_clone().map_err(failed)?);
        let status = Arc::new(Mutex::new(status));
        let hearing =
            Hearing { socket, replies: replies.clone(), status: status.clone(), waiting: Arc::new(()) };
        let thread = std::thread::Builder::new()
            .name("requests".to_owned())
            .spawn(move || hearing.hear(on_request))
            .map_err(failed)?;
        Ok(RequestSocket { socket: replies, status, thread: Some(thread) })
    }

    /// What [`Request::Status`] is answered with from now on.
    pub fn show(&self, status: String) {
        *lock(&self.status) = status;
    }
}

impl Drop for RequestSocket {
    fn drop(&mut self) {
        // The thread's wait ends with it.
        let _ = self.socket.shutdown(Shutdown::Read);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn lock(status: &Mutex<String>) -> MutexGuard<'_, String> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the listening thread has.
struct Hearing {
    socket: Socket,
    replies: Arc<UnixDatagram>,
    status: Arc<Mutex<String>>,
    /// Every request that waits has a share of it.
    waiting: Arc<()>,
}

impl Hearing {
    /// Hears requests until the socket is shut down; what is none is refused.
    fn hear(mut self, mut on_request: impl FnMut(Asked)) {
        let mut bytes = [0; LONGEST_REQUEST];
        loop {
            match self.socket.receive(&mut bytes) {
                Ok(datagram) if datagram.is_from_this_user_or_root() => {
                    let Some(to) = datagram.sender else { continue };
                    let reply = Reply { socket: self.replies.clone(), to };
                    match serde_json::from_slice(&bytes[..datagram.length]) {
                        Ok(Request::Status) => reply.send(&lock(&self.status)),
                        Ok(_) if Arc::strong_count(&self.waiting) > MOST_WAITING => {
                            let text = "too many requests wait: ask again in a moment";
                            reply.answer(&Answer::refused(text).with_key("too-many-requests"));
                        }
                        Ok(request) => {
                            let waiting = self.waiting.clone();
                            on_request(Asked { request, reply: Some(reply), _waiting: waiting });
                        }
                        Err(error) => reply.answer(&Answer::refused(format!(
                            "the session does not understand this request: {error}"
                        ))),
                    }
                }
                // From somebody else.
                Ok(_) | Err(Errno::EINTR | Errno::ENOBUFS) => {}
                // Nothing without a sender comes but the end of a socket that was shut down.
                Err(_) => return,
            }
        }
    }
}

/// Asks the supervisor of this user's session for something, and gives its answer.
///
/// # Errors
///
/// [`RequestError`].
pub fn ask_session(session: &SessionName, request: &Request) -> Result<Answer, RequestError> {
    let answer = exchange(session, request)?;
    serde_json::from_str(&answer).map_err(|_| RequestError::Nonsense(session.clone()))
}

/// How this user's session stands, as JSON.
///
/// # Errors
///
/// [`RequestError`].
pub fn session_status(session: &SessionName) -> Result<String, RequestError> {
    exchange(session, &Request::Status)
}

fn exchange(session: &SessionName, request: &Request) -> Result<String, RequestError> {
    let failed = |source| RequestError::Socket { session: session.clone(), source };
    let text = serde_json::to_string(request).map_err(|error| failed(error.into()))?;
    let answered = ask_by_name(&listening_name(session), own_user(), &text, ANSWER_TIMEOUT, LONGEST_ANSWER);
    answered.map_err(|error| match error {
        AskError::Nobody => RequestError::NotRunning(session.clone()),
        AskError::NoAnswer => RequestError::NoAnswer(session.clone()),
        AskError::Socket(source) => failed(source),
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    fn name(of: &str) -> SessionName {
        format!("requests-{of}-{}", std::process::id()).parse().unwrap()
    }

    #[test]
    fn requests_are_the_words_of_the_page() {
        let read = |text: &str| serde_json::from_str::<Request>(text).ok();
        assert_eq!(read("\"status\""), Some(Request::Status));
        assert_eq!(read(r#"{"record":true}"#), Some(Request::Record(true)));
        let grip = GestureRequest { gesture: Gesture::GRIP, effort: 0.5 };
        assert_eq!(read(r#"{"gesture":{"gesture":"grip","effort":0.5}}"#), Some(Request::Gesture(grip)));
        assert_eq!(read(r#"{"mode":"x-z"}"#), Some(Request::Mode("x-z".to_owned())));
        let anna = NextSession { person: Some("anna".to_owned()), ..NextSession::default() };
        assert_eq!(
            read(r#"{"next":{"session":{"person":"anna","strategy":null,"task":null}}}"#),
            Some(Request::Next(Next::Session(anna)))
        );
        let calibration = NextCalibration {
            name: "anna".to_owned(),
            redo: Some(Gesture::GRIP),
            check: true,
            ..NextCalibration::default()
        };
        assert_eq!(
            read(r#"{"next":{"calibrate":{"name":"anna","check":true,"redo":"grip"}}}"#),
            Some(Request::Next(Next::Calibrate(calibration)))
        );
        assert_eq!(read(r#"{"calibration":"go-on"}"#), Some(Request::Calibration(CalibrationRequest::GoOn)));
        for nonsense in [
            "",
            "{}",
            "\"stop\"",
            r#"{"record":1}"#,
            r#"{"record":true,"mode":"x-z"}"#,
            r#"{"gesture":{"gesture":"Fist!"}}"#,
            r#"{"next":{"session":{"command":"sh"}}}"#,
            r#"{"next":{"shell":{}}}"#,
            r#"{"calibration":"quit"}"#,
        ] {
            assert_eq!(read(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    fn the_status_is_the_newest_and_every_other_request_is_answered_by_the_loop() {
        let session = name("loop");
        assert!(matches!(session_status(&session), Err(RequestError::NotRunning(_))));
        let (sender, asked) = channel();
        let socket =
            RequestSocket::listen(&session, "1".to_owned(), move |one| sender.send(one).unwrap()).unwrap();
        let second = RequestSocket::listen(&session, String::new(), |_| ());
        assert!(second.unwrap_err().to_string().contains("another session name with --session"));
        assert_eq!(session_status(&session).unwrap(), "1");
        let long = "x".repeat(LONGEST_ANSWER);
        socket.show(long.clone());
        assert_eq!(session_status(&session).unwrap(), long);
        let requester = {
            let session = session.clone();
            std::thread::spawn(move || ask_session(&session, &Request::Record(true)))
        };
        let one = asked.recv().unwrap();
        assert_eq!(one.request, Request::Record(true));
        one.answer(&Answer::done("recording"));
        assert_eq!(requester.join().unwrap().unwrap(), Answer::done("recording"));
        drop(socket);
        assert!(matches!(session_status(&session), Err(RequestError::NotRunning(_))));
    }

    #[test]
    fn nobody_waits_for_a_request_that_was_not_answered_in_time() {
        let session = name("late");
        let (sender, asked) = channel();
        let _socket =
            RequestSocket::listen(&session, String::new(), move |one| sender.send(one).unwrap()).unwrap();
        let requester = {
            let session = session.clone();
            std::thread::spawn(move || ask_session(&session, &Request::Record(true)))
        };
        let one = asked.recv().unwrap();
        assert!(one.is_waited_for());
        assert!(matches!(requester.join().unwrap(), Err(RequestError::NoAnswer(_))));
        assert!(!one.is_waited_for());
    }

    #[test]
    fn a_request_that_nobody_answers_is_refused_and_so_is_one_too_many() {
        let session = name("many");
        let (sender, asked) = channel();
        let _socket =
            RequestSocket::listen(&session, String::new(), move |one| sender.send(one).unwrap()).unwrap();
        let ask = || {
            let session = session.clone();
            std::thread::spawn(move || ask_session(&session, &Request::Record(false)).unwrap())
        };
        // One after the other: the kernel keeps few datagrams for a socket.
        let ask_and_hold = || (ask(), asked.recv().unwrap());
        let (waiting, held): (Vec<_>, Vec<Asked>) =
            std::iter::repeat_with(ask_and_hold).take(MOST_WAITING).unzip();
        assert!(ask().join().unwrap().text.contains("too many"));
        drop(held);
        for one in waiting {
            let ending = Answer::refused("the session is ending").with_key("session-ending");
            assert_eq!(one.join().unwrap(), ending);
        }
    }

    #[test]
    fn what_is_no_request_is_refused_in_words() {
        let session = name("nonsense");
        let _socket = RequestSocket::listen(&session, String::new(), |_| panic!("it is none")).unwrap();
        let listening = listening_name(&session);
        for text in ["", "stop", r#"{"next":{"shell":{}}}"#, &" ".repeat(5000)] {
            let said = ask_by_name(&listening, own_user(), text, ANSWER_TIMEOUT, LONGEST_ANSWER).unwrap();
            let answer: Answer = serde_json::from_str(&said).unwrap();
            assert!(!answer.ok && answer.text.contains("does not understand"), "{answer:?}");
        }
    }
}
