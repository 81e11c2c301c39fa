//! The direct way to the robot process, for whoever hears keys and signals.
//!
//! ```text
//! key, signal ─▶ RobotLine ─── stop, arm ──▶ robot's standard input ─┐
//!                    │                                               ├─▶ robot
//!                    └──────── end ─────────▶ SIGTERM ───────────────┘
//! loop turned? ─▶ heartbeat ── alive ───────▶ robot's standard input
//! ```
//!
//! Nothing here waits: neither for the supervisor's loop nor for the terminal nor for the robot. The heartbeat goes out
//! only while the loop turns, because an arm must not go on under a supervisor that hangs.

use std::fs::File;
use std::io::Write;
use std::os::fd::AsFd;
use std::process::ChildStdin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tendon_process::Order;
use tendon_transport::now_ns;

/// Longest turn of the supervisor's loop; after it there are no heartbeats.
pub const LOOP_LIMIT: Duration = Duration::from_millis(100);
/// A loop that has not turned for so long stands still: this process was suspended, or the machine is overloaded. A key that was
/// pressed before a stop must not count for what was seen after it, so this is less than the 200 ms that a key counts back.
const STANDSTILL: Duration = Duration::from_millis(150);
/// So long after a standstill, keys that were pressed in it may still come.
const AFTER_STANDSTILL: Duration = Duration::from_millis(500);
/// Time between two signs of life to the robot, which rests after four have not come.
const HEARTBEAT: Duration = Duration::from_millis(30);

#[derive(Debug)]
struct Robot {
    orders: Arc<File>,
    process: Pid,
}

/// Orders to the robot process that runs now. Clones are the same line.
#[derive(Clone, Debug, Default)]
pub struct RobotLine {
    robot: Arc<Mutex<Option<Robot>>>,
    is_ending: Arc<AtomicBool>,
    /// An order to stop came while no robot process was there: the next one begins with it.
    is_stopped: Arc<AtomicBool>,
    /// When the supervisor's loop last turned, CLOCK_MONOTONIC ns.
    turned_ns: Arc<AtomicU64>,
    /// When it last turned after it had stood still for [`STANDSTILL`].
    resumed_ns: Arc<AtomicU64>,
}

impl RobotLine {
    fn lock(&self) -> MutexGuard<'_, Option<Robot>> {
        self.robot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives an order to the robot. One that ends at this moment, or has hung for so long that its pipe is full, does not
    /// hear it. Where none is there yet the next one begins with an order to stop, whatever else came after it.
    pub fn order(&self, order: Order) {
        match &*self.lock() {
            // In one piece, as the heartbeat writes to the same pipe.
            Some(robot) => drop((&*robot.orders).write_all(format!("{}\n", order.line()).as_bytes())),
            None if order == Order::Stop => self.is_stopped.store(true, Ordering::Relaxed),
            None => {}
        }
    }

    /// Whether this process stands still, or did a moment ago: a key that is read now may have been pressed long before.
    pub fn stood_still(&self) -> bool {
        let age_ns = |since: &AtomicU64| u128::from(now_ns().saturating_sub(since.load(Ordering::Relaxed)));
        let has_resumed = self.resumed_ns.load(Ordering::Relaxed) > 0;
        age_ns(&self.turned_ns) > STANDSTILL.as_nanos()
            || has_resumed && age_ns(&self.resumed_ns) < AFTER_STANDSTILL.as_nanos()
    }

    /// Ends the session: the robot process stops the arm and ends, before anybody else is asked.
    pub fn end(&self) {
        self.is_ending.store(true, Ordering::Relaxed);
        if let Some(robot) = &*self.lock() {
            signal(robot.process);
        }
    }

    /// Whether the session is to end: that the robot process ends is then no fault.
    pub fn is_ending(&self) -> bool {
        self.is_ending.load(Ordering::Relaxed)
    }

    /// The supervisor's loop has turned.
    pub fn loop_turned(&self) {
        let now_ns = now_ns();
        let before_ns = self.turned_ns.swap(now_ns, Ordering::Relaxed);
        if before_ns > 0 && u128::from(now_ns.saturating_sub(before_ns)) > STANDSTILL.as_nanos() {
            self.resumed_ns.store(now_ns, Ordering::Relaxed);
        }
    }

    /// A robot process was started.
    pub(crate) fn connect(&self, orders: &ChildStdin, process: Pid) -> std::io::Result<()> {
        let orders = Arc::new(File::from(orders.as_fd().try_clone_to_owned()?));
        // A pipe that is full because the robot hangs holds nobody up.
        fcntl(&orders, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        // A process that is started stands still for nobody.
        self.turned_ns.store(now_ns(), Ordering::Relaxed);
        let mut robot = self.lock();
        if self.is_stopped.swap(false, Ordering::Relaxed) {
            (&*orders).write_all(format!("{}\n", Order::Stop.line()).as_bytes())?;
        }
        *robot = Some(Robot { orders: orders.clone(), process });
        drop(robot);
        if self.is_ending() {
            signal(process);
        }
        let turned_ns = self.turned_ns.clone();
        std::thread::Builder::new().name("heartbeat".to_owned()).spawn(move || beat(&orders, &turned_ns))?;
        Ok(())
    }

    /// The robot process is about to be reaped; then its number may be another's.
    pub(crate) fn disconnect(&self) {
        *self.lock() = None;
    }
}

fn signal(process: Pid) {
    // It is not reaped yet, so its number is its own; a dead one needs no signal.
    let _ = kill(process, Signal::SIGTERM);
    // One that was stopped with SIGSTOP hears nothing else before this.
    let _ = kill(process, Signal::SIGCONT);
}

/// Tells the robot again and again that the supervisor is there, while its loop turns.
fn beat(orders: &File, turned_ns: &AtomicU64) {
    let line = format!("{}\n", Order::Alive.line());
    loop {
        let age_ns = now_ns().saturating_sub(turned_ns.load(Ordering::Relaxed));
        let turns = u128::from(age_ns) <= LOOP_LIMIT.as_nanos();
        // It fails when the robot is gone.
        if turns && write_if_there_is_room(orders, line.as_bytes()).is_err() {
            return;
        }
        if !turns && is_gone(orders) {
            return;
        }
        std::thread::sleep(HEARTBEAT);
    }
}

fn is_gone(pipe: &File) -> bool {
    let mut looked_at = [PollFd::new(pipe.as_fd(), PollFlags::empty())];
    let _ = poll(&mut looked_at, PollTimeout::ZERO);
    looked_at[0].revents().unwrap_or(PollFlags::empty()).contains(PollFlags::POLLERR)
}

/// Writes this line unless it would be the last that fits the pipe: to a process that hangs, orders come through when it
/// goes on, and whoever gives them need not wait for that. (Linux takes a pipe whose last page is begun for full, and
/// small writes still go to that page: pipe(7), poll(2).)
fn write_if_there_is_room(mut pipe: &File, line: &[u8]) -> std::io::Result<()> {
    let mut looked_at = [PollFd::new(pipe.as_fd(), PollFlags::POLLOUT)];
    poll(&mut looked_at, PollTimeout::ZERO)?;
    let is = looked_at[0].revents().unwrap_or(PollFlags::empty());
    if is.intersects(PollFlags::POLLERR | PollFlags::POLLOUT) { pipe.write_all(line) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader, Read};
    use std::os::fd::OwnedFd;
    use std::process::{Child, Command, Stdio};

    use super::*;

    #[test]
    fn an_order_fits_the_pipe_of_a_process_that_hangs_however_many_heartbeats_came_before() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let mut writer = File::from(OwnedFd::from(writer));
        // A pipe holds 64 kB unless it is told otherwise.
        for _ in 0..100_000 {
            write_if_there_is_room(&writer, b"alive\n").unwrap();
        }
        writer.write_all(b"stop\n").unwrap();
        drop(writer);
        let mut lines = String::new();
        reader.read_to_string(&mut lines).unwrap();
        assert!(lines.ends_with("alive\nstop\n") && lines.len() < 100_000);
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        assert!(write_if_there_is_room(&File::from(OwnedFd::from(writer)), b"alive\n").is_err());
    }

    /// A process in the robot's place, its standard input, and what it hears there.
    fn stand_in() -> (Child, ChildStdin, impl Iterator<Item = String>) {
        let mut robot = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let input = robot.stdin.take().unwrap();
        let lines = BufReader::new(robot.stdout.take().unwrap()).lines().map_while(Result::ok);
        (robot, input, lines)
    }

    #[test]
    fn a_stop_before_the_robot_is_there_is_the_first_that_it_hears() {
        let (mut robot, input, mut lines) = stand_in();
        let line = RobotLine::default();
        line.order(Order::Stop);
        line.order(Order::Arm { seen_ns: 5 });
        line.connect(&input, Pid::from_raw(robot.id() as i32)).unwrap();
        assert_eq!(lines.next().as_deref(), Some("stop"));
        assert_eq!(lines.next().as_deref(), Some("alive"));
        line.end();
        robot.wait().unwrap();
    }

    #[test]
    fn a_loop_that_stood_still_is_known_for_a_while_after_it() {
        let line = RobotLine::default();
        line.loop_turned();
        assert!(!line.stood_still());
        let before_ns = now_ns() - STANDSTILL.as_nanos() as u64 - 1;
        line.turned_ns.store(before_ns, Ordering::Relaxed);
        assert!(line.stood_still());
        line.loop_turned();
        assert!(line.stood_still());
        line.resumed_ns.store(now_ns() - AFTER_STANDSTILL.as_nanos() as u64, Ordering::Relaxed);
        assert!(!line.stood_still());
    }

    #[test]
    fn there_are_heartbeats_only_while_the_loop_turns_and_orders_pass_all_the_same() {
        let (mut robot, input, mut lines) = stand_in();
        let line = RobotLine::default();
        line.connect(&input, Pid::from_raw(robot.id() as i32)).unwrap();
        assert_eq!(lines.next().as_deref(), Some("alive"));
        // The loop hangs from here on: the last heartbeats are under way, then none comes but the order.
        std::thread::sleep(LOOP_LIMIT + 3 * HEARTBEAT);
        line.order(Order::Stop);
        assert_eq!(lines.find(|line| line != "alive").as_deref(), Some("stop"));
        std::thread::sleep(3 * HEARTBEAT);
        line.order(Order::Arm { seen_ns: 5 });
        assert_eq!(lines.next().as_deref(), Some("arm 5"), "a heartbeat though the loop hangs");
        line.loop_turned();
        assert_eq!(lines.next().as_deref(), Some("alive"));
        line.end();
        assert!(line.is_ending());
        robot.wait().unwrap();
    }
}
