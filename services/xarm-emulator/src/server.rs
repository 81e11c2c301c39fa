//! The emulator on the network: each control or report connection has its own thread.

use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use tendon_xarm::command::register;
use tendon_xarm::frame::Decoder;
use tendon_xarm::report::Kind;

use crate::fault::{Fault, ReplyFault, ReplyFaults};
use crate::model::code;
use crate::{Model, Properties, answer};

/// Address and ports of the emulator. Port 0 picks a free one.
#[derive(Clone, Copy, Debug)]
pub struct Listen {
    /// Default 127.0.0.1. Anybody who can reach it can move the arm.
    pub address: IpAddr,
    /// Control. Default 502.
    pub control_port: u16,
    /// Normal reports, 5 Hz. Default 30001.
    pub normal_report_port: u16,
    /// Rich reports, 5 Hz. Default 30002.
    pub rich_report_port: u16,
    /// Real-time reports, 100 Hz. Default 30003.
    pub real_time_report_port: u16,
}

impl Default for Listen {
    fn default() -> Listen {
        Listen {
            address: Ipv4Addr::LOCALHOST.into(),
            control_port: 502,
            normal_report_port: Kind::Normal.port(),
            rich_report_port: Kind::Rich.port(),
            real_time_report_port: Kind::RealTime.port(),
        }
    }
}

impl Listen {
    /// Free ports on the loopback address.
    pub fn anywhere() -> Listen {
        let address = Ipv4Addr::LOCALHOST.into();
        Listen {
            address,
            control_port: 0,
            normal_report_port: 0,
            rich_report_port: 0,
            real_time_report_port: 0,
        }
    }
}

/// Where the rich report has the number of the model and that of the axes.
const RICH_MODEL: usize = 145;
const RICH_AXES: usize = 146;

/// A running emulator; it ends when dropped.
#[derive(Debug)]
pub struct Emulator {
    shared: Arc<Shared>,
    /// Its address and the ports that it got.
    pub listen: Listen,
}

#[derive(Debug)]
struct Shared {
    started: Instant,
    model: Mutex<Model>,
    reply_faults: Mutex<ReplyFaults>,
    gripper_requests: AtomicU64,
    connections: Mutex<Vec<TcpStream>>,
    ended: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What lies behind these locks is whole at every moment.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Emulator {
    /// Listens on all ports, as the arm of [`Properties::default`].
    ///
    /// # Errors
    /// If a port is taken or not permitted; the message says what to do.
    pub fn start(listen: Listen) -> anyhow::Result<Emulator> {
        Emulator::start_as(Properties::default(), listen)
    }

    /// Listens on all ports, as this arm.
    ///
    /// # Errors
    /// As [`Emulator::start`].
    pub fn start_as(properties: Properties, listen: Listen) -> anyhow::Result<Emulator> {
        let shared = Arc::new(Shared {
            started: Instant::now(),
            model: Mutex::new(Model::new(properties, 0)),
            reply_faults: Mutex::default(),
            gripper_requests: AtomicU64::new(0),
            connections: Mutex::default(),
            ended: AtomicBool::new(false),
        });
        let mut emulator = Emulator { shared, listen };
        let ports = [
            (&mut emulator.listen.control_port, None),
            (&mut emulator.listen.normal_report_port, Some(Kind::Normal)),
            (&mut emulator.listen.rich_report_port, Some(Kind::Rich)),
            (&mut emulator.listen.real_time_report_port, Some(Kind::RealTime)),
        ];
        for (port, report) in ports {
            let address = SocketAddr::new(listen.address, *port);
            let listener = TcpListener::bind(address).with_context(|| {
                format!("cannot listen on {address}: choose another port (ports below 1024 need root)")
            })?;
            *port = listener.local_addr()?.port();
            let shared = Arc::clone(&emulator.shared);
            std::thread::Builder::new()
                .name("accept".to_owned())
                .spawn(move || shared.accept(&listener, report))?;
        }
        Ok(emulator)
    }

    /// Injects a fault, or ends one.
    pub fn inject(&self, fault: Fault) {
        let mut model = self.shared.model();
        match fault {
            Fault::EmergencyStop => model.press_emergency_stop(true),
            Fault::Release => model.press_emergency_stop(false),
            Fault::Collision => model.fail(code::COLLISION),
            Fault::Error(code) => model.fail(code),
            Fault::Warning(code) => model.warn(code),
            Fault::Runaway(along_y_mm_per_s) => model.run_away(along_y_mm_per_s.into()),
            Fault::Creep(along_y_mm_per_s) => model.creep(along_y_mm_per_s.into()),
            Fault::Mode(mode) => model.take_over(mode),
            Fault::State(order) => {
                model.set_state(order);
            }
            Fault::Refuse(count) => model.refuse_velocities(count),
            Fault::GripperOff => model.gripper_mut().enable(false),
            Fault::Object(pulses) => model.gripper_mut().put_object(pulses),
            Fault::Drop => {
                drop(model);
                self.shared.drop_connections();
            }
            Fault::GripperLate(_)
            | Fault::Late(..)
            | Fault::Torn(_)
            | Fault::Garbage(_)
            | Fault::Silent(_) => lock(&self.shared.reply_faults).add(fault),
        }
    }

    /// Number of requests to the gripper so far.
    pub fn gripper_requests(&self) -> u64 {
        self.shared.gripper_requests.load(Ordering::SeqCst)
    }

    /// A copy of the model as it is now.
    pub fn model(&self) -> Model {
        self.shared.model().clone()
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        self.shared.drop_connections();
        let listen = self.listen;
        for port in [
            listen.control_port,
            listen.normal_report_port,
            listen.rich_report_port,
            listen.real_time_report_port,
        ] {
            // Wakes whoever accepts there, to see that it is over; refused where nobody does.
            let _ =
                TcpStream::connect_timeout(&SocketAddr::new(listen.address, port), Duration::from_secs(1));
        }
    }
}

impl Shared {
    /// The model, now.
    fn model(&self) -> MutexGuard<'_, Model> {
        let mut model = lock(&self.model);
        model.advance_to(self.started.elapsed().as_nanos() as u64);
        model
    }

    fn drop_connections(&self) {
        for connection in lock(&self.connections).drain(..) {
            // One that is closed already is as wanted.
            let _ = connection.shutdown(Shutdown::Both);
        }
    }

    fn accept(self: Arc<Shared>, listener: &TcpListener, report: Option<Kind>) {
        for connection in listener.incoming() {
            if self.ended.load(Ordering::SeqCst) {
                return;
            }
            let Ok(mut connection) = connection else { continue };
            let Ok(copy) = connection.try_clone() else { continue };
            lock(&self.connections).push(copy);
            let shared = Arc::clone(&self);
            std::thread::spawn(move || {
                // A connection that breaks is over; the other side sees it too.
                let _ = match report {
                    Some(kind) => shared.report(&mut connection, kind),
                    None => shared.serve(&mut connection),
                };
                let _ = connection.shutdown(Shutdown::Both);
                let over = connection.peer_addr().ok();
                lock(&shared.connections).retain(|other| other.peer_addr().ok() != over);
            });
        }
    }

    fn report(&self, connection: &mut TcpStream, kind: Kind) -> std::io::Result<()> {
        let period = match kind {
            Kind::RealTime => Duration::from_millis(10),
            Kind::Normal | Kind::Rich => Duration::from_millis(200),
        };
        connection.set_nodelay(true)?;
        connection.set_write_timeout(Some(Duration::from_secs(4)))?;
        let mut bytes = Vec::new();
        let mut due = Instant::now();
        while !self.ended.load(Ordering::SeqCst) {
            bytes.clear();
            let model = self.model().clone();
            model.report().encode(kind, &mut bytes);
            if kind == Kind::Rich {
                bytes[RICH_MODEL] = model.properties().model;
                bytes[RICH_AXES] = model.properties().axes;
            }
            connection.write_all(&bytes)?;
            due = (due + period).max(Instant::now());
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        Ok(())
    }

    fn serve(self: &Arc<Shared>, connection: &mut TcpStream) -> std::io::Result<()> {
        connection.set_nodelay(true)?;
        // Late replies of the gripper are written by other threads.
        let writer = Arc::new(Mutex::new(connection.try_clone()?));
        let mut decoder = Decoder::new();
        let mut buffer = [0; 4096];
        let mut reply = Vec::new();
        loop {
            let length = connection.read(&mut buffer)?;
            if length == 0 {
                return Ok(());
            }
            let mut input = &buffer[..length];
            while let Some(frame) = decoder.next_frame(&mut input) {
                let is_for_gripper = frame.body.first() == Some(&register::GRIPPER);
                self.gripper_requests.fetch_add(is_for_gripper.into(), Ordering::SeqCst);
                reply.clear();
                answer(&mut self.model(), &frame, &mut reply);
                if reply.is_empty() {
                    continue;
                }
                let late = lock(&self.reply_faults).gripper_late();
                if is_for_gripper && !late.is_zero() {
                    send_later(&writer, std::mem::take(&mut reply), late);
                } else {
                    self.send(&writer, &reply)?;
                }
            }
        }
    }

    fn send(&self, writer: &Mutex<TcpStream>, reply: &[u8]) -> std::io::Result<()> {
        let fault = lock(&self.reply_faults).take();
        if let ReplyFault::Late(late) = fault {
            std::thread::sleep(late);
        }
        let mut connection = lock(writer);
        match fault {
            ReplyFault::None | ReplyFault::Late(_) => connection.write_all(reply),
            ReplyFault::Torn => reply.iter().try_for_each(|&byte| {
                connection.write_all(&[byte])?;
                std::thread::sleep(Duration::from_millis(1));
                Ok(())
            }),
            ReplyFault::Garbage => connection.write_all(&self.garbage()),
            ReplyFault::Silent => Ok(()),
        }
    }

    /// Pseudo-random bytes (xorshift, seeded by the time).
    fn garbage(&self) -> [u8; 64] {
        let mut bits = self.started.elapsed().as_nanos() as u64 | 1;
        std::array::from_fn(|_| {
            bits ^= bits << 13;
            bits ^= bits >> 7;
            bits ^= bits << 17;
            bits as u8
        })
    }
}

/// Sends a reply after a delay; replies to other requests overtake it.
fn send_later(writer: &Arc<Mutex<TcpStream>>, reply: Vec<u8>, late: Duration) {
    let writer = Arc::clone(writer);
    std::thread::spawn(move || {
        std::thread::sleep(late);
        // Nobody waits for it any more if the connection is gone.
        let _ = lock(&writer).write_all(&reply);
    });
}
