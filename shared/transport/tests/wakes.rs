//! A subscriber that sleeps in poll(2) is woken by every message, whatever the pace.
//!
//! iceoryx2 0.10's own event fails here: with a message every 2 µs it left a subscriber asleep for ever some
//! fourteen times in 20 s.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may do what tests may")]

use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Barrier};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use tendon_messages::{BLOCKS, BlockHeader, Stage};
use tendon_transport::{Delivery, Leftovers, Publisher, Session, SessionLock, SessionName, Subscriber};

/// A subscriber that is not woken for so long though messages go on has been left asleep.
const STALL_MS: u8 = 100;
/// The paces, in µs between two messages: each in turn for a while.
const PACES_US: [u64; 8] = [1, 2, 3, 5, 8, 14, 26, 50];
/// Messages at one pace before the next.
const MESSAGES_AT_A_PACE: u64 = 10_000;

/// What came of it.
#[derive(Debug, Default)]
struct Outcome {
    received: u64,
    wakes: u64,
    stalls: u64,
}

/// Publishes `messages` at all paces to a subscriber that sleeps between them, and counts how often it is left
/// asleep.
fn stress(name: &str, delivery: Delivery, messages: u64) -> Outcome {
    let name: SessionName = format!("{name}-{}", std::process::id()).parse().unwrap();
    let lock = SessionLock::take(&name).unwrap();
    let session = Session::join(&name, "receiver").unwrap();
    let mut blocks: Subscriber<BlockHeader, f32> =
        Subscriber::open(&session, &BLOCKS, Some(Stage::Dsp), delivery).unwrap();
    let (sent, is_over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let is_connected = Arc::new(Barrier::new(2));
    let sender = {
        let (name, sent, is_over) = (name.clone(), sent.clone(), is_over.clone());
        let is_connected = is_connected.clone();
        std::thread::spawn(move || {
            let session = Session::join(&name, "sender").unwrap();
            let stop = Arc::new(AtomicBool::new(false));
            let mut blocks = Publisher::open(&session, &BLOCKS, 1, delivery, stop).unwrap();
            is_connected.wait();
            for message in 0..messages {
                let pace_us = PACES_US[(message / MESSAGES_AT_A_PACE) as usize % PACES_US.len()];
                let begun = Instant::now();
                blocks.publish(BlockHeader::default(), 1, |payload| payload[0] = 0.0).unwrap();
                sent.fetch_add(1, Ordering::SeqCst);
                while begun.elapsed() < Duration::from_micros(pace_us) {
                    std::hint::spin_loop();
                }
            }
            is_over.store(true, Ordering::SeqCst);
            // What was sent lies in the publisher's memory: keep it until it is received.
            std::thread::park_timeout(Duration::from_secs(5));
        })
    };
    // A publisher that comes wakes the port, too.
    while !blocks.connect().unwrap() {
        poll(&mut [PollFd::new(blocks.as_fd(), PollFlags::POLLIN)], PollTimeout::NONE).unwrap();
        blocks.acknowledge_wakes().unwrap();
    }
    is_connected.wait();

    let mut outcome = Outcome::default();
    loop {
        let (was_over, sent_before) = (is_over.load(Ordering::SeqCst), sent.load(Ordering::SeqCst));
        let is_awake = |timeout: PollTimeout| {
            poll(&mut [PollFd::new(blocks.as_fd(), PollFlags::POLLIN)], timeout).unwrap() == 1
        };
        if is_awake(PollTimeout::from(STALL_MS)) {
            outcome.wakes += 1;
        } else if was_over {
            break;
        } else if sent.load(Ordering::SeqCst) > sent_before + 1 && !is_awake(PollTimeout::ZERO) {
            outcome.stalls += 1;
        }
        blocks.acknowledge_wakes().unwrap();
        while blocks.receive().unwrap().is_some() {
            outcome.received += 1;
        }
    }
    if blocks.receive().unwrap().is_some() {
        // The last messages woke nobody.
        outcome.stalls += 1;
    } else {
        // What made way for newer ones before the first was received counts as published before this port joined.
        let (first, next) = blocks.sequence_range().unwrap();
        assert_eq!((outcome.received + blocks.lost(), next), (messages - first, messages), "{outcome:?}");
    }
    sender.thread().unpark();
    sender.join().unwrap();
    drop((blocks, session));
    Leftovers::remove(&lock);
    outcome
}

#[test]
fn an_observer_learns_the_delivery_of_a_topic_from_the_session() {
    let name: SessionName = format!("delivery-{}", std::process::id()).parse().unwrap();
    let lock = SessionLock::take(&name).unwrap();
    let session = Session::join(&name, "test").unwrap();
    assert!(Subscriber::observe(&session, &BLOCKS).unwrap().is_none());
    for delivery in [Delivery::Live, Delivery::Lossless] {
        let blocks = Publisher::open(&session, &BLOCKS, 1, delivery, Arc::default()).unwrap();
        let observer = Subscriber::observe(&session, &BLOCKS).unwrap().unwrap();
        assert_eq!(observer.delivery(), delivery);
        drop((blocks, observer));
    }
    drop(session);
    Leftovers::remove(&lock);
}

#[test]
fn a_sleeping_subscriber_is_woken_at_any_pace() {
    let outcome = stress("wakes-live", Delivery::Live, 300_000);
    assert_eq!(outcome.stalls, 0, "{outcome:?}");
}

#[test]
fn a_lossless_publisher_and_its_sleeping_subscriber_never_wait_for_each_other_for_ever() {
    let outcome = stress("wakes-lossless", Delivery::Lossless, 300_000);
    assert_eq!((outcome.stalls, outcome.received), (0, 300_000), "{outcome:?}");
}

/// `TENDON_NOTIFICATIONS` says how many; 10⁸ when it is not set: half an hour.
#[test]
#[ignore = "half an hour: cargo test --release -p tendon-transport --test wakes -- --ignored --nocapture"]
fn a_hundred_million_notifications() {
    let notifications =
        std::env::var("TENDON_NOTIFICATIONS").map_or(100_000_000, |count| count.parse().unwrap());
    let begun = Instant::now();
    let outcome = stress("wakes-long", Delivery::Live, notifications);
    println!("{notifications} notifications in {:.0} s: {outcome:?}", begun.elapsed().as_secs_f64());
    assert_eq!(outcome.stalls, 0, "{outcome:?}");
}
