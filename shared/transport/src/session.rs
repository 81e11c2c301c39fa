//! Sessions: names that keep two runs on one machine apart, and what a run leaves behind.

use core::fmt::{self, Debug, Display};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::prelude::{
    CallbackProgression, Node, NodeBuilder, NodeName, NodeState, SemanticString, ServiceName,
    SignalHandlingMode, ipc,
};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::publish_subscribe;
use serde::{Deserialize, Serialize};
use tendon_messages::{Topic, Traced};
use tendon_paths::{
    Claim, ClaimError, Holder, PathError, PrivateFolder, claimed_names, runtime_folder, runtime_folders,
    user_name,
};

use crate::clock::now_ns;
use crate::publisher::Element;

/// Subscribers a topic can have: the next stage and observers (supervisor, `tendon latency`, recorders).
pub(crate) const MAXIMUM_SUBSCRIBERS: usize = 8;
/// Messages a subscriber may hold at a time: it looks at one, and drops it before the next.
const MAXIMUM_BORROWED: usize = 2;
/// Publishers a topic can have: every stage on `measurements`, and restarted ones beside the dead.
const MAXIMUM_PUBLISHERS: usize = 8;
/// Processes that can take part in a topic.
const MAXIMUM_NODES: usize = 24;
/// A segment of shared memory that is empty for so long has lost its maker.
const LONGEST_EMPTY: Duration = Duration::from_secs(1);
/// Longest path of a Unix socket: unix(7).
const MAXIMUM_SOCKET_PATH: usize = 107;
/// What iceoryx2 adds to folder and prefix for an event's socket: a slash, a port of 39 digits and `.event`.
const SOCKET_NAME_LENGTH: usize = 46;
/// Longest session name: with it, the paths of iceoryx2's Unix sockets stay below the kernel's 108 bytes.
const MAXIMUM_NAME_LENGTH: usize = 24;

/// The name of a session: 1 to 24 of `a-z`, `0-9`, `-` and `_`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SessionName(String);

/// A session name that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "session name `{0}` is not usable: take 1 to {MAXIMUM_NAME_LENGTH} of the characters a-z, 0-9, `-` and `_`"
)]
pub struct InvalidSessionName(String);

impl TryFrom<String> for SessionName {
    type Error = InvalidSessionName;

    fn try_from(name: String) -> Result<SessionName, InvalidSessionName> {
        let allowed = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"-_".contains(&byte);
        if (1..=MAXIMUM_NAME_LENGTH).contains(&name.len()) && name.bytes().all(allowed) {
            Ok(SessionName(name))
        } else {
            Err(InvalidSessionName(name))
        }
    }
}

impl FromStr for SessionName {
    type Err = InvalidSessionName;

    fn from_str(name: &str) -> Result<SessionName, InvalidSessionName> {
        SessionName::try_from(name.to_owned())
    }
}

impl From<SessionName> for String {
    fn from(name: SessionName) -> String {
        name.0
    }
}

impl Display for SessionName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl SessionName {
    /// What the names of this user's shared-memory files for this session start with. The dots cannot be part of a
    /// session name, so no prefix is the start of another.
    fn prefix(&self) -> String {
        format!("{}.", self.claim_of(own_user()))
    }

    /// The name in the kernel that the supervisor of this session holds, if `user` runs it.
    fn claim_of(&self, user: u32) -> String {
        format!("tendon.{user}.{}", self.0)
    }

    /// Who runs the session of this name for `user`; `None` if nobody does. Somebody else cannot pass for `user`.
    pub fn supervisor(&self, user: u32) -> Option<Holder> {
        Holder::of(&self.claim_of(user)).filter(|holder| holder.user == user)
    }

    /// A file of this session with the ending `ending`, in shared memory. It goes with the session's other
    /// leftovers.
    pub(crate) fn shared_memory_file(&self, ending: &str) -> PathBuf {
        shared_memory_directory().join(format!("{}{ending}", self.prefix()))
    }

    /// Name of the file in the run-time folder in which a supervisor keeps the configuration of a run.
    fn configuration_file(&self, run: &Run) -> String {
        format!("{}configuration.{}", self.prefix(), run.began_ns)
    }

    /// iceoryx2's configuration for this session, whose run-time state lies in `folder`.
    fn config(&self, folder: &Path) -> Config {
        let mut config = Config::default();
        config.global.set_root_path(
            &iceoryx2::prelude::Path::new(folder.as_os_str().as_encoded_bytes())
                .expect("a run-time folder is short and was opened before"),
        );
        config.global.prefix = iceoryx2::prelude::FileName::new(self.prefix().as_bytes())
            .expect("a session name has only characters that file names may have");
        // Dead processes are cleaned up by the supervisor, which knows when; a stage that starts must not
        // spend time on it.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config
    }
}

/// One run of a session, as its supervisor says on the card of its claim. The next session of this name is another run.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Run {
    /// When the supervisor took the session, ns of the monotonic clock.
    began_ns: u64,
    /// Where the run-time state of the session lies.
    folder: PathBuf,
}

impl Run {
    fn to_card(&self) -> String {
        format!("{} {}", self.began_ns, self.folder.display())
    }

    /// `None` for a card that is empty, since its supervisor hangs, or of another version.
    fn on_card(card: &str) -> Option<Run> {
        let (began_ns, folder) = card.split_once(' ')?;
        Some(Run { began_ns: began_ns.parse().ok()?, folder: folder.into() })
    }
}

/// The user that this process acts for.
pub fn own_user() -> u32 {
    nix::unistd::geteuid().as_raw()
}

/// Sessions that run now: user and name.
pub fn running_sessions() -> Vec<(u32, SessionName)> {
    let parse = |claim: String| -> Option<(u32, SessionName)> {
        let (user, name) = claim.strip_prefix("tendon.")?.split_once('.')?;
        let (user, name) = (user.parse().ok()?, name.parse::<SessionName>().ok()?);
        name.supervisor(user).map(|_| (user, name))
    };
    claimed_names("tendon.").into_iter().filter_map(parse).collect()
}

/// Where the kernel keeps POSIX shared memory.
pub fn shared_memory_directory() -> &'static Path {
    Path::new("/dev/shm")
}

/// What happens when a subscriber is behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Delivery {
    /// The oldest message makes way for the newest; the publisher never waits.
    Live,
    /// The publisher waits; nothing is lost.
    Lossless,
}

/// Why a session, or one of its topics, could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The node could not be created.
    #[error(
        "session `{session}`: cannot join: {reason}; `tendon doctor` shows what is wrong with this machine"
    )]
    Join {
        /// Session name.
        session: SessionName,
        /// iceoryx2's own word.
        reason: String,
    },
    /// The supervisor hangs.
    #[error(
        "session `{session}`: its supervisor, process {process_id}, does not answer: let it go on (kill -CONT {process_id}), or \
         end it"
    )]
    Silent {
        /// Session name.
        session: SessionName,
        /// The supervisor.
        process_id: i32,
    },
    /// A topic could not be opened.
    #[error(
        "session `{session}`, topic `{topic}`: cannot open: {reason}; is shared memory (/dev/shm) full, or is \
         a process of another version in this session? `tendon doctor` tells"
    )]
    Open {
        /// Session name.
        session: SessionName,
        /// Topic name.
        topic: &'static str,
        /// iceoryx2's own word.
        reason: String,
    },
    /// The folder of run-time state cannot be used.
    #[error(transparent)]
    Folder(#[from] PathError),
    /// The paths of this session's sockets would be longer than the kernel takes.
    #[error("session name `{0}` is too long for a user with so long a number: take 18 characters at most")]
    NameTooLong(SessionName),
    /// What wakes the subscribers of a topic could not be used.
    #[error("topic `{topic}`: cannot use {}; remove it, or give it to this user", path.display())]
    Wake {
        /// Topic name.
        topic: &'static str,
        /// The file in shared memory.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// All subscribers that a topic can have are there.
    #[error("topic `{topic}`: it has all of its {MAXIMUM_SUBSCRIBERS} subscribers: close an observer")]
    NoSeat {
        /// Topic name.
        topic: &'static str,
    },
}

/// The most shared memory that the payloads of one publisher of `topic` can take up, in bytes, for messages
/// of up to `maximum_length` elements: every subscriber may hold back its whole buffer.
pub fn required_bytes<H: Traced, E: Element>(topic: &Topic<H, E>, maximum_length: usize) -> u64 {
    let kept = MAXIMUM_SUBSCRIBERS * (topic.buffer + MAXIMUM_BORROWED) + 1;
    let message = size_of::<H>() + maximum_length * size_of::<E>();
    kept as u64 * message as u64
}

/// One process's membership in a run of a session. Ports are opened from it.
#[derive(Debug)]
pub struct Session {
    name: SessionName,
    /// `None` where nobody supervises, as in tests and benchmarks.
    run: Option<Run>,
    node: Node<ipc::Service>,
}

impl Session {
    /// Joins the session `name` as `process` (a name for humans).
    ///
    /// # Errors
    ///
    /// [`SessionError::Silent`] while the supervisor hangs; [`SessionError::Join`] when iceoryx2 cannot create its node.
    pub fn join(name: &SessionName, process: &str) -> Result<Session, SessionError> {
        iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
        let run = match name.supervisor(own_user()) {
            Some(Holder { process_id, card, .. }) => {
                let silent = || SessionError::Silent { session: name.clone(), process_id };
                Some(Run::on_card(&card).ok_or_else(silent)?)
            }
            None => None,
        };
        let folder = match &run {
            Some(run) => PrivateFolder::open(&run.folder)?,
            None => runtime_folder()?,
        };
        if folder.path().as_os_str().len() + name.prefix().len() + SOCKET_NAME_LENGTH > MAXIMUM_SOCKET_PATH {
            return Err(SessionError::NameTooLong(name.clone()));
        }
        let join_error =
            |reason: &dyn Debug| SessionError::Join { session: name.clone(), reason: format!("{reason:?}") };
        let node = NodeBuilder::new()
            .name(&NodeName::new(process).map_err(|error| join_error(&error))?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&name.config(folder.path()))
            .create::<ipc::Service>()
            .map_err(|error| join_error(&error))?;
        Ok(Session { name: name.clone(), run, node })
    }

    /// Whether the run that this process joined still goes on: `false` once it has ended, even if another of the same name
    /// has begun.
    pub fn is_running(&self) -> bool {
        self.name.supervisor(own_user()).is_some_and(|supervisor| {
            // One that hangs has not ended.
            supervisor.card.is_empty() || self.run == Run::on_card(&supervisor.card)
        })
    }

    /// The session's name.
    pub fn name(&self) -> &SessionName {
        &self.name
    }

    /// The configuration of the run; `None` while it is starting, or nobody supervises it.
    ///
    /// # Errors
    ///
    /// [`PathError`] when it cannot be read, or is not to be trusted.
    pub fn configuration(&self) -> Result<Option<String>, PathError> {
        let Some(run) = &self.run else { return Ok(None) };
        let kept = PrivateFolder::open(&run.folder)?.read(&self.name.configuration_file(run))?;
        Ok(kept.map(|text| String::from_utf8_lossy(&text).into_owned()))
    }

    pub(crate) fn topic<H: Traced, E: Element>(
        &self,
        topic: &Topic<H, E>,
        delivery: Delivery,
    ) -> Result<publish_subscribe::PortFactory<ipc::Service, [E], H>, SessionError> {
        self.node
            .service_builder(&self.service_name(topic.name)?)
            .publish_subscribe::<[E]>()
            .user_header::<H>()
            .enable_safe_overflow(delivery == Delivery::Live)
            .subscriber_max_buffer_size(topic.buffer)
            .subscriber_max_borrowed_samples(MAXIMUM_BORROWED)
            .history_size(0)
            .max_subscribers(MAXIMUM_SUBSCRIBERS)
            .max_publishers(MAXIMUM_PUBLISHERS)
            .max_nodes(MAXIMUM_NODES)
            .open_or_create()
            .map_err(|error| self.port_error(topic.name, &error))
    }

    /// The topic as it is in this session, whatever its delivery; `None` while nobody has opened it.
    pub(crate) fn existing_topic<H: Traced, E: Element>(
        &self,
        topic: &Topic<H, E>,
    ) -> Result<Option<publish_subscribe::PortFactory<ipc::Service, [E], H>>, SessionError> {
        let opened = self
            .node
            .service_builder(&self.service_name(topic.name)?)
            .publish_subscribe::<[E]>()
            .user_header::<H>()
            .open();
        match opened {
            Ok(service) => Ok(Some(service)),
            Err(PublishSubscribeOpenError::DoesNotExist) => Ok(None),
            Err(error) => Err(self.port_error(topic.name, &error)),
        }
    }

    /// Each run has topics of its own: iceoryx2 removes the files of a topic by its name once the last process leaves it, and
    /// an observer may outlive its run.
    fn service_name(&self, topic: &'static str) -> Result<ServiceName, SessionError> {
        let name = match &self.run {
            Some(run) => format!("{topic}.{}", run.began_ns),
            None => topic.to_owned(),
        };
        ServiceName::new(&name).map_err(|error| self.port_error(topic, &error))
    }

    pub(crate) fn port_error(&self, topic: &'static str, reason: &dyn Debug) -> SessionError {
        SessionError::Open { session: self.name.clone(), topic, reason: format!("{reason:?}") }
    }
}

/// The right to be the one supervisor of a session; given back when dropped or when the process dies.
#[derive(Debug)]
pub struct SessionLock {
    _claim: Claim,
    run: Run,
}

/// Why a session cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum SessionLockError {
    /// Another supervisor runs it.
    #[error(
        "session `{session}` is in use by {holder}: stop that one, or choose another name (--set session=NAME)"
    )]
    InUse {
        /// Session name.
        session: SessionName,
        /// The other supervisor: process and, if it is another's, user.
        holder: String,
    },
    /// The system refused.
    #[error("cannot take session `{session}`")]
    System {
        /// Session name.
        session: SessionName,
        /// The system's reason.
        source: ClaimError,
    },
    /// There is no place for run-time state.
    #[error(transparent)]
    Folder(#[from] PathError),
}

impl SessionLock {
    /// Takes the session. No file stands for it, so nobody can remove it; the kernel knows who holds it.
    ///
    /// # Errors
    ///
    /// [`SessionLockError::InUse`] while another process holds it.
    pub fn take(session: &SessionName) -> Result<SessionLock, SessionLockError> {
        let run = Run { began_ns: now_ns(), folder: runtime_folder()?.path().to_owned() };
        match Claim::take(&session.claim_of(own_user()), &run.to_card()) {
            Ok(claim) => Ok(SessionLock { _claim: claim, run }),
            Err(ClaimError::Held(holder)) => {
                let holder = match holder {
                    Some(Holder { process_id, user, .. }) if user == own_user() => {
                        format!("process {process_id}")
                    }
                    Some(Holder { process_id, user, .. }) => {
                        format!("process {process_id} of {}", user_name(user))
                    }
                    None => "another process".to_owned(),
                };
                Err(SessionLockError::InUse { session: session.clone(), holder })
            }
            Err(source) => Err(SessionLockError::System { session: session.clone(), source }),
        }
    }
}

impl SessionLock {
    /// Keeps the session's configuration where observers that it did not start find it. It goes with the session's other
    /// leftovers.
    ///
    /// # Errors
    ///
    /// [`PathError`] when it cannot be written.
    pub fn keep_configuration(&self, session: &SessionName, configuration: &str) -> Result<(), PathError> {
        PrivateFolder::open(&self.run.folder)?
            .write(&session.configuration_file(&self.run), configuration.as_bytes())
    }
}

/// Files that this user's sessions have in shared memory and in the folders of run-time state.
#[derive(Debug, Default)]
pub struct Leftovers {
    /// Paths of the files.
    pub files: Vec<PathBuf>,
    /// Their size in bytes.
    pub bytes: u64,
}

/// What became of the files that a session left behind.
#[derive(Debug, Default)]
pub struct Removed {
    /// How many are gone.
    pub files: usize,
    /// Those that could not be removed.
    pub kept: Vec<PathBuf>,
}

impl Leftovers {
    /// What `session` has there at the moment, alive or not.
    pub fn of(session: &SessionName) -> Leftovers {
        Leftovers::with_prefix(&session.prefix())
    }

    /// What all sessions of this user have there, those in use included.
    pub fn of_all_sessions() -> Leftovers {
        Leftovers::with_prefix(&format!("tendon.{}.", own_user()))
    }

    fn with_prefix(prefix: &str) -> Leftovers {
        let mut leftovers = Leftovers::default();
        let mut folders = vec![shared_memory_directory().to_owned()];
        folders.extend(runtime_folders().iter().map(|folder| folder.path().to_owned()));
        while let Some(folder) = folders.pop() {
            let Ok(entries) = std::fs::read_dir(&folder) else { continue };
            for entry in entries.flatten() {
                let path = entry.path();
                let is_in_memory = path.starts_with(shared_memory_directory());
                // Of the entry itself: links are not followed.
                match entry.metadata() {
                    Ok(metadata) if metadata.is_dir() && !is_in_memory => folders.push(path),
                    Ok(metadata) if entry.file_name().to_string_lossy().starts_with(prefix) => {
                        leftovers.bytes += metadata.len();
                        leftovers.files.push(path);
                    }
                    _ => {}
                }
            }
        }
        leftovers
    }

    /// The sessions that these files belong to.
    pub fn sessions(&self) -> Vec<SessionName> {
        let mut names: Vec<SessionName> = Vec::new();
        for file in &self.files {
            let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let session = name.split('.').nth(2).and_then(|name| name.parse().ok());
            if let Some(session) = session.filter(|session| !names.contains(session)) {
                names.push(session);
            }
        }
        names
    }

    /// Removes everything `session` left behind. The caller holds its [`SessionLock`] and has reaped all of
    /// its processes: files of living ones would be pulled from under them.
    pub fn remove(_lock: &SessionLock, session: &SessionName) -> Removed {
        let before = Leftovers::of(session).files.len();
        Leftovers::remove_empty_segments(session, Duration::ZERO);
        // Then iceoryx2's own way, which knows in which order things go; then what even that left.
        Leftovers::remove_dead_nodes(session);
        for file in Leftovers::of(session).files {
            // What vanishes meanwhile needs no removing; what resists is counted below.
            let _ = std::fs::remove_file(file);
        }
        let kept = Leftovers::of(session).files;
        Removed { files: before.saturating_sub(kept.len()), kept }
    }

    /// A process that was killed while it made a segment of shared memory leaves it empty, and iceoryx2 0.10 would wait
    /// for ever for it to be filled. A living one fills it within microseconds.
    fn remove_empty_segments(session: &SessionName, older_than: Duration) {
        for file in Leftovers::of(session).files {
            let is_left_empty = std::fs::metadata(&file).is_ok_and(|metadata| {
                let age = metadata.modified().ok().and_then(|modified| modified.elapsed().ok());
                metadata.is_file() && metadata.len() == 0 && age.unwrap_or_default() >= older_than
            });
            if is_left_empty && file.starts_with(shared_memory_directory()) {
                let _ = std::fs::remove_file(file);
            }
        }
    }

    /// Removes what dead processes left in `session` while others live in it: their ports give way to those of the
    /// processes that stand in for them. The dead must have been reaped. What cannot be removed now goes with the
    /// session.
    pub fn remove_of_the_dead(session: &SessionName) {
        Leftovers::remove_empty_segments(session, LONGEST_EMPTY);
        Leftovers::remove_dead_nodes(session);
    }

    fn remove_dead_nodes(session: &SessionName) {
        for folder in runtime_folders() {
            let _ = Node::<ipc::Service>::list(&session.config(folder.path()), |state| {
                if let NodeState::Dead(dead) = state {
                    let _ = dead.try_remove_stale_resources();
                }
                CallbackProgression::Continue
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_supervisors_cannot_take_one_session() {
        let name: SessionName = format!("lock-{}", std::process::id()).parse().unwrap();
        let lock = SessionLock::take(&name).unwrap();
        let error = SessionLock::take(&name).unwrap_err();
        assert!(error.to_string().contains(&format!("in use by process {}", std::process::id())), "{error}");
        drop(lock);
        SessionLock::take(&name).unwrap();
    }

    proptest! {
        #[test]
        fn session_names_make_file_names_or_are_refused(name in ".{0,40}") {
            match name.parse::<SessionName>() {
                Ok(session) => {
                    session.config(Path::new("/tmp/tendon-1000"));
                    prop_assert_eq!(session.to_string(), name);
                }
                Err(error) => prop_assert!(error.to_string().contains("session name")),
            }
        }
    }
}
