//! The one clock of all stamps.

use nix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC in ns: the same for every process of the machine, never set back.
pub fn now_ns() -> u64 {
    let time =
        clock_gettime(ClockId::CLOCK_MONOTONIC).expect("Linux always has CLOCK_MONOTONIC: clock_gettime(2)");
    time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64
}
