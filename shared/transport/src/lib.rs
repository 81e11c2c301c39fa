//! Typed publish-subscribe ports over iceoryx2 shared memory.
//!
//! ```text
//!  publisher process                shared memory                     subscriber process
//!  Publisher::publish ──loan, fill in place──▶ [header | payload] ◀──read in place── Subscriber::receive
//!          └───────── a byte into the subscriber's FIFO ─────────────▶ its one blocking wait
//! ```
//!
//! * A message is written once, in place, and read in place: nothing is copied or serialised on the way.
//! * Every message carries a [`Trace`](tendon_messages::Trace); the ports set its stamps and sequence number,
//!   and the subscriber counts the gaps.
//! * [`Delivery::Live`] keeps the newest messages for a slow subscriber and never holds up the publisher;
//!   [`Delivery::Lossless`] makes the publisher wait and loses nothing.
//! * No wake-up is ever lost: the head of `wake.rs` says why.
//! * Everything lives under a [`SessionName`], so that two sessions on one machine never meet.

mod clock;
mod find;
mod leftovers;
mod lock;
mod publisher;
mod session;
mod shared_files;
mod subscriber;
mod wake;

pub use clock::now_ns;
pub use find::{FindError, find_owner};
pub use leftovers::{Leftovers, Removed};
pub use lock::{SessionLock, SessionLockError};
pub use publisher::{Element, Loan, PublishError, Publisher};
pub use session::{
    Delivery, InvalidSessionName, Session, SessionError, SessionName, own_user, required_bytes,
    running_sessions, shared_memory_directory,
};
pub use shared_files::SharedFiles;
pub use subscriber::{PolledSubscriber, ReceiveError, Received, Subscriber};
