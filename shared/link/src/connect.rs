//! The thread that connects.

use std::io::{self, PipeReader, PipeWriter, Write};
use std::net::TcpListener;
use std::os::fd::AsFd;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use tendon_source::Offer;

use crate::error::ConnectError;
use crate::socket::{accept, read_before, stay_ready, wait};
use crate::{Instants, Link};

/// Time between the beginnings of two tries.
const TRY_INTERVAL: Duration = Duration::from_secs(1);
/// A device that is connected but silent for so long is lost.
const SILENCE: Duration = Duration::from_millis(500);
/// Nothing is due so soon.
const LONG: Duration = Duration::from_secs(3600);
/// Time between two lines about devices that dial in while one is connected: they try again several times a second.
const REFUSAL_INTERVAL: Duration = Duration::from_secs(60);
/// Bytes of a read.
const READ_BYTES: usize = 1 << 16;

/// Makes connections to a device. Runs in a thread of its own, so it may wait.
pub trait Connector: Send + 'static {
    /// Tries once: waits a second or so for the device, starts it, and checks that its samples are what it says, with
    /// [`check_rate`](crate::check_rate). The stream is non-blocking: [`stay_ready`].
    ///
    /// # Errors
    ///
    /// [`ConnectError::NotYet`] to be called again, [`ConnectError::Unfit`] if that makes no sense.
    fn connect(&mut self) -> Result<Link, ConnectError>;

    /// Where devices dial in, non-blocking. Whoever does while there is a connection is refused.
    fn listener(&self) -> Option<&TcpListener> {
        None
    }
}

/// What the thread says.
pub(crate) enum Event {
    /// A device is connected and checked.
    Connected { offer: Offer, name: String },
    /// A try came to nothing.
    Failed(ConnectError),
    /// The connection that was asked for.
    Link(Link),
}

/// The thread, from the loop's side.
pub(crate) struct Connecting {
    events: Receiver<Event>,
    wakes: PipeReader,
    requests: PipeWriter,
}

impl Connecting {
    pub(crate) fn start(connector: impl Connector) -> io::Result<Connecting> {
        let (sender, events) = channel();
        let (wakes, waker) = io::pipe()?;
        let (asked, requests) = io::pipe()?;
        stay_ready(&wakes)?;
        stay_ready(&asked)?;
        let thread = Thread { connector, events: sender, waker, requests: asked, refusal_said: None };
        std::thread::Builder::new().name("connect".to_owned()).spawn(move || thread.run())?;
        Ok(Connecting { events, wakes, requests })
    }

    /// Becomes readable when there is an event.
    pub(crate) fn wakes(&self) -> &PipeReader {
        &self.wakes
    }

    /// The next event, if there is one.
    pub(crate) fn event(&self) -> Option<Event> {
        // A byte too few is read at most when an event came meanwhile: then the pipe is still readable.
        let _ = nix::unistd::read(&self.wakes, &mut [0; 1]);
        self.events.try_recv().ok()
    }

    /// Asks for a connection: the one that there is, or the next one.
    pub(crate) fn ask(&mut self) {
        // The thread ends with the process only.
        let _ = self.requests.write_all(b"\n");
    }
}

/// Whether the other side is still there.
enum Asked {
    Yes,
    /// The process ends.
    Gone,
}

struct Thread<C> {
    connector: C,
    events: Sender<Event>,
    waker: PipeWriter,
    requests: PipeReader,
    /// When it was last said that somebody was refused.
    refusal_said: Option<Instant>,
}

impl<C: Connector> Thread<C> {
    /// Ends when nobody listens any more.
    fn run(mut self) -> Option<()> {
        let mut is_asked = false;
        loop {
            let mut link = self.connect()?;
            self.say(Event::Connected { offer: link.offer.clone(), name: link.name.clone() })?;
            if !is_asked {
                match self.keep_fresh(&mut link) {
                    Ok(Asked::Yes) => {}
                    Ok(Asked::Gone) => return None,
                    Err(error) => {
                        self.say(Event::Failed(error))?;
                        continue;
                    }
                }
            }
            let name = link.name.clone();
            self.say(Event::Link(link))?;
            self.refuse_others(&name)?;
            is_asked = true;
        }
    }

    fn say(&mut self, event: Event) -> Option<()> {
        self.events.send(event).ok()?;
        self.waker.write_all(b"\n").ok()
    }

    fn connect(&mut self) -> Option<Link> {
        loop {
            let began = Instant::now();
            match self.connector.connect() {
                Ok(link) => return Some(link),
                Err(error) => self.say(Event::Failed(error))?,
            }
            std::thread::sleep((began + TRY_INTERVAL).saturating_duration_since(Instant::now()));
        }
    }

    /// Reads and drops samples until the connection is asked for, so that none is old then.
    fn keep_fresh(&mut self, link: &mut Link) -> Result<Asked, ConnectError> {
        let mut buffer = vec![0; READ_BYTES];
        let mut silent_at = Instant::now() + SILENCE;
        loop {
            let descriptors = [self.requests.as_fd(), link.stream.as_fd()];
            match wait(&descriptors, silent_at).map_err(ConnectError::not_yet)? {
                [true, _] => return Ok(self.take_request()),
                [_, true] => {}
                _ if Instant::now() < silent_at => continue,
                _ => return Err(ConnectError::not_yet(format!("{} sends nothing any more", link.name))),
            }
            refuse(self.connector.listener(), &link.name, &mut self.refusal_said);
            let count =
                read_before(&link.stream, &mut buffer, Instant::now()).map_err(ConnectError::not_yet)?;
            match count {
                None => continue,
                Some(0) => return Err(ConnectError::not_yet(format!("{} closed the connection", link.name))),
                Some(count) => {
                    let mut drop_it = |_: Instants<'_>| silent_at = Instant::now() + SILENCE;
                    link.decoder.push(&buffer[..count], &mut drop_it).map_err(ConnectError::not_yet)?;
                }
            }
        }
    }

    /// Refuses whoever dials in until another connection is asked for; `None` when the process ends.
    fn refuse_others(&mut self, connected: &str) -> Option<()> {
        loop {
            let requests = self.requests.as_fd();
            let listener = self.connector.listener();
            // Without a listener the requests stand in for it.
            let listening = listener.map_or(requests, AsFd::as_fd);
            let [asked, dialled] = wait(&[requests, listening], Instant::now() + LONG).ok()?;
            if asked {
                return matches!(self.take_request(), Asked::Yes).then_some(());
            }
            if dialled {
                refuse(listener, connected, &mut self.refusal_said);
            }
        }
    }

    fn take_request(&mut self) -> Asked {
        match nix::unistd::read(&self.requests, &mut [0; 1]) {
            Ok(0) => Asked::Gone,
            _ => Asked::Yes,
        }
    }
}

/// Hangs up on whoever has dialled in while `connected` is there, and says so now and then.
fn refuse(listener: Option<&TcpListener>, connected: &str, said: &mut Option<Instant>) {
    let Some(listener) = listener else { return };
    while let Ok(Some((_, peer))) = accept(listener, Duration::ZERO) {
        if said.is_none_or(|at| at.elapsed() >= REFUSAL_INTERVAL) {
            *said = Some(Instant::now());
            tracing::warn!(
                "{peer} dialled in and was refused: {connected} is connected. Switch one of them off"
            );
        }
    }
}
