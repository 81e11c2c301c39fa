//! An observer of a session: it joins by the session's name alone and sees what the stages measure and publish.
//!
//! ```text
//! five stages ──measurements──▶ Observer::gather ─▶ SessionMeasurements ─▶ report, `tendon latency`
//!       robot ──states────────▶        │        ─▶ newest State, and every state to the caller
//!   any stage ──its topic─────▶ Observer::subscribe ─▶ Subscriber (recorder, page)
//! ```
//!
//! No stage knows of an observer. Measurements and states never wait for one: an observer that is late loses messages,
//! and knows how many. Other topics have the delivery of the session: live, the same holds; lossless, the publisher
//! waits for every subscriber, so an observer must read or not subscribe.
#![forbid(unsafe_code)]

use std::time::{Duration, Instant};

use tendon_messages::{
    MEASUREMENTS, Measurement, MeasurementHeader, STATE_LENGTH, STATES, StateHeader, Topic, Traced,
};
use tendon_report::SessionMeasurements;
use tendon_transport::{
    Delivery, Element, FindError, Leftovers, ReceiveError, Session, SessionError, SessionName, Subscriber,
    own_user, shared_memory_directory,
};

/// How long a supervisor may take from claiming a session to opening its first topics.
const START_PATIENCE: Duration = Duration::from_secs(2);
/// Time between two looks for them.
const START_LOOK: Duration = Duration::from_millis(20);

/// Why a session cannot be observed.
#[derive(Debug, thiserror::Error)]
pub enum ObserverError {
    /// There is no such session.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The session runs, but nobody has opened the topic yet.
    #[error("session `{session}` has no topic `{topic}` yet: it is still starting, try again in a moment")]
    NoTopic {
        /// Session name.
        session: SessionName,
        /// Topic name.
        topic: &'static str,
    },
    /// The session runs, but what its processes reach each other through is gone.
    #[error(
        "session `{session}` runs, but its files in {} or its run-time folder are gone: somebody deleted them. End it and \
         start it again",
        shared_memory_directory().display()
    )]
    FilesGone {
        /// Session name.
        session: SessionName,
    },
    /// The session cannot be joined.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// A state of the arm.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// Permission, gesture, gripper and times.
    pub header: StateHeader,
    /// Joints, position and orientation, see [`STATE_LENGTH`].
    pub payload: [f32; STATE_LENGTH],
}

impl State {
    /// Position of the flange in the arm's base frame, mm.
    pub fn position_mm(&self) -> [f32; 3] {
        let [.., x, y, z, _, _, _] = self.payload;
        [x, y, z]
    }
}

/// A session as seen from outside.
#[derive(Debug)]
pub struct Observer {
    measurements: Subscriber<MeasurementHeader, Measurement>,
    states: Subscriber<StateHeader, f32>,
    gathered: SessionMeasurements,
    newest_state: Option<State>,
    // Ports close before the membership they belong to.
    session: Session,
}

impl Observer {
    /// Joins a running session as `program`, a name for humans.
    ///
    /// # Errors
    ///
    /// [`FindError::NotRunning`] when there is no such session; [`ObserverError::FilesGone`] when it runs, but its
    /// files were deleted; else what keeps the observer out of it.
    pub fn join(name: &SessionName, program: &str) -> Result<Observer, ObserverError> {
        if !is_running(name) {
            return Err(FindError::not_running(name).into());
        }
        let session = Session::join(name, program)?;
        let begun = Instant::now();
        loop {
            // The supervisor opens both at once, before it starts the stages.
            match observe(&session, &MEASUREMENTS).and_then(|first| Ok((first, observe(&session, &STATES)?)))
            {
                Ok((measurements, states)) => return Ok(Observer::new(session, measurements, states)),
                Err(ObserverError::NoTopic { .. }) if begun.elapsed() < START_PATIENCE => {
                    std::thread::sleep(START_LOOK);
                }
                Err(ObserverError::NoTopic { session, .. }) if is_running(&session) => {
                    return Err(ObserverError::FilesGone { session });
                }
                Err(ObserverError::NoTopic { session, .. }) => {
                    return Err(FindError::not_running(&session).into());
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Joins a session before its stages do, as the program that starts them, and so misses nothing.
    ///
    /// # Errors
    ///
    /// When shared memory is too small or the session cannot be joined.
    pub fn before_the_stages(name: &SessionName, program: &str) -> Result<Observer, SessionError> {
        let session = Session::join(name, program)?;
        let measurements = Subscriber::open(&session, &MEASUREMENTS, None, Delivery::Live)?;
        let states = Subscriber::open(&session, &STATES, None, Delivery::Live)?;
        Ok(Observer::new(session, measurements, states))
    }

    fn new(
        session: Session,
        measurements: Subscriber<MeasurementHeader, Measurement>,
        states: Subscriber<StateHeader, f32>,
    ) -> Observer {
        Observer {
            measurements,
            states,
            gathered: SessionMeasurements::default(),
            newest_state: None,
            session,
        }
    }

    /// Takes all that has come since the last call, without waiting. `on_state` sees every state in turn. Come by
    /// every 100 ms: later, the topics overflow, and what was lost is counted.
    ///
    /// # Errors
    ///
    /// When a publisher's memory cannot be mapped.
    pub fn gather(&mut self, mut on_state: impl FnMut(&State)) -> Result<(), ReceiveError> {
        self.measurements.acknowledge_wakes()?;
        while let Some(batch) = self.measurements.receive()? {
            self.gathered.absorb(batch.header(), batch.payload());
        }
        self.states.acknowledge_wakes()?;
        while let Some(received) = self.states.receive()? {
            if let Ok(payload) = received.payload().try_into() {
                let state = State { header: *received.header(), payload };
                on_state(&state);
                self.newest_state = Some(state);
            }
        }
        Ok(())
    }

    /// What the stages measured, as far as it was gathered.
    pub fn measurements(&self) -> &SessionMeasurements {
        &self.gathered
    }

    /// The stages are being stopped from now on: see [`SessionMeasurements::ending`].
    pub fn ending(&mut self) {
        self.gathered.ending();
    }

    /// The newest state of the arm; `None` before the first.
    pub fn newest_state(&self) -> Option<&State> {
        self.newest_state.as_ref()
    }

    /// States that came too fast to be seen.
    pub fn states_lost(&self) -> u64 {
        self.states.lost()
    }

    /// Subscribes to any topic of the session, such as `BLOCKS`. The subscriber counts what it loses, and can be
    /// polled as a file descriptor.
    ///
    /// # Errors
    ///
    /// [`ObserverError::NoTopic`] before a stage has opened it; else what keeps the observer out of it.
    pub fn subscribe<H: Traced, E: Element>(
        &self,
        topic: &Topic<H, E>,
    ) -> Result<Subscriber<H, E>, ObserverError> {
        observe(&self.session, topic)
    }

    /// Whether the session still runs.
    pub fn is_running(&self) -> bool {
        self.session.is_running()
    }
}

/// Opens a topic that the session has. Observers that were killed keep their seats, of which a topic has eight, until
/// somebody clears them away.
fn observe<H: Traced, E: Element>(
    session: &Session,
    topic: &Topic<H, E>,
) -> Result<Subscriber<H, E>, ObserverError> {
    let opened = Subscriber::observe(session, topic).or_else(|_| {
        Leftovers::remove_of_the_dead(session.name());
        Subscriber::observe(session, topic)
    })?;
    opened.ok_or_else(|| ObserverError::NoTopic { session: session.name().clone(), topic: topic.name })
}

/// A session runs while a supervisor of this user holds its name.
fn is_running(session: &SessionName) -> bool {
    session.is_run_by(own_user())
}
