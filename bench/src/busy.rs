//! Cores kept busy: one endless loop each, of the default scheduling policy.

use std::hint::spin_loop;

use nix::sched::{CpuSet, sched_setaffinity};
use nix::unistd::Pid;

use crate::child::Child;

/// Starts one busy process on each of `cores` cores; they end when the result is dropped.
pub fn saturate(cores: usize) -> anyhow::Result<Vec<Child>> {
    (0..cores).map(|core| Child::start(&["busy".to_owned(), core.to_string()])).collect()
}

/// Keeps `core` busy until the process is ended.
pub fn spin(core: usize) -> ! {
    let mut one = CpuSet::new();
    // Where a core may not be chosen, the scheduler spreads as many loops as there are cores over them.
    let _ = one.set(core).and_then(|()| sched_setaffinity(Pid::from_raw(0), &one));
    loop {
        spin_loop();
    }
}
