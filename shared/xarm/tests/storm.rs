//! The client against a server that sends damaged replies and reports: no panic, no hang, bounded memory.
//!
//! `cargo test --release -p tendon-xarm --test storm -- --ignored --nocapture` sends ten million frames.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_xarm::{Client, ClientSettings, Mode, Velocity};

/// What does not come within this time never does.
const WATCHDOG: Duration = Duration::from_secs(60);
/// Frames between two breaks of a connection.
const FRAMES_A_CONNECTION: u64 = 20_000;

/// Where the server's frames come from: the same each time.
struct Frames(Xoshiro256PlusPlus);

impl Frames {
    fn next(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A frame of up to 40 bytes after its length, a third of them damaged.
    fn reply(&mut self, transaction: u16, into: &mut Vec<u8>) {
        let start = into.len();
        let parameters = self.next() as usize % 40;
        let register = [0x0B, 0x0C, 0x0F, 0x10, 0x13, 0x52, 0x51, 0x7C, 0xFF][self.next() as usize % 9];
        into.extend(transaction.to_be_bytes());
        into.extend([0, 2]);
        into.extend((parameters as u16 + 2).to_be_bytes());
        into.extend([register, [0, 0, 0, 0x10, 0x40, 0x08][self.next() as usize % 6]]);
        into.extend((0..parameters).map(|_| self.next() as u8));
        self.damage(into, start);
    }

    /// A report of a length that the arm sends, a third of them damaged.
    fn report(&mut self, into: &mut Vec<u8>) {
        let start = into.len();
        let length = [87_u32, 135, 133, 145][self.next() as usize % 4];
        into.extend(length.to_be_bytes());
        into.extend((4..length).map(|_| self.next() as u8));
        self.damage(into, start);
    }

    fn damage(&mut self, frame: &mut [u8], start: usize) {
        if self.next().is_multiple_of(3) {
            let place = start + self.next() as usize % (frame.len() - start);
            frame[place] = self.next() as u8;
        }
    }
}

#[derive(Default)]
struct Storm {
    frames: AtomicU64,
    is_over: AtomicBool,
}

impl Storm {
    /// Sends frames on one connection until it is broken, or the storm is over.
    fn rage(&self, stream: &mut TcpStream, bits: &mut Frames, is_control: bool) -> std::io::Result<()> {
        let (mut sent, mut request, mut piece) = (0, [0; 4096], Vec::new());
        let mut transaction = 1;
        stream.set_nonblocking(true)?;
        while sent < FRAMES_A_CONNECTION && !self.is_over.load(Ordering::Relaxed) {
            piece.clear();
            match stream.read(&mut request) {
                Ok(0) => return Ok(()),
                Ok(length) if length >= 7 => {
                    transaction = u16::from_be_bytes([request[0], request[1]]);
                    // Else it would never be sent a motion.
                    if is_control && matches!(request[6], 0x01 | 0x02) {
                        stream.write_all(&Storm::identity(transaction, request[6]))?;
                    }
                }
                _ => {}
            }
            for _ in 0..50 {
                if is_control {
                    let guess = if bits.next().is_multiple_of(4) { bits.next() as u16 } else { transaction };
                    bits.reply(guess, &mut piece);
                } else {
                    bits.report(&mut piece);
                }
            }
            stream.set_nonblocking(false)?;
            stream.write_all(&piece)?;
            stream.set_nonblocking(true)?;
            sent += 50;
            self.frames.fetch_add(50, Ordering::Relaxed);
        }
        Ok(())
    }

    /// The reply of an xArm7 that is asked who it is.
    fn identity(transaction: u16, register: u8) -> [u8; 48] {
        let mut reply = [0; 48];
        reply[..2].copy_from_slice(&transaction.to_be_bytes());
        reply[2..8].copy_from_slice(&[0, 2, 0, 42, register, 0]);
        let text: &[u8] = if register == 1 { b"7,7,XI1305,AC1305,v2.5.0" } else { b"XI130506D01L04" };
        reply[8..8 + text.len()].copy_from_slice(text);
        reply
    }

    /// Answers every request as a quiet arm does.
    fn calm(stream: &mut TcpStream) -> std::io::Result<()> {
        stream.set_nonblocking(false)?;
        let mut request = [0; 4096];
        loop {
            let length = stream.read(&mut request)?;
            if length < 7 {
                return Ok(());
            }
            stream.write_all(&[request[0], request[1], 0, 2, 0, 4, request[6], 0, 0, 0])?;
        }
    }

    fn serve(self: &Arc<Storm>, seed: u64, is_control: bool) -> SocketAddr {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        let storm = Arc::clone(self);
        std::thread::spawn(move || {
            let mut bits = Frames(Xoshiro256PlusPlus::seed_from_u64(seed));
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                // A client that hangs up is what storms are for.
                let _ = if storm.is_over.load(Ordering::Relaxed) {
                    Storm::calm(&mut stream)
                } else {
                    storm.rage(&mut stream, &mut bits, is_control)
                };
            }
        });
        address
    }
}

fn resident_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}

fn survive(frames: u64) {
    let storm = Arc::new(Storm::default());
    let settings = ClientSettings {
        control: storm.serve(1, true),
        normal_report: storm.serve(2, false),
        real_time_report: storm.serve(3, false),
        reconnect_period: Duration::from_millis(1),
        ..ClientSettings::new(Ipv4Addr::LOCALHOST.into())
    };
    let client = Client::start(settings).unwrap();
    let mut bits = Frames(Xoshiro256PlusPlus::seed_from_u64(4));
    let before_mb = resident_mb();
    let (mut newest, mut newest_at) = (0, Instant::now());
    while newest < frames {
        match bits.next() % 64 {
            0 => client.arm(Mode::CartesianVelocity),
            1 => client.stop(),
            2 => client.move_gripper(bits.next() as i32),
            _ => client.follow(Velocity::Flange([1.0; 6])),
        }
        std::thread::sleep(Duration::from_micros(200));
        let sent = storm.frames.load(Ordering::Relaxed);
        if sent > newest {
            (newest, newest_at) = (sent, Instant::now());
        }
        assert!(newest_at.elapsed() < WATCHDOG, "the client takes no frames any more: {:?}", client.status());
    }
    let grown_mb = resident_mb().saturating_sub(before_mb);
    assert!(grown_mb < 20, "the client grew by {grown_mb} MB");
    let stormy = client.status();
    assert!(stormy.connections > 1 && stormy.late_replies > 0 && stormy.garbage_bytes > 0, "{stormy:?}");
    // All of its threads are well: it is connected anew and heard.
    storm.is_over.store(true, Ordering::Relaxed);
    client.stop();
    let begun = Instant::now();
    while client.status().stops_acknowledged <= stormy.stops_acknowledged {
        assert!(begun.elapsed() < WATCHDOG, "no stop arrives after the storm: {:?}", client.status());
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn the_client_survives_a_storm() {
    survive(100_000);
}

#[test]
#[ignore = "ten million frames take minutes"]
fn the_client_survives_a_long_storm() {
    survive(10_000_000);
}
