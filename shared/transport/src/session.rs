//! Sessions: names that keep two runs on one machine apart, and what a run leaves behind.

use core::fmt::{self, Debug, Display};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::MetadataExt;
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
use nix::fcntl::{Flock, FlockArg};
use serde::{Deserialize, Serialize};
use tendon_messages::{Topic, Traced};

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
    /// What the names of this session's shared-memory files start with. The dots cannot be part of a session
    /// name, so no prefix is the start of another.
    fn prefix(&self) -> String {
        format!("tendon.{}.", self.0)
    }

    /// A file of this session with the ending `ending`, in the runtime directory. It goes with the session's
    /// other leftovers.
    pub fn runtime_file(&self, ending: &str) -> PathBuf {
        runtime_directory().join(format!("{}{ending}", self.prefix()))
    }

    /// A file of this session with the ending `ending`, in shared memory. It goes with the session's other
    /// leftovers.
    pub(crate) fn shared_memory_file(&self, ending: &str) -> PathBuf {
        shared_memory_directory().join(format!("{}{ending}", self.prefix()))
    }

    /// iceoryx2's configuration for this session.
    fn config(&self) -> Config {
        let mut config = Config::default();
        let root = runtime_directory();
        config.global.set_root_path(
            &iceoryx2::prelude::Path::new(root.as_os_str().as_encoded_bytes())
                .expect("the runtime directory is a short ASCII path made by this module"),
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

/// A file in the runtime directory that belongs to no session and outlives them. Its name must not start with `tendon.`.
pub fn runtime_file(name: &str) -> PathBuf {
    runtime_directory().join(name)
}

/// Where the files of all sessions live that are not shared memory: one folder a user.
fn runtime_directory() -> PathBuf {
    PathBuf::from(format!("/tmp/tendon-{}", nix::unistd::getuid()))
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
    /// The folder for sockets and locks could not be used.
    #[error("cannot use {}: {source}; remove it, or give it to this user", path.display())]
    RuntimeDirectory {
        /// The folder or file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
}

/// The most shared memory that the payloads of one publisher of `topic` can take up, in bytes, for messages
/// of up to `maximum_length` elements: every subscriber may hold back its whole buffer.
pub fn required_bytes<H: Traced, E: Element>(topic: &Topic<H, E>, maximum_length: usize) -> u64 {
    let kept = MAXIMUM_SUBSCRIBERS * (topic.buffer + MAXIMUM_BORROWED) + 1;
    let message = size_of::<H>() + maximum_length * size_of::<E>();
    kept as u64 * message as u64
}

/// One process's membership in a session. Ports are opened from it.
#[derive(Debug)]
pub struct Session {
    name: SessionName,
    node: Node<ipc::Service>,
}

impl Session {
    /// Joins the session `name` as `process` (a name for humans).
    ///
    /// # Errors
    ///
    /// [`SessionError::Join`] when iceoryx2 cannot create its node.
    pub fn join(name: &SessionName, process: &str) -> Result<Session, SessionError> {
        iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
        let join_error =
            |reason: &dyn Debug| SessionError::Join { session: name.clone(), reason: format!("{reason:?}") };
        let node = NodeBuilder::new()
            .name(&NodeName::new(process).map_err(|error| join_error(&error))?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&name.config())
            .create::<ipc::Service>()
            .map_err(|error| join_error(&error))?;
        Ok(Session { name: name.clone(), node })
    }

    /// The session's name.
    pub fn name(&self) -> &SessionName {
        &self.name
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

    fn service_name(&self, topic: &'static str) -> Result<ServiceName, SessionError> {
        ServiceName::new(topic).map_err(|error| self.port_error(topic, &error))
    }

    pub(crate) fn port_error(&self, topic: &'static str, reason: &dyn Debug) -> SessionError {
        SessionError::Open { session: self.name.clone(), topic, reason: format!("{reason:?}") }
    }
}

/// The right to be the one supervisor of a session; given back when dropped or when the process dies.
#[derive(Debug)]
pub struct SessionLock {
    path: PathBuf,
    _file: Flock<File>,
}

impl Drop for SessionLock {
    fn drop(&mut self) {
        // While still locked, so that nobody else's file goes; one that stays is no harm.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Why a session cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum SessionLockError {
    /// Another supervisor runs it.
    #[error(
        "session `{session}` is in use by process {process_id}: stop that one, or choose another name with \
         --session"
    )]
    InUse {
        /// Session name.
        session: SessionName,
        /// The other supervisor, as it wrote it down.
        process_id: String,
    },
    /// The lock file could not be used.
    #[error(transparent)]
    File(#[from] SessionError),
}

impl SessionLock {
    /// Takes the session.
    ///
    /// # Errors
    ///
    /// [`SessionLockError::InUse`] while another process holds it.
    pub fn take(session: &SessionName) -> Result<SessionLock, SessionLockError> {
        let directory = runtime_directory();
        let failed = |path: &Path, source| {
            SessionLockError::File(SessionError::RuntimeDirectory { path: path.to_owned(), source })
        };
        std::fs::create_dir_all(&directory).map_err(|error| failed(&directory, error))?;
        let path = directory.join(format!("lock.{session}"));
        loop {
            let file = OpenOptions::new()
                .create(true)
                .truncate(false)
                .read(true)
                .write(true)
                .open(&path)
                .map_err(|error| failed(&path, error))?;
            match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
                Ok(mut file) => {
                    // The holder before may have removed the file between our opening and our locking it.
                    if file.metadata().map_err(|error| failed(&path, error))?.nlink() == 0 {
                        continue;
                    }
                    // A holder that was killed left its number.
                    file.set_len(0).map_err(|error| failed(&path, error))?;
                    write!(file, "{}", std::process::id()).map_err(|error| failed(&path, error))?;
                    return Ok(SessionLock { path, _file: file });
                }
                Err((mut file, _)) => {
                    let mut process_id = String::new();
                    if file.read_to_string(&mut process_id).is_err() || process_id.is_empty() {
                        process_id = "(unknown)".to_owned();
                    }
                    return Err(SessionLockError::InUse { session: session.clone(), process_id });
                }
            }
        }
    }
}

/// Files that sessions have in shared memory and in the runtime directory.
#[derive(Debug, Default)]
pub struct Leftovers {
    /// Paths of the files.
    pub files: Vec<PathBuf>,
    /// Their size in bytes.
    pub bytes: u64,
}

impl Leftovers {
    /// What `session` has there at the moment, alive or not.
    pub fn of(session: &SessionName) -> Leftovers {
        Leftovers::with_prefix(&session.prefix())
    }

    /// What all sessions have there, those in use included.
    pub fn of_all_sessions() -> Leftovers {
        Leftovers::with_prefix("tendon.")
    }

    fn with_prefix(prefix: &str) -> Leftovers {
        let root = runtime_directory();
        let mut leftovers = Leftovers::default();
        let mut folders = vec![shared_memory_directory().to_owned(), root.clone()];
        while let Some(folder) = folders.pop() {
            let Ok(entries) = std::fs::read_dir(&folder) else { continue };
            for entry in entries.flatten() {
                let path = entry.path();
                let inside_runtime_directory = path.starts_with(&root);
                match entry.metadata() {
                    Ok(metadata) if metadata.is_dir() && inside_runtime_directory => folders.push(path),
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
            let session = name.split('.').nth(1).and_then(|name| name.parse().ok());
            if let Some(session) = session.filter(|session| !names.contains(session)) {
                names.push(session);
            }
        }
        names
    }

    /// Removes everything `session` left behind. The caller holds its [`SessionLock`] and has reaped all of
    /// its processes: files of living ones would be pulled from under them. Returns how many files went.
    pub fn remove(_lock: &SessionLock, session: &SessionName) -> usize {
        let before = Leftovers::of(session).files.len();
        Leftovers::remove_empty_segments(session, Duration::ZERO);
        // Then iceoryx2's own way, which knows in which order things go; then what even that left.
        Leftovers::remove_dead_nodes(session);
        for file in Leftovers::of(session).files {
            // What vanishes meanwhile needs no removing; what resists shows up in `tendon doctor`.
            let _ = std::fs::remove_file(file);
        }
        before
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
        let _ = Node::<ipc::Service>::list(&session.config(), |state| {
            if let NodeState::Dead(dead) = state {
                let _ = dead.try_remove_stale_resources();
            }
            CallbackProgression::Continue
        });
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
                    session.config();
                    prop_assert_eq!(session.to_string(), name);
                }
                Err(error) => prop_assert!(error.to_string().contains("session name")),
            }
        }
    }
}
