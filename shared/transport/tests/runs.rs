//! One session after another of the same name: who joined the one before has no part in the next.
#![allow(clippy::unwrap_used, reason = "helpers of tests may do what tests may")]

use tendon_messages::{BLOCKS, BlockHeader};
use tendon_transport::{Delivery, Leftovers, Publisher, Session, SessionLock, SessionName, Subscriber};

fn name(test: &str) -> SessionName {
    format!("{test}-{}", std::process::id()).parse().unwrap()
}

fn publisher(session: &Session) -> Publisher<BlockHeader, f32> {
    Publisher::open(session, &BLOCKS, 1, Delivery::Live, std::sync::Arc::default()).unwrap()
}

/// Begins a run as a supervisor does.
fn begin(name: &SessionName, configuration: &str) -> SessionLock {
    let lock = SessionLock::take(name).unwrap();
    Leftovers::remove(&lock);
    lock.keep_configuration(configuration).unwrap();
    lock
}

#[test]
fn an_observer_that_outlives_its_run_takes_nothing_from_the_next() {
    let name = name("runs");
    let first = begin(&name, "first");
    let session = Session::join(&name, "stage").unwrap();
    let blocks = publisher(&session);
    let observing = Session::join(&name, "observer").unwrap();
    let observer = Subscriber::observe(&observing, &BLOCKS).unwrap().unwrap();
    assert!(observing.is_running());
    assert_eq!(observing.configuration().unwrap().as_deref(), Some("first"));
    drop((blocks, session, first));
    assert!(!observing.is_running());

    let second = begin(&name, "second");
    let session = Session::join(&name, "stage").unwrap();
    let mut blocks = publisher(&session);
    assert!(!observing.is_running(), "another run of the same name is another");
    drop((observer, observing));
    // Who comes now, as a stage that is started again, finds the topic.
    let late = Session::join(&name, "late").unwrap();
    assert_eq!(late.configuration().unwrap().as_deref(), Some("second"));
    let mut subscriber = Subscriber::observe(&late, &BLOCKS).unwrap().unwrap();
    while !subscriber.connect().unwrap() {
        std::thread::yield_now();
    }
    blocks.publish(BlockHeader::default(), 1, |payload| payload[0] = 1.0).unwrap();
    assert_eq!(subscriber.receive().unwrap().unwrap().payload(), [1.0]);
    drop((subscriber, late, blocks, session));
    Leftovers::remove(&second);
}
