//! Packets of samples at the right time, with what goes wrong.

use std::io::{self, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::{Console, Fault, Wearer};

/// Samples that are lost at a time by `--lose-every`.
const LOST_AT_A_TIME: u64 = 7;
/// Bytes of garbage.
const GARBAGE: usize = 1000;

/// How samples go out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Samples of each channel in a second.
    pub rate_hz: f64,
    /// Samples of each channel in a packet.
    pub packet_samples: u64,
    /// Some samples are lost every so often.
    pub lose_every: Option<Duration>,
}

/// Why nothing is sent any more: the other side stopped or is gone, or the amplifier is away for so long.
pub(crate) type Away = Duration;

/// Sends samples of `wearer`, written by `encode` (number of the sample, uV at the electrodes, packet), until `is_over`, the
/// other side is gone, or a fault ends the connection.
pub(crate) fn transmit(
    mut stream: &TcpStream,
    pace: Pace,
    wearer: &mut Wearer,
    console: &Console,
    is_over: &AtomicBool,
    mut encode: impl FnMut(u64, &[f32], &mut Vec<u8>),
) -> Away {
    let mut state = Transmission { faults: Faults::default(), began: Instant::now(), number: 0 };
    let mut packet = Vec::new();
    console.count_connection();
    while !is_over.load(Ordering::Relaxed) {
        while let Some(fault) = console.take_fault() {
            if let ControlFlow::Break(away) = state.faults.begin(fault, stream) {
                return away;
            }
        }
        if let Some(gesture) = console.take_gesture() {
            wearer.set_gesture(gesture);
        }
        let end = state.number + pace.packet_samples;
        let due = state.began + Duration::from_secs_f64(end as f64 / pace.rate_hz) + state.faults.lag;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        packet.clear();
        let mut sent = 0;
        for number in state.number..end {
            let is_lost = state.loses(number, pace);
            let mut microvolts = wearer.next_sample();
            if let Some(held) = state.faults.held(microvolts) {
                microvolts = held;
            }
            if !is_lost {
                encode(number, microvolts, &mut packet);
                sent += 1;
            }
        }
        state.number = end;
        console.count_samples(sent, pace.packet_samples - sent);
        let written = if state.faults.torn > 0 {
            state.faults.torn -= 1;
            packet.chunks(1).try_for_each(|byte| stream.write_all(byte))
        } else {
            stream.write_all(&packet)
        };
        if written.is_err() {
            return Duration::ZERO;
        }
    }
    Duration::ZERO
}

struct Transmission {
    faults: Faults,
    began: Instant,
    /// Of the next sample.
    number: u64,
}

impl Transmission {
    fn loses(&mut self, number: u64, pace: Pace) -> bool {
        let faults = &mut self.faults;
        if let Some(interval) = pace.lose_every {
            let interval_samples = (interval.as_secs_f64() * pace.rate_hz).max(1.0) as u64;
            if number >= interval_samples && number % interval_samples < LOST_AT_A_TIME {
                return true;
            }
        }
        if faults.lost > 0 {
            faults.lost -= 1;
            return true;
        }
        faults.silent_until.is_some_and(|until| Instant::now() < until)
    }
}

#[derive(Debug, Default)]
struct Faults {
    /// Samples that will be lost.
    lost: u64,
    /// Packets that will come byte by byte.
    torn: u64,
    silent_until: Option<Instant>,
    /// The electrodes, of which the first holds its value, until then.
    stuck: Option<(Instant, Vec<f32>)>,
    lag: Duration,
}

impl Faults {
    fn begin(&mut self, fault: Fault, stream: &TcpStream) -> ControlFlow<Away> {
        match fault {
            Fault::Lose(samples) => self.lost += samples,
            Fault::Torn(packets) => self.torn += packets,
            Fault::Silent(time) => self.silent_until = Some(Instant::now() + time),
            Fault::Stuck(time) => self.stuck = Some((Instant::now() + time, Vec::new())),
            Fault::Late(time) => self.lag += time,
            Fault::Garbage => {
                if write_garbage(stream).is_err() {
                    return ControlFlow::Break(Duration::ZERO);
                }
            }
            Fault::Away(time) => return ControlFlow::Break(time),
        }
        ControlFlow::Continue(())
    }
}

impl Faults {
    /// What is measured instead of these, while the first electrode holds its value.
    fn held(&mut self, microvolts: &[f32]) -> Option<&[f32]> {
        let (_, held) = self.stuck.as_mut().filter(|(until, _)| Instant::now() < *until)?;
        let first = held.first().copied().unwrap_or(microvolts[0]);
        held.clear();
        held.push(first);
        held.extend_from_slice(&microvolts[1..]);
        Some(held)
    }
}

/// Pseudo-random bytes, always the same.
fn write_garbage(mut stream: &TcpStream) -> io::Result<()> {
    let mut bits = 0x9E37_79B9_u32;
    let bytes: Vec<u8> = (0..GARBAGE)
        .map(|_| {
            bits ^= bits << 13;
            bits ^= bits >> 17;
            bits ^= bits << 5;
            bits as u8
        })
        .collect();
    stream.write_all(&bytes)
}
