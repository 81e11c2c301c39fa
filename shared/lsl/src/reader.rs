//! A thread that reads a stream, and looks for it when it is lost.
//!
//! ```text
//! Inlet ─ pull ─▶ thread ── socket: head, stamps, samples ──▶ Reader::next_frame      the descriptor becomes readable
//!   ▲ lost, silent │
//!   └── find, describe, compare, open, measure its clock ◀┘
//! ```
//!
//! liblsl waits inside its own calls, which no descriptor shows. So a thread waits there and hands over through a socket. If
//! the other side is slow, the thread waits, and liblsl keeps 10 s of samples.

use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::{Inlet, Lsl, LslError, LslSettings, Stream, StreamFacts};

/// Most samples in a frame.
const MOST_SAMPLES: usize = 256;
/// Most values in a frame.
const MOST_VALUES: usize = 16_384;
/// Longest wait for a sample between two looks at the rest.
const PULL_WAIT: Duration = Duration::from_millis(50);
/// So long without a sample, a stream counts as lost. The arm has stopped long before: it needs a command every 150 ms.
const SILENCE: Duration = Duration::from_millis(400);
/// Time between two looks for a stream that is lost.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);
/// How long it may take to answer such a look: liblsl asks each port of known peers only after 0.5 s.
const LOOK: Duration = Duration::from_millis(1200);
/// How long a stream may take to answer each time.
const ANSWER: Duration = Duration::from_secs(1);
/// How long the clock of a stream may take: it is measured by a series of questions.
const CLOCK_ANSWER: Duration = Duration::from_secs(3);
/// Time between two looks at the clock's correction, which liblsl renews every 2 s.
const CORRECTION_INTERVAL: Duration = Duration::from_secs(1);
/// 64-bit words before the stamps of a frame.
const HEAD: usize = 3;

/// Samples that came together.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Whether they are the first ones of another connection: the stream was lost before.
    pub is_new_connection: bool,
    /// Is added to the stamps to have them on our clock, s.
    pub correction_s: f64,
    /// When they came, CLOCK_MONOTONIC ns.
    pub received_ns: u64,
    /// The sender's time of each sample, s of its clock.
    pub stamps: &'a [f64],
    /// `[samples × channels of the stream]`.
    pub instants: &'a [f32],
}

/// A stream that is read by a thread. Dropping it ends the thread.
#[derive(Debug)]
pub struct Reader {
    socket: UnixStream,
    channels: usize,
    /// A frame as it comes, in 64-bit words.
    frame: Vec<u64>,
    /// Bytes of it that have come.
    filled: usize,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Reader {
    /// Reads `inlet`, which is open, from now on: what came before is passed over. `stream` is what it says, `correction_s` what
    /// it said of its clock when it was opened. When it is lost, also before this call, it is looked for by its name, type and
    /// source id.
    ///
    /// # Errors
    ///
    /// [`LslError::Thread`] when the system grants no thread or socket.
    pub fn start(
        lsl: Lsl,
        inlet: Inlet,
        stream: &StreamFacts,
        correction_s: f64,
    ) -> Result<Reader, LslError> {
        let (socket, sender) = UnixStream::pair().map_err(LslError::Thread)?;
        socket.set_nonblocking(true).map_err(LslError::Thread)?;
        let channels = stream.channels;
        let room = (MOST_VALUES / channels.max(1)).clamp(1, MOST_SAMPLES);
        let words = HEAD + room + (room * channels).div_ceil(2);
        let stop = Arc::new(AtomicBool::new(false));
        let mut pump = Pump {
            lsl,
            again: again(stream),
            stream: stream.clone(),
            sender,
            stop: stop.clone(),
            frame: vec![0; words],
            stamps: vec![0.0; room],
            instants: vec![0.0; room * channels],
            // The newest one, if the stream is still there.
            correction_s: inlet.time_correction(Duration::ZERO).unwrap_or(correction_s),
            corrected: Instant::now(),
            heard: Instant::now(),
            looked: Instant::now(),
            is_lost: false,
            is_new_connection: false,
            refusal: String::new(),
        };
        let thread = std::thread::Builder::new().name("lsl".to_owned()).spawn(move || pump.run(inlet));
        let thread = Some(thread.map_err(LslError::Thread)?);
        Ok(Reader { socket, channels, frame: vec![0; words], filled: 0, stop, thread })
    }

    /// The next samples, if they have come. Does not wait and allocates nothing.
    ///
    /// # Errors
    ///
    /// When the thread has ended.
    pub fn next_frame(&mut self) -> std::io::Result<Option<Frame<'_>>> {
        let mut length = HEAD;
        loop {
            if self.filled >= HEAD * size_of::<u64>() {
                length = frame_words(head_samples(self.frame[2]), self.channels);
            }
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.frame[..length]);
            if self.filled == bytes.len() {
                break;
            }
            match self.socket.read(&mut bytes[self.filled..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => self.filled += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        self.filled = 0;
        let samples = head_samples(self.frame[2]);
        let (head, rest) = self.frame[..length].split_at(HEAD);
        let (stamps, values) = rest.split_at(samples);
        Ok(Some(Frame {
            is_new_connection: head[2] >> 32 != 0,
            correction_s: f64::from_bits(head[0]),
            received_ns: head[1],
            stamps: bytemuck::cast_slice(stamps),
            instants: &bytemuck::cast_slice(values)[..samples * self.channels],
        }))
    }
}

impl AsFd for Reader {
    /// Readable when samples have come.
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The thread may wait to hand over.
        let _ = self.socket.shutdown(std::net::Shutdown::Both);
        // liblsl must not be inside a call when the process ends and its variables go.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn head_samples(word: u64) -> usize {
    (word & 0xffff_ffff) as usize
}

fn frame_words(samples: usize, channels: usize) -> usize {
    HEAD + samples + (samples * channels).div_ceil(2)
}

/// What finds this stream, and no other, when it was started again.
fn again(stream: &StreamFacts) -> LslSettings {
    LslSettings {
        name: stream.name.clone(),
        content_type: stream.content_type.clone(),
        source_id: stream.source_id.clone(),
        ..LslSettings::default()
    }
}

/// The thread's side.
struct Pump {
    lsl: Lsl,
    /// How it is found again.
    again: LslSettings,
    /// What the stream was at first, and has to be when it comes back.
    stream: StreamFacts,
    sender: UnixStream,
    stop: Arc<AtomicBool>,
    frame: Vec<u64>,
    stamps: Vec<f64>,
    instants: Vec<f32>,
    correction_s: f64,
    corrected: Instant,
    /// When the last sample came.
    heard: Instant,
    /// When the stream was last looked for.
    looked: Instant,
    is_lost: bool,
    is_new_connection: bool,
    /// Why a stream that was found was not taken, as it was last said.
    refusal: String,
}

impl Pump {
    fn run(&mut self, inlet: Inlet) {
        let mut inlet = Some(inlet);
        if let Some(inlet) = &mut inlet {
            // What waited since the stream was opened came before the session began.
            while let Ok(1..) = inlet.pull(&mut self.instants, &mut self.stamps, Duration::ZERO) {}
        }
        self.heard = Instant::now();
        while !self.stop.load(Ordering::Relaxed) {
            let pulled =
                inlet.as_mut().map(|inlet| inlet.pull(&mut self.instants, &mut self.stamps, PULL_WAIT));
            match pulled {
                Some(Ok(0)) => {
                    if self.heard.elapsed() > SILENCE {
                        self.lost("sends no samples");
                        self.look(&mut inlet);
                    }
                }
                Some(Ok(samples)) => {
                    self.found_again();
                    self.renew_correction(inlet.as_ref());
                    if self.hand_over(samples).is_err() {
                        return;
                    }
                }
                Some(Err(_)) => {
                    inlet = None;
                    self.lost("has ended, or the connection to it");
                }
                None => {
                    self.look(&mut inlet);
                    std::thread::sleep(PULL_WAIT);
                }
            }
        }
    }

    /// Says once that the stream is lost.
    fn lost(&mut self, how: &str) {
        if !std::mem::replace(&mut self.is_lost, true) {
            tracing::warn!(
                "LSL: the stream {} {how}: the arm stops. Is its program still running, and its computer reachable? It is looked \
                 for until it is back",
                self.stream
            );
        }
    }

    fn found_again(&mut self) {
        self.heard = Instant::now();
        if std::mem::replace(&mut self.is_lost, false) {
            self.refusal.clear();
            tracing::warn!("LSL: the stream {} is back", self.stream);
        }
    }

    /// Looks for the stream, if the last look is some time ago. The same one, still there, is left as it is.
    fn look(&mut self, inlet: &mut Option<Inlet>) {
        if self.looked.elapsed() < LOOK_INTERVAL {
            return;
        }
        let found = self.lsl.find_first(&self.again, LOOK).unwrap_or_default();
        self.looked = Instant::now();
        let same = |stream: &&Stream| stream.facts.uid == self.stream.uid;
        if inlet.is_some() && found.iter().any(|stream| same(&stream)) {
            return;
        }
        let stream = match &found[..] {
            [] => return,
            [only] => only,
            several => {
                let list: Vec<String> = several.iter().map(|stream| stream.facts.to_string()).collect();
                return self
                    .refuse(format!("several could be it: {}. Let only one of them run", list.join("; ")));
            }
        };
        if self.stop.load(Ordering::Relaxed) {
            return;
        }
        // The old connection may only look alive.
        *inlet = None;
        match self.connect(stream) {
            Ok(opened) => *inlet = Some(opened),
            Err(refusal) => self.refuse(refusal),
        }
    }

    /// Says once why a stream that was found is not taken.
    fn refuse(&mut self, refusal: String) {
        if refusal != self.refusal {
            tracing::warn!("LSL: the stream {} is not back: {refusal}", self.stream);
            self.refusal = refusal;
        }
    }

    /// Connects to a stream that must be what the lost one was, but for who sends it.
    fn connect(&mut self, stream: &Stream) -> Result<Inlet, String> {
        let said = |error: LslError| error.to_string();
        let mut inlet = Inlet::new(self.lsl, stream).map_err(said)?;
        let described = inlet.describe(ANSWER).map_err(said)?.facts.clone();
        let before = &self.stream;
        if described.channels != before.channels || described.channel_facts != before.channel_facts {
            return Err(format!(
                "its channels have changed ({described}): end the session, and start it with these"
            ));
        }
        if described.sample_rate_hz != before.sample_rate_hz || described.format != before.format {
            return Err(format!(
                "its rate or format has changed ({described}): end the session, and start it with these"
            ));
        }
        inlet.open(ANSWER).map_err(said)?;
        self.correction_s = inlet.time_correction(CLOCK_ANSWER).map_err(said)?;
        self.corrected = Instant::now();
        self.heard = Instant::now();
        self.stream = described;
        self.is_new_connection = true;
        Ok(inlet)
    }

    fn renew_correction(&mut self, inlet: Option<&Inlet>) {
        if self.corrected.elapsed() < CORRECTION_INTERVAL {
            return;
        }
        self.corrected = Instant::now();
        // Without an answer the old one holds.
        if let Some(Ok(correction_s)) = inlet.map(|inlet| inlet.time_correction(Duration::ZERO)) {
            self.correction_s = correction_s;
        }
    }

    /// Writes what was pulled into the socket; waits while it is full.
    fn hand_over(&mut self, samples: usize) -> std::io::Result<()> {
        let channels = self.stream.channels;
        let length = frame_words(samples, channels);
        let frame = &mut self.frame[..length];
        frame[0] = self.correction_s.to_bits();
        frame[1] = (self.lsl.clock_s() * 1e9) as u64;
        frame[2] = samples as u64 | u64::from(std::mem::take(&mut self.is_new_connection)) << 32;
        let (stamps, values) = frame[HEAD..].split_at_mut(samples);
        stamps.copy_from_slice(bytemuck::cast_slice(&self.stamps[..samples]));
        let values: &mut [f32] = bytemuck::cast_slice_mut(values);
        values[..samples * channels].copy_from_slice(&self.instants[..samples * channels]);
        self.sender.write_all(bytemuck::cast_slice(&self.frame[..length]))
    }
}
