//! How a process is told what to do, and its one blocking wait.
//!
//! A supervisor writes orders to the process's standard input, a line each. The end of that input means that the
//! supervisor is gone: the process stops. SIGINT and SIGTERM stop it as well. The robot takes orders from a socket, too.
//!
//! A signal overtakes orders that were written before it. So the process ends only once it has read what there is, and an
//! order to stop the arm that was given before the end is not lost.

use std::collections::VecDeque;
use std::io::PipeReader;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};
use tendon_transport::{SessionName, now_ns};

use crate::answer::Answer;
use crate::error::ProcessError;
use crate::orders::{Asker, MAXIMUM_LINE_LENGTH, Order, OrderSocket};

/// Why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wake {
    /// The process is to stop. No order to stop the arm is left that came before.
    Stop,
    /// There is a message.
    Message,
    /// The supervisor, or somebody at the socket, says something.
    Order(Order),
    /// The deadline has come.
    Deadline,
}

/// Orders, signals and the wait for them, messages and time.
#[derive(Debug)]
pub struct Control {
    stop: Arc<AtomicBool>,
    signal_pipe: PipeReader,
    line: Vec<u8>,
    /// Orders that came while nobody could obey them.
    kept: VecDeque<Order>,
    socket: Option<OrderSocket>,
    is_abandoned: bool,
}

impl Control {
    /// Takes over SIGINT, SIGTERM and standard input.
    ///
    /// # Errors
    ///
    /// When the system grants no pipe or handler.
    pub fn install() -> Result<Control, ProcessError> {
        let stop = Arc::new(AtomicBool::new(false));
        // A limit on the size of files is then an error of writing that says so, and no silent end.
        signal_hook::flag::register(SIGXFSZ, Arc::default()).map_err(ProcessError::Signals)?;
        let (signal_pipe, signal_end) = std::io::pipe().map_err(ProcessError::Signals)?;
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, stop.clone()).map_err(ProcessError::Signals)?;
            let end = signal_end.try_clone().map_err(ProcessError::Signals)?;
            signal_hook::low_level::pipe::register(signal, end).map_err(ProcessError::Signals)?;
        }
        Ok(Control {
            stop,
            signal_pipe,
            line: Vec::with_capacity(MAXIMUM_LINE_LENGTH),
            kept: VecDeque::new(),
            socket: None,
            is_abandoned: false,
        })
    }

    /// Takes orders for `session` from now on by its socket, too.
    ///
    /// # Errors
    ///
    /// When the socket cannot be made.
    pub fn listen(&mut self, session: &SessionName) -> Result<(), ProcessError> {
        self.socket = Some(OrderSocket::open(session)?);
        Ok(())
    }

    /// Gives these orders once more, before any that come.
    pub fn keep(&mut self, orders: impl IntoIterator<Item = Order>) {
        self.kept.extend(orders);
    }

    /// Who gave the newest order by the socket, and waits for an answer. The supervisor reads it in the state.
    pub fn take_asker(&mut self) -> Option<Asker> {
        self.socket.as_mut()?.take_asker()
    }

    /// Tells somebody what came of an order.
    pub fn answer(&mut self, asker: &Asker, answer: &Answer) {
        if let Some(socket) = &mut self.socket {
            socket.answer(asker, answer);
        }
    }

    /// Whether standard input came to its end: the supervisor is gone, by whatever cause.
    pub fn is_abandoned(&self) -> bool {
        self.is_abandoned
    }

    /// Set when the process is to stop; shared with whatever may have to give up waiting for it.
    pub fn stop_flag(&self) -> Arc<AtomicBool> {
        self.stop.clone()
    }

    /// Whether the process is to stop.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sleeps until there is a message at `input`, an order, a signal, or the clock reaches `deadline_ns`
    /// (CLOCK_MONOTONIC). A deadline that has passed ends the wait at once, after messages.
    ///
    /// # Errors
    ///
    /// When the kernel refuses to poll.
    pub fn wait(
        &mut self,
        input: Option<BorrowedFd<'_>>,
        deadline_ns: Option<u64>,
    ) -> Result<Wake, ProcessError> {
        loop {
            if self.is_stopped() {
                return Ok(self.last_stop()?.map_or(Wake::Stop, Wake::Order));
            }
            if let Some(order) = self.take_order() {
                return Ok(Wake::Order(order));
            }
            let standard_input = std::io::stdin();
            let sockets = self.socket.as_ref().map(OrderSocket::descriptors).unwrap_or_default();
            // Without a socket or an input the signals stand in for it: being stopped is asked first below.
            let [private, public, input] =
                [sockets[0], sockets[1], input].map(|given| given.unwrap_or(self.signal_pipe.as_fd()));
            let mut descriptors = [
                PollFd::new(self.signal_pipe.as_fd(), PollFlags::POLLIN),
                PollFd::new(standard_input.as_fd(), PollFlags::POLLIN),
                PollFd::new(private, PollFlags::POLLIN),
                PollFd::new(public, PollFlags::POLLIN),
                PollFd::new(input, PollFlags::POLLIN),
            ];
            let timeout: Option<TimeSpec> = deadline_ns.map(|deadline_ns| {
                std::time::Duration::from_nanos(deadline_ns.saturating_sub(now_ns())).into()
            });
            match ppoll(&mut descriptors, timeout, None) {
                Ok(0) => return Ok(Wake::Deadline),
                Ok(_) => {}
                Err(Errno::EINTR) => continue,
                Err(error) => return Err(ProcessError::Wait(error)),
            }
            let is_ready = |descriptor: &PollFd<'_>| descriptor.any() == Some(true);
            let [signals, orders, privately, publicly, messages] = descriptors.each_ref().map(is_ready);
            if orders {
                self.read_orders()?;
                continue;
            }
            if signals {
                self.stop.store(true, Ordering::Relaxed);
                continue;
            }
            if (privately || publicly)
                && let Some(order) = self.socket.as_mut().and_then(OrderSocket::receive)
            {
                return Ok(Wake::Order(order));
            }
            // Whatever strangers send, messages and time go on.
            if messages {
                return Ok(Wake::Message);
            }
            if deadline_ns.is_some_and(|deadline_ns| deadline_ns <= now_ns()) {
                return Ok(Wake::Deadline);
            }
        }
    }

    /// The next order to stop the arm among all that have come; the others are passed over. For a process that is about to
    /// end. It does not wait.
    ///
    /// # Errors
    ///
    /// When standard input cannot be read.
    pub fn last_stop(&mut self) -> Result<Option<Order>, ProcessError> {
        loop {
            while let Some(order) = self.take_order() {
                if order.stops_the_arm() {
                    return Ok(Some(order));
                }
            }
            if self.has_input()? {
                self.read_orders()?;
                continue;
            }
            match self.socket.as_mut().and_then(OrderSocket::receive) {
                Some(order) if order.stops_the_arm() => return Ok(Some(order)),
                Some(_) => self.refuse_at_the_end(),
                None => return Ok(None),
            }
        }
    }

    /// Tells whoever gave the newest order that it comes too late.
    fn refuse_at_the_end(&mut self) {
        if let Some(asker) = self.take_asker() {
            self.answer(
                &asker,
                &Answer::refused("not armed: the session is ending").with_key("session-ending"),
            );
        }
    }

    /// Takes no more orders by the socket; those that have come can still be taken, and answered. Whoever gives one from
    /// now on is told that there is no such session.
    pub fn stop_listening(&mut self) {
        if let Some(socket) = &self.socket {
            socket.close();
        }
    }

    /// Whether standard input can be read without waiting, and has not come to its end before.
    fn has_input(&self) -> Result<bool, ProcessError> {
        if self.is_abandoned {
            return Ok(false);
        }
        let standard_input = std::io::stdin();
        let mut looked_at = [PollFd::new(standard_input.as_fd(), PollFlags::POLLIN)];
        match ppoll(&mut looked_at, Some(std::time::Duration::ZERO.into()), None) {
            Ok(_) => Ok(looked_at[0].any() == Some(true)),
            Err(Errno::EINTR) => Ok(true),
            Err(error) => Err(ProcessError::Wait(error)),
        }
    }

    /// The next order that was kept or read so far; lines that are no order of ours are passed over.
    fn take_order(&mut self) -> Option<Order> {
        if let Some(order) = self.kept.pop_front() {
            return Some(order);
        }
        loop {
            let end = self.line.iter().position(|byte| *byte == b'\n')?;
            let order = std::str::from_utf8(&self.line[..end]).ok().and_then(Order::parse);
            self.line.drain(..=end);
            if order.is_some() {
                return order;
            }
        }
    }

    fn read_orders(&mut self) -> Result<(), ProcessError> {
        if self.line.len() >= MAXIMUM_LINE_LENGTH {
            self.line.clear();
        }
        let mut bytes = [0; MAXIMUM_LINE_LENGTH];
        let room = MAXIMUM_LINE_LENGTH - self.line.len();
        match nix::unistd::read(std::io::stdin().as_fd(), &mut bytes[..room]) {
            Ok(0) => {
                self.is_abandoned = true;
                self.stop.store(true, Ordering::Relaxed);
            }
            Ok(count) => self.line.extend_from_slice(&bytes[..count]),
            Err(Errno::EINTR | Errno::EAGAIN) => {}
            Err(error) => return Err(ProcessError::Orders(error)),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use nix::sys::signal::{Signal, raise};

    use super::*;

    #[test]
    fn an_order_to_stop_the_arm_that_came_before_the_end_is_given_before_it() {
        let (reader, mut supervisor) = std::io::pipe().unwrap();
        nix::unistd::dup2_stdin(&reader).unwrap();
        let mut control = Control::install().unwrap();
        supervisor.write_all(b"alive\n").unwrap();
        assert_eq!(control.wait(None, None).unwrap(), Wake::Order(Order::Alive));
        // More than is read in one piece.
        supervisor.write_all(&b"alive\n".repeat(100)).unwrap();
        supervisor.write_all(b"stop\narm 1\n").unwrap();
        raise(Signal::SIGTERM).unwrap();
        assert_eq!(control.wait(None, None).unwrap(), Wake::Order(Order::Stop));
        assert_eq!(control.wait(None, None).unwrap(), Wake::Stop);
        control.keep([Order::Start, Order::Stop]);
        assert_eq!(control.wait(None, None).unwrap(), Wake::Order(Order::Stop));
        supervisor.write_all(b"stage-ended\n").unwrap();
        assert!(!control.is_abandoned());
        drop(supervisor);
        assert_eq!(control.wait(None, None).unwrap(), Wake::Order(Order::StageEnded));
        assert_eq!(control.wait(None, None).unwrap(), Wake::Stop);
        assert!(control.is_abandoned());
    }
}
