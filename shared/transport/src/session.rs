//! Sessions: names that keep two on one machine apart, and the part of a process in one.

use core::fmt::{self, Debug, Display};
use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::prelude::{Node, NodeBuilder, NodeName, SemanticString, ServiceName, SignalHandlingMode, ipc};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::publish_subscribe;
use serde::{Deserialize, Serialize};
use tendon_messages::{Topic, Traced};
use tendon_paths::{
    Holder, PathError, PrivateFolder, claimed_names, holding_user, runtime_folder, runtime_folders, user_name,
};

use crate::publisher::Element;

/// Subscribers a topic can have: the next stage and observers (supervisor, `tendon latency`, recorders).
pub(crate) const MAXIMUM_SUBSCRIBERS: usize = 8;
/// Messages a subscriber may hold at a time: it looks at one, and drops it before the next.
const MAXIMUM_BORROWED: usize = 2;
/// Publishers a topic can have: every stage on `measurements`, and restarted ones beside the dead.
const MAXIMUM_PUBLISHERS: usize = 8;
/// Processes that can take part in a topic.
const MAXIMUM_NODES: usize = 24;
/// How long a topic that several processes open at once may take, and the time between two tries.
const OPENING_TIMEOUT: Duration = Duration::from_secs(1);
const OPENING_LOOK: Duration = Duration::from_millis(2);
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
    pub(crate) fn prefix(&self) -> String {
        format!("{}.", self.claim_of(own_user()))
    }

    /// The name in the kernel that the supervisor of this session holds, if `user` runs it.
    pub(crate) fn claim_of(&self, user: u32) -> String {
        format!("tendon.{user}.{}", self.0)
    }

    /// Whether `user` runs the session of this name. The kernel says so: somebody else cannot pass for `user`, and a
    /// supervisor that hangs is not waited for.
    pub fn is_run_by(&self, user: u32) -> bool {
        holding_user(&self.claim_of(user)) == Some(user)
    }

    /// Who runs the session of this name for `user`; `None` if nobody does.
    pub fn supervisor(&self, user: u32) -> Option<Holder> {
        let holder = self.is_run_by(user).then(|| Holder::of(&self.claim_of(user)))?;
        holder.filter(|holder| holder.user == user)
    }

    /// A file of this session with the ending `ending`, in shared memory. It goes with the session's other
    /// leftovers.
    pub(crate) fn shared_memory_file(&self, ending: &str) -> PathBuf {
        shared_memory_directory().join(format!("{}{ending}", self.prefix()))
    }

    /// Name of the file in the run-time folder that says which run of this session goes on.
    pub(crate) fn run_file(&self) -> String {
        format!("{}run", self.prefix())
    }

    /// Name of the file in the run-time folder in which a supervisor keeps the configuration of a run.
    pub(crate) fn configuration_file(&self, run: &Run) -> String {
        format!("{}configuration.{}", self.prefix(), run.began_ns)
    }

    /// iceoryx2's configuration for this session, whose run-time state lies in `folder`.
    pub(crate) fn config(&self, folder: &Path) -> Config {
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

    /// Where the robot of this session takes orders, if `user` runs it: a socket in the user's run-time folder, which nobody
    /// else but root may enter. `None` where no such session runs.
    pub fn order_socket(&self, user: u32) -> Option<PathBuf> {
        Some(self.folder_on_card(user)?.join(self.order_socket_name(user)))
    }

    /// The same sockets as [`SessionName::order_socket`], of this user, as far as their folder is known without asking the
    /// supervisor, which may hang.
    pub fn order_sockets_at_hand(&self) -> Vec<PathBuf> {
        let name = self.order_socket_name(own_user());
        let paths = runtime_folders().into_iter().map(|folder| folder.path().join(&name));
        paths.filter(|path| path.exists()).collect()
    }

    fn order_socket_name(&self, user: u32) -> String {
        format!("{}.orders", self.claim_of(user))
    }

    /// When the run began that goes on or was broken off; `None` where nobody supervises, as in tests and benchmarks.
    fn began_ns(&self, folder: &PrivateFolder) -> Result<Option<u64>, PathError> {
        let said = folder.read(&self.run_file())?;
        Ok(said.and_then(|text| String::from_utf8_lossy(&text).parse().ok()))
    }

    /// Where the run-time state of this user's session lies: where its supervisor says, if one runs, whatever this
    /// process's own environment says.
    fn folder(&self) -> Result<PrivateFolder, PathError> {
        self.folder_on_card(own_user()).map_or_else(runtime_folder, |folder| PrivateFolder::open(&folder))
    }

    /// The same as its supervisor says, if `user` runs it; `None` also while the supervisor hangs.
    fn folder_on_card(&self, user: u32) -> Option<PathBuf> {
        let supervisor = self.supervisor(user).filter(|supervisor| !supervisor.card.is_empty())?;
        Some(PathBuf::from(supervisor.card))
    }
}

/// One run of a session. The next session of this name is another run.
#[derive(Debug)]
pub(crate) struct Run {
    /// When the supervisor took the session, ns of the monotonic clock. A file in the folder says so while the run goes on.
    pub(crate) began_ns: u64,
    /// Where the run-time state of the session lies.
    pub(crate) folder: PrivateFolder,
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
        name.is_run_by(user).then_some((user, name))
    };
    claimed_names("tendon.").into_iter().filter_map(parse).collect()
}

/// Where the kernel keeps POSIX shared memory.
pub fn shared_memory_directory() -> &'static Path {
    Path::new("/dev/shm")
}

/// The one file of iceoryx2 whose name is known beforehand, by which the nodes of a session are numbered, and its metadata.
fn management_file(session: &SessionName) -> Option<(PathBuf, std::fs::Metadata)> {
    let prefix = session.prefix();
    let is_it = |name: &str| name.starts_with(&prefix) && name.ends_with(".global_mgmt");
    let files = std::fs::read_dir(shared_memory_directory()).ok()?;
    let file = files.flatten().find(|file| file.file_name().to_str().is_some_and(is_it))?;
    Some((file.path(), file.metadata().ok()?))
}

/// Refuses a file that another user has put in the place of ours.
fn refuse_foreign_management(session: &SessionName) -> Result<(), SessionError> {
    match management_file(session) {
        Some((file, metadata)) if metadata.uid() != own_user() && own_user() != 0 => {
            let owner = user_name(metadata.uid());
            Err(SessionError::ForeignFile { session: session.clone(), file, owner })
        }
        _ => Ok(()),
    }
}

/// iceoryx2 lets everybody write to it, and what another user writes there keeps a stage from being started again.
fn keep_management_private(session: &SessionName) {
    if let Some((file, metadata)) = management_file(session)
        && metadata.uid() == own_user()
        && metadata.permissions().mode() & 0o077 != 0
    {
        // Where it cannot be, it is as iceoryx2 made it.
        let _ = std::fs::set_permissions(file, Permissions::from_mode(0o600));
    }
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
    /// Another user's file is in the way.
    #[error(
        "session `{session}`: {} belongs to {owner} and stands where this session needs a file of its own: take another name \
         with --session, or let root remove it",
        file.display()
    )]
    ForeignFile {
        /// Session name.
        session: SessionName,
        /// The file.
        file: PathBuf,
        /// Name of its owner.
        owner: String,
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
    /// [`SessionError::Join`] when iceoryx2 cannot create its node.
    pub fn join(name: &SessionName, process: &str) -> Result<Session, SessionError> {
        iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
        let folder = name.folder()?;
        let began_ns = name.began_ns(&folder)?;
        if folder.path().as_os_str().len() + name.prefix().len() + SOCKET_NAME_LENGTH > MAXIMUM_SOCKET_PATH {
            return Err(SessionError::NameTooLong(name.clone()));
        }
        let join_error =
            |reason: &dyn Debug| SessionError::Join { session: name.clone(), reason: format!("{reason:?}") };
        refuse_foreign_management(name)?;
        let node = NodeBuilder::new()
            .name(&NodeName::new(process).map_err(|error| join_error(&error))?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .config(&name.config(folder.path()))
            .create::<ipc::Service>()
            .map_err(|error| join_error(&error))?;
        keep_management_private(name);
        let run = began_ns.map(|began_ns| Run { began_ns, folder });
        Ok(Session { name: name.clone(), run, node })
    }

    /// Whether the run that this process joined still goes on: `false` once it has ended, even if another of the same name
    /// has begun.
    pub fn is_running(&self) -> bool {
        let Some(run) = &self.run else { return false };
        let began_ns = self.name.began_ns(&run.folder).ok().flatten();
        // Who deletes the folder does not end the session.
        self.name.is_run_by(own_user()) && began_ns.is_none_or(|began_ns| began_ns == run.began_ns)
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
        let kept = run.folder.read(&self.name.configuration_file(run))?;
        Ok(kept.map(|text| String::from_utf8_lossy(&text).into_owned()))
    }

    pub(crate) fn topic<H: Traced, E: Element>(
        &self,
        topic: &Topic<H, E>,
        delivery: Delivery,
    ) -> Result<publish_subscribe::PortFactory<ipc::Service, [E], H>, SessionError> {
        let name = self.service_name(topic.name)?;
        let open = || {
            self.node
                .service_builder(&name)
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
        };
        let begun = Instant::now();
        loop {
            match open() {
                Err(error) if is_passing(&error) && begun.elapsed() < OPENING_TIMEOUT => {
                    std::thread::sleep(OPENING_LOOK);
                }
                opened => return opened.map_err(|error| self.port_error(topic.name, &error)),
            }
        }
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

/// Whether the next try may succeed: a signal came, or another process creates or removes the topic at this moment.
fn is_passing(error: &PublishSubscribeOpenOrCreateError) -> bool {
    matches!(
        error,
        PublishSubscribeOpenOrCreateError::SystemInFlux
            | PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
                PublishSubscribeOpenError::DoesNotExist | PublishSubscribeOpenError::Interrupt
            )
            | PublishSubscribeOpenOrCreateError::PublishSubscribeCreateError(
                PublishSubscribeCreateError::Interrupt
            )
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
