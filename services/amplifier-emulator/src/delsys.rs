//! The Trigno SDK server.

use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use tendon_delsys::{Replies, SLOTS, command};

use crate::transmit::{Pace, transmit};
use crate::{Console, WearerOptions};

/// Time of a frame of the server.
const FRAME_INTERVAL: &str = "0.0135";
/// Samples of a frame.
const FRAME_SAMPLES: u64 = 27;
/// Their rate, Hz.
const RATE_HZ: f64 = 2000.0;
/// How long START waits for the data connection.
const DATA_CONNECTION: Duration = Duration::from_millis(500);
/// A client that takes nothing for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);

/// An emulated server.
#[derive(Debug)]
pub struct DelsysEmulator {
    /// Slots with a sensor, from 1.
    pub slots: Vec<usize>,
    /// Who wears them.
    pub wearer: WearerOptions,
    /// Keyboard and counts.
    pub console: Console,
}

/// The data connection that waits for START.
type Waiting = Arc<Mutex<Option<TcpStream>>>;

/// A run between START and STOP.
struct Run {
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<Duration>,
}

impl DelsysEmulator {
    /// Plays the server for ever, for one client at a time.
    ///
    /// # Errors
    ///
    /// When it cannot listen.
    pub fn run(
        &self,
        (address, command_port, emg_port): (IpAddr, u16, u16),
        announce: impl FnOnce(SocketAddr, SocketAddr),
    ) -> anyhow::Result<()> {
        let listen = |port| {
            let address = SocketAddr::new(address, port);
            TcpListener::bind(address)
                .with_context(|| format!("cannot listen on {address}: choose another port"))
        };
        let (commands, emg) = (listen(command_port)?, listen(emg_port)?);
        announce(commands.local_addr()?, emg.local_addr()?);
        let waiting = Waiting::default();
        let accepted = waiting.clone();
        std::thread::spawn(move || {
            for stream in emg.incoming().flatten() {
                *accepted.lock().unwrap_or_else(PoisonError::into_inner) = Some(stream);
            }
        });
        loop {
            let (stream, _) = commands.accept()?;
            // A client that hangs up in the middle of a word is gone as well as one that says QUIT.
            let away = self.serve(&stream, &waiting).unwrap_or_default();
            let _ = stream.shutdown(Shutdown::Both);
            // What it connected for data and did not start is of no use to the next one.
            waiting.lock().unwrap_or_else(PoisonError::into_inner).take();
            std::thread::sleep(away);
        }
    }

    /// Serves one client; gives how long the server is away after it.
    fn serve(&self, mut stream: &TcpStream, waiting: &Waiting) -> anyhow::Result<Duration> {
        stream.set_nodelay(true)?;
        stream.write_all(&command("Delsys Trigno System Digital Protocol Version 3.6.0 "))?;
        // So that the end of a run is seen though the client says nothing.
        stream.set_read_timeout(Some(Duration::from_millis(20)))?;
        let mut words = Replies::default();
        let mut run: Option<Run> = None;
        let mut buffer = [0; 1024];
        let away = loop {
            if let Some(ended) = run.take_if(|run| run.thread.is_finished()) {
                break ended.thread.join().unwrap_or_default();
            }
            match stream.read(&mut buffer) {
                Ok(0) => break Duration::ZERO,
                Ok(count) => words.push(&buffer[..count]),
                Err(error)
                    if matches!(
                        error.kind(),
                        std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                    ) => {}
                Err(_) => break Duration::ZERO,
            }
            let mut is_over = false;
            while let Some(word) = words.next_reply()? {
                is_over |= word == "QUIT";
                let reply = self.obey(&word, waiting, &mut run);
                stream.write_all(&command(&reply))?;
            }
            if is_over {
                break Duration::ZERO;
            }
        };
        stop(run);
        Ok(away)
    }

    fn obey(&self, word: &str, waiting: &Waiting, run: &mut Option<Run>) -> String {
        let sensor = |what: &str| {
            let number = word.strip_prefix("SENSOR ")?.strip_suffix(what)?.trim().parse::<usize>().ok()?;
            (1..=SLOTS).contains(&number).then_some(number)
        };
        if let Some(number) = sensor("PAIRED?") {
            return if self.slots.contains(&number) { "YES" } else { "NO" }.to_owned();
        }
        if let Some(number) = sensor("TYPE?") {
            return if self.slots.contains(&number) { "O" } else { "CANNOT COMPLETE" }.to_owned();
        }
        match word {
            "ENDIAN LITTLE"
            | "BACKWARDS COMPATIBILITY ON"
            | "UPSAMPLE ON"
            | "TRIGGER START OFF"
            | "TRIGGER STOP OFF"
                if run.is_none() =>
            {
                "OK"
            }
            "FRAME INTERVAL?" => FRAME_INTERVAL,
            "MAX SAMPLES EMG?" => return FRAME_SAMPLES.to_string(),
            "START" if run.is_none() => match self.start(waiting) {
                Some(started) => {
                    *run = Some(started);
                    "OK"
                }
                None => "CANNOT COMPLETE",
            },
            "STOP" if run.is_some() => {
                stop(run.take());
                "OK"
            }
            "QUIT" => "BYE",
            "STOP" | "START" | "ENDIAN LITTLE" => "CANNOT COMPLETE",
            _ => "INVALID COMMAND",
        }
        .to_owned()
    }

    /// Begins to send to the data connection, if there is one.
    fn start(&self, waiting: &Waiting) -> Option<Run> {
        let until = Instant::now() + DATA_CONNECTION;
        let stream = loop {
            // It may be connected and not yet accepted.
            match waiting.lock().unwrap_or_else(PoisonError::into_inner).take() {
                Some(stream) => break stream,
                None if Instant::now() < until => std::thread::sleep(Duration::from_millis(5)),
                None => return None,
            }
        };
        stream.set_nodelay(true).and_then(|()| stream.set_write_timeout(Some(WRITE_TIMEOUT))).ok()?;
        let mut wearer = self.wearer.open(RATE_HZ).ok()?;
        let (slots, console) = (self.slots.clone(), self.console.clone());
        let is_over = Arc::new(AtomicBool::new(false));
        let over = is_over.clone();
        let thread = std::thread::spawn(move || {
            let pace = Pace { rate_hz: RATE_HZ, packet_samples: FRAME_SAMPLES, lose_every: None };
            let encode =
                |_: u64, microvolts: &[f32], packet: &mut Vec<u8>| write_instant(&slots, microvolts, packet);
            let away = transmit(&stream, pace, &mut wearer, &console, &over, encode);
            let _ = stream.shutdown(Shutdown::Both);
            away
        });
        Some(Run { is_over, thread })
    }
}

fn stop(run: Option<Run>) {
    if let Some(run) = run {
        run.is_over.store(true, Ordering::Relaxed);
        // It ends with its next packet; one that panicked has ended.
        let _ = run.thread.join();
    }
}

/// Appends an instant, V: slots with a sensor have the electrodes in turn, the others are 0.
fn write_instant(slots: &[usize], microvolts: &[f32], packet: &mut Vec<u8>) {
    for slot in 1..=SLOTS {
        let electrode = slots.iter().position(|paired| *paired == slot);
        let volts = electrode.map_or(0.0, |electrode| microvolts[electrode % microvolts.len()] * 1e-6);
        packet.extend(volts.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_lie_in_the_columns_of_their_slots() {
        let mut packet = Vec::new();
        write_instant(&[2, 4], &[100.0, -50.0], &mut packet);
        let mut decoder = tendon_delsys::Decoder::new(RATE_HZ);
        let (_, volts) = decoder.push(&packet).unwrap();
        assert_eq!(volts[..5], [0.0, 100.0 * 1e-6, 0.0, -50.0 * 1e-6, 0.0]);
    }
}
