//! Asking the kernel to run a stage at once when its message comes.
//!
//! Under load a thread of the default policy may wait for a whole scheduler tick (3 to 4 ms were measured)
//! before it runs. Two remedies, in this order:
//!
//! 1. SCHED_FIFO, where the rights allow it: the stage runs before everything of the default policy.
//! 2. A short slice under EEVDF (Linux 6.12 and later): needs no rights; a thread that asks for 0.1 ms at a
//!    time is let in early, `sched_setattr(2)` with `sched_runtime` under SCHED_OTHER.
//!
//! All stages run on one core, because a hand-over to a sleeping core costs its waking, which on virtual
//! machines and laptops takes longer than all the stages' work, and no two stages ever work at the same time.
//! Programs that only watch a session keep off that core: they would empty its caches between two windows.

use std::fmt;

use nix::errno::Errno;
use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::unistd::Pid;
use serde::{Deserialize, Serialize};
use tendon_config::{Realtime, SchedulingSettings};
use tendon_messages::Stage;

/// Slice asked of EEVDF, in ns: the shortest it grants (`sched_setattr(2)` clamps to 0.1 ms).
const SHORT_SLICE_NS: u64 = 100_000;
/// Inference's slice: about a run of the model, which would otherwise lose the core in its midst at the
/// next tick, for 4 ms; and shorter than the default slice (1.4 ms on two cores, more on more), so that it is
/// still let in early. (Measured with both cores saturated: p99 of its work 4.7 ms with 0.1 ms, 0.63 with 0.5.)
const INFERENCE_SLICE_NS: u64 = 500_000;
/// SCHED_FIFO priority of the first stage; each later one is one higher, so that a message overtakes those
/// behind it. Middling: above ordinary threads, below what a real-time kernel runs its interrupts at (50).
const FIRST_STAGE_PRIORITY: u32 = 40;

/// What the kernel granted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scheduling {
    /// Policy and priority or slice.
    pub policy: Policy,
    /// Memory is locked: no page of the process is ever swapped out.
    pub memory_locked: bool,
    /// The one core the process runs on; `None` when it may run on all.
    pub core: Option<usize>,
    /// Why it is not more, in words; empty when all that was asked for was granted.
    pub shortfall: String,
}

/// How the kernel schedules the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// SCHED_FIFO with this priority.
    Fifo(u32),
    /// SCHED_OTHER with a slice of this many ns.
    ShortSlice(u64),
    /// SCHED_OTHER as is.
    Default,
}

impl Scheduling {
    /// What a process has that asked for nothing.
    pub fn untouched() -> Scheduling {
        Scheduling {
            policy: Policy::Default,
            memory_locked: false,
            core: None,
            shortfall: "replay at full speed".to_owned(),
        }
    }
}

impl fmt::Display for Scheduling {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.policy {
            Policy::Fifo(priority) => write!(formatter, "SCHED_FIFO {priority}")?,
            Policy::ShortSlice(slice_ns) => {
                write!(formatter, "SCHED_OTHER with a slice of {:.1} ms", slice_ns as f64 / 1e6)?;
            }
            Policy::Default => write!(formatter, "SCHED_OTHER")?,
        }
        write!(formatter, ", memory {}", if self.memory_locked { "locked" } else { "not locked" })?;
        match self.core {
            Some(core) => write!(formatter, ", core {core}"),
            None => write!(formatter, ", any core"),
        }
    }
}

/// Real-time scheduling was demanded and is not to be had.
#[derive(Debug, thiserror::Error)]
#[error(
    "scheduling.realtime = \"on\": {what} was refused ({reason}); grant it with `setcap cap_sys_nice,cap_ipc_lock+ep` \
     on the programs or rtprio and memlock in /etc/security/limits.conf, or use --realtime auto"
)]
pub struct RealtimeRefused {
    what: &'static str,
    reason: Errno,
}

/// Asks the kernel for what `settings` want, for this process as `stage`.
///
/// # Errors
///
/// [`RealtimeRefused`] with `realtime = "on"` only; otherwise what is refused is noted in
/// [`Scheduling::shortfall`].
pub fn schedule(settings: &SchedulingSettings, stage: Stage) -> Result<Scheduling, RealtimeRefused> {
    let mut shortfall = Vec::new();
    // Timers under SCHED_OTHER are otherwise up to 50 us late on purpose.
    if let Err(error) = nix::sys::prctl::set_timerslack(1) {
        shortfall.push(format!("timer slack stays at 50 us ({error})"));
    }
    let core = settings.one_core.then(|| pin_to_one_core(&mut shortfall)).flatten();
    let mut policy = Policy::Default;
    let mut memory_locked = false;
    if settings.realtime != Realtime::Off {
        let priority = FIRST_STAGE_PRIORITY + stage.index() as u32;
        match set_attributes(|attributes| attributes.fifo(priority)) {
            Ok(()) => policy = Policy::Fifo(priority),
            Err(reason) if settings.realtime == Realtime::On => {
                return Err(RealtimeRefused { what: "SCHED_FIFO", reason });
            }
            Err(reason) => shortfall.push(format!("SCHED_FIFO refused ({reason})")),
        }
        // Only pages that are in use: the stacks of idle threads and the unused parts of libraries need none.
        let flags = MlockAllFlags::MCL_CURRENT
            | MlockAllFlags::MCL_FUTURE
            | MlockAllFlags::from_bits_retain(libc::MCL_ONFAULT);
        match mlockall(flags) {
            Ok(()) => memory_locked = true,
            Err(reason) if settings.realtime == Realtime::On => {
                return Err(RealtimeRefused { what: "locking memory", reason });
            }
            Err(reason) => shortfall.push(format!("locking memory refused ({reason})")),
        }
    }
    if policy == Policy::Default {
        let slice_ns = if stage == Stage::Inference { INFERENCE_SLICE_NS } else { SHORT_SLICE_NS };
        match set_attributes(|attributes| attributes.short_slice(slice_ns)) {
            Ok(()) => policy = Policy::ShortSlice(slice_ns),
            Err(reason) => shortfall.push(format!("a short slice was refused ({reason})")),
        }
    }
    Ok(Scheduling { policy, memory_locked, core, shortfall: shortfall.join("; ") })
}

/// The calling thread.
const THIS_THREAD: Pid = Pid::from_raw(0);

/// Restricts the process to the stages' core.
fn pin_to_one_core(shortfall: &mut Vec<String>) -> Option<usize> {
    let pinned = sched_getaffinity(THIS_THREAD).and_then(|allowed| {
        let core = stages_core(&allowed).ok_or(Errno::EINVAL)?;
        let mut one = CpuSet::new();
        one.set(core)?;
        sched_setaffinity(THIS_THREAD, &one)?;
        Ok(core)
    });
    pinned.map_err(|error| shortfall.push(format!("cannot stay on one core ({error})"))).ok()
}

/// Keeps the calling thread, and those that it starts, off the core that the stages share. For programs that watch a
/// live session. Where there is no other core, or the kernel refuses, they run where they may: that only costs the
/// stages some microseconds.
pub fn keep_off_the_stages_core() {
    let Ok(mut allowed) = sched_getaffinity(THIS_THREAD) else { return };
    let Some(core) = stages_core(&allowed) else { return };
    if allowed.unset(core).is_ok() && stages_core(&allowed).is_some() {
        let _ = sched_setaffinity(THIS_THREAD, &allowed);
    }
}

/// The last core of those that a session may run on: interrupts tend to go to the first.
fn stages_core(allowed: &CpuSet) -> Option<usize> {
    (0..CpuSet::count()).rev().find(|core| allowed.is_set(*core) == Ok(true))
}

/// `struct sched_attr` of sched_setattr(2), in its first version.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct Attributes {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime_ns: u64,
    deadline_ns: u64,
    period_ns: u64,
}

const ATTRIBUTES_SIZE: u32 = size_of::<Attributes>() as u32;

impl Attributes {
    /// What the calling thread has.
    fn current() -> Result<Attributes, Errno> {
        let mut attributes = Attributes::default();
        // SAFETY: the kernel writes at most `ATTRIBUTES_SIZE` bytes into a live, `repr(C)` value of that size, for
        // whose integers every bit pattern is valid.
        let result = unsafe {
            libc::syscall(libc::SYS_sched_getattr, 0, std::ptr::from_mut(&mut attributes), ATTRIBUTES_SIZE, 0)
        };
        if result == 0 { Ok(attributes) } else { Err(Errno::last()) }
    }

    fn fifo(self, priority: u32) -> Attributes {
        Attributes { policy: libc::SCHED_FIFO as u32, priority, runtime_ns: 0, ..self }
    }

    fn short_slice(self, slice_ns: u64) -> Attributes {
        Attributes { policy: libc::SCHED_OTHER as u32, priority: 0, runtime_ns: slice_ns, ..self }
    }
}

/// sched_setattr(2) for the calling thread; no library wraps it, and sched_setscheduler(2) knows no slices. What
/// `change` leaves as it is stays so, the nice value among it.
fn set_attributes(change: impl FnOnce(Attributes) -> Attributes) -> Result<(), Errno> {
    let attributes = Attributes { size: ATTRIBUTES_SIZE, ..change(Attributes::current()?) };
    // SAFETY: the kernel reads `attributes.size` bytes from a live, `repr(C)` value of exactly that size and
    // keeps no pointer.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, std::ptr::from_ref(&attributes), 0) };
    if result == 0 { Ok(()) } else { Err(Errno::last()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_only_watches_keeps_off_the_stages_core() {
        let cores = || {
            let allowed = sched_getaffinity(THIS_THREAD).unwrap();
            (0..CpuSet::count()).filter(|core| allowed.is_set(*core) == Ok(true)).collect::<Vec<_>>()
        };
        std::thread::spawn(move || {
            let (before, others) = (cores(), |cores: &[usize]| cores[..cores.len().max(2) - 1].to_vec());
            keep_off_the_stages_core();
            assert_eq!(cores(), others(&before));
            pin_to_one_core(&mut Vec::new());
            let alone = cores();
            keep_off_the_stages_core();
            assert_eq!(cores(), alone, "the only core was given up");
        })
        .join()
        .unwrap();
    }

    #[test]
    fn a_short_slice_leaves_the_nice_value_as_it_is() {
        // In a thread of its own, which alone becomes nicer.
        std::thread::spawn(|| {
            // SAFETY: takes numbers only.
            assert_eq!(unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, 7) }, 0);
            set_attributes(|attributes| attributes.short_slice(SHORT_SLICE_NS)).unwrap();
            assert_eq!(Attributes::current().unwrap().nice, 7);
        })
        .join()
        .unwrap();
    }
}
