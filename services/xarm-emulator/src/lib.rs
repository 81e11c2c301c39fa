//! An xArm7 that is not there: the vendor's protocol, server side, over a model of the arm.
//!
//! ```text
//! control, 502  ──request──▶ [`answer`] ──▶ [`Model`] ◀── every 10 or 200 ms ── reports, 30001 to 30003
//!               ◀──reply─── [`Fault`]s       4 ms steps
//! ```
//!
//! Each connection has a thread. The model makes up for the time that passed whenever somebody looks at it.
#![forbid(unsafe_code)]

mod fault;
pub mod model;

use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
pub use fault::{Fault, FaultError};
use fault::{ReplyFault, ReplyFaults};
pub use model::Model;
use model::Taken;
use tendon_xarm::command::register;
use tendon_xarm::frame::{Decoder, Frame, HEARTBEAT_PROTOCOL};
use tendon_xarm::gripper::{self, MODBUS_READ, MODBUS_WRITE};
use tendon_xarm::reply::{Reply, StateByte};
use tendon_xarm::report::Kind;
use tendon_xarm::{Command, GripperRequest};

/// What the emulated arm says it is: seven joints, type 7, serial numbers, firmware.
pub const VERSION: &str = "7,7,XI1300,AC1300,v1.12.10";
/// Its serial number.
pub const SERIAL_NUMBER: &str = "XI130000000000";

/// Where the emulator listens. Port 0 is any free one.
#[derive(Clone, Copy, Debug)]
pub struct Listen {
    /// Default 127.0.0.1: whoever reaches it can move the arm.
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

/// A running emulator; it ends when dropped.
#[derive(Debug)]
pub struct Emulator {
    shared: Arc<Shared>,
    /// Where it listens: the ports that were free.
    pub listen: Listen,
}

#[derive(Debug)]
struct Shared {
    started: Instant,
    model: Mutex<Model>,
    reply_faults: Mutex<ReplyFaults>,
    connections: Mutex<Vec<TcpStream>>,
    ended: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What lies behind these locks is whole at every moment.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Emulator {
    /// Listens on all ports.
    ///
    /// # Errors
    /// If a port is taken or not allowed, with what to do.
    pub fn start(listen: Listen) -> anyhow::Result<Emulator> {
        let shared = Arc::new(Shared {
            started: Instant::now(),
            model: Mutex::new(Model::new(0)),
            reply_faults: Mutex::default(),
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
                format!("cannot listen on {address}: choose another port; those below 1024 need rights")
            })?;
            *port = listener.local_addr()?.port();
            let shared = Arc::clone(&emulator.shared);
            std::thread::Builder::new()
                .name("accept".to_owned())
                .spawn(move || shared.accept(&listener, report))?;
        }
        Ok(emulator)
    }

    /// Makes something go wrong.
    pub fn inject(&self, fault: Fault) {
        match fault {
            Fault::EmergencyStop => self.shared.model().press_emergency_stop(true),
            Fault::Release => self.shared.model().press_emergency_stop(false),
            Fault::Collision => self.shared.model().fail(model::code::COLLISION),
            Fault::Error(code) => self.shared.model().fail(code),
            Fault::Warning(code) => self.shared.model().warn(code),
            Fault::Runaway(along_y_mm_per_s) => self.shared.model().run_away(along_y_mm_per_s.into()),
            Fault::Drop => self.shared.drop_connections(),
            Fault::Late(..) | Fault::Torn(_) | Fault::Garbage(_) | Fault::Silent(_) => {
                lock(&self.shared.reply_faults).add(fault);
            }
        }
    }

    /// A copy of the arm as it is now.
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
            let report = self.model().report();
            report.encode(kind, &mut bytes);
            connection.write_all(&bytes)?;
            due = (due + period).max(Instant::now());
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        Ok(())
    }

    fn serve(&self, connection: &mut TcpStream) -> std::io::Result<()> {
        connection.set_nodelay(true)?;
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
                reply.clear();
                answer(&mut self.model(), &frame, &mut reply);
                if !reply.is_empty() {
                    self.send(connection, &reply)?;
                }
            }
        }
    }

    fn send(&self, connection: &mut TcpStream, reply: &[u8]) -> std::io::Result<()> {
        let fault = lock(&self.reply_faults).take();
        match fault {
            ReplyFault::None => connection.write_all(reply),
            ReplyFault::Late(late) => {
                std::thread::sleep(late);
                connection.write_all(reply)
            }
            ReplyFault::Torn => reply.iter().try_for_each(|&byte| {
                connection.write_all(&[byte])?;
                std::thread::sleep(Duration::from_millis(1));
                Ok(())
            }),
            ReplyFault::Garbage => {
                // Xorshift, seeded by the time: other garbage each time.
                let mut bits = self.started.elapsed().as_nanos() as u64 | 1;
                let garbage: [u8; 64] = std::array::from_fn(|_| {
                    bits ^= bits << 13;
                    bits ^= bits >> 7;
                    bits ^= bits << 17;
                    bits as u8
                });
                connection.write_all(&garbage)
            }
            ReplyFault::Silent => Ok(()),
        }
    }
}

/// Obeys one frame and appends the reply, if it has one.
pub fn answer(model: &mut Model, frame: &Frame<'_>, into: &mut Vec<u8>) {
    let Some(&register) = frame.body.first() else { return };
    if frame.protocol == HEARTBEAT_PROTOCOL {
        return;
    }
    if frame.protocol == 0 {
        // Modbus TCP, which is not emulated: exception 1, function not known.
        let function = frame.body.get(1).copied().unwrap_or_default();
        Frame { body: &[register, function | 0x80, 1], ..*frame }.encode(into);
        return;
    }
    let mut parameters = Vec::new();
    let taken = match Command::decode(frame.body) {
        Ok(command) => obey(model, command, &mut parameters),
        Err(_) => obey_unlisted(frame.body, &mut parameters),
    };
    let (error, warning) = model.codes();
    let mut state = 0;
    for (is_set, bit) in [
        (taken == Taken::Invalid, StateByte::INVALID),
        (error != 0, StateByte::ERROR),
        (warning != 0, StateByte::WARNING),
        (!model.is_ready(), StateByte::NOT_READY),
    ] {
        if is_set {
            state |= bit;
        }
    }
    let reply =
        Reply { transaction: frame.transaction, register, state: StateByte(state), parameters: &parameters };
    reply.encode(frame.protocol, into);
}

fn obey(model: &mut Model, command: Command, parameters: &mut Vec<u8>) -> Taken {
    match command {
        Command::GetVersion => put_text(parameters, VERSION),
        Command::GetSerialNumber => put_text(parameters, SERIAL_NUMBER),
        Command::Enable { axis, on } => return model.enable(axis, on),
        Command::SetState(order) => return model.set_state(order),
        Command::GetState => parameters.push(model.state() as u8),
        Command::GetCommandCount => parameters.extend([0, 0]),
        Command::GetErrors => parameters.extend(<[u8; 2]>::from(model.codes())),
        Command::ClearError => return model.clear_error(),
        Command::ClearWarning => model.clear_warning(),
        Command::SetMode(mode) => return model.set_mode(mode),
        Command::GetPose => put_floats(parameters, &model.report().pose),
        Command::GetJoints => put_floats(parameters, &model.report().joints_rad),
        Command::SetReducedSpeed(speed_mm_per_s) => model.set_reduced_speed(speed_mm_per_s),
        Command::SetReducedMode(on) => model.set_reduced_mode(on),
        Command::SetBoundary(boundary_mm) => model.set_boundary(boundary_mm),
        Command::SetFence(on) => model.set_fence(on),
        Command::JointVelocity { velocities_rad_per_s, duration_s, .. } => {
            return model.set_joint_velocities(velocities_rad_per_s, duration_s);
        }
        Command::CartesianVelocity { twist, frame, duration_s } => {
            return model.set_flange_velocity(twist, frame, duration_s);
        }
        Command::Gripper(request) => obey_gripper(model, request, parameters),
    }
    Taken::Yes
}

fn obey_gripper(model: &mut Model, request: GripperRequest, parameters: &mut Vec<u8>) {
    use gripper::register::{ENABLE, MODE, SPEED, TARGET};
    parameters.extend([gripper::LINE, gripper::ADDRESS]);
    let mut wrote = |register: u16, words: u8| {
        let [high, low] = register.to_be_bytes();
        parameters.extend([MODBUS_WRITE, high, low, 0, words]);
    };
    match request {
        GripperRequest::Enable(on) => {
            model.enable_gripper(on);
            wrote(ENABLE, 1);
        }
        GripperRequest::SetMode(_) => wrote(MODE, 1),
        GripperRequest::SetSpeed(speed) => {
            model.set_gripper_speed(speed);
            wrote(SPEED, 1);
        }
        GripperRequest::MoveTo(pulses) => {
            model.move_gripper(pulses);
            wrote(TARGET, 2);
        }
        GripperRequest::GetPosition => {
            parameters.extend([MODBUS_READ, 4]);
            parameters.extend((model.gripper().position_pulses.round() as i32).to_be_bytes());
        }
        GripperRequest::GetStatus => parameters.extend([MODBUS_READ, 2, 0, model.gripper_moves().into()]),
        GripperRequest::GetError => {
            parameters.extend([MODBUS_READ, 2]);
            parameters.extend(model.gripper().error.to_be_bytes());
        }
    }
}

/// What only the vendor's client asks, beside the commands of `tendon-xarm`.
fn obey_unlisted(body: &[u8], parameters: &mut Vec<u8>) -> Taken {
    /// Read and write a register of the board in the flange.
    const READ_FLANGE_BOARD: u8 = 0x80;
    const WRITE_FLANGE_BOARD: u8 = 0x7F;
    /// The number of 2 Mbit/s in the vendor's list of baud rates.
    const BAUD_RATE: i32 = 11;
    /// First of three registers with the version of the gripper's firmware, 3.4.3.
    const GRIPPER_VERSION: u16 = 0x0801;
    match *body {
        [READ_FLANGE_BOARD, gripper::LINE, ..] => parameters.extend(BAUD_RATE.to_be_bytes()),
        [WRITE_FLANGE_BOARD, gripper::LINE, ..] => {}
        [register::GRIPPER, gripper::LINE, gripper::ADDRESS, MODBUS_READ, r0, r1, 0, words @ 1..=16] => {
            let register = u16::from_be_bytes([r0, r1]);
            parameters.extend([gripper::LINE, gripper::ADDRESS, MODBUS_READ, 2 * words]);
            for register in register..register.saturating_add(words.into()) {
                let value: u16 = match register.wrapping_sub(GRIPPER_VERSION) {
                    0 | 2 => 3,
                    1 => 4,
                    _ => 0,
                };
                parameters.extend(value.to_be_bytes());
            }
        }
        // Exception 2: a register that does not exist.
        [register::GRIPPER, line, address, function, ..] => {
            parameters.extend([line, address, function | 0x80, 2]);
        }
        _ => return Taken::Invalid,
    }
    Taken::Yes
}

fn put_text(parameters: &mut Vec<u8>, text: &str) {
    parameters.extend(text.bytes());
    parameters.resize(40, 0);
}

fn put_floats(parameters: &mut Vec<u8>, values: &[f32]) {
    parameters.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Bits that are the same each time: xorshift.
    struct Bits(u64);

    impl Bits {
        fn next(&mut self) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0
        }
    }

    /// Obeys so many frames, most of them commands with a byte or two changed, from a stream in pieces, and lets
    /// time pass between.
    fn storm(frames: u32) {
        let mut bits = Bits(0x9E37_79B9_7F4A_7C15);
        let mut decoder = Decoder::new();
        let mut model = Model::new(0);
        let (mut stream, mut reply, mut now_ns, mut obeyed) = (Vec::new(), Vec::new(), 0, 0);
        while obeyed < frames {
            stream.clear();
            let command = match bits.next() % 8 {
                0 => Command::Enable { axis: 8, on: true },
                1 => Command::SetMode(tendon_xarm::Mode::CartesianVelocity),
                2 => Command::SetState(tendon_xarm::StateOrder::Run),
                3 => Command::ClearError,
                4 => Command::Gripper(GripperRequest::MoveTo(bits.next() as i32)),
                5 => Command::GetJoints,
                _ => Command::CartesianVelocity {
                    twist: std::array::from_fn(|_| (bits.next() % 400) as f32 - 200.0),
                    frame: tendon_xarm::TwistFrame::Base,
                    duration_s: Some(0.2),
                },
            };
            command.encode(bits.next() as u16, &mut stream);
            for _ in 0..bits.next() % 3 {
                let place = bits.next() as usize % stream.len();
                stream[place] = bits.next() as u8;
            }
            let cut = bits.next() as usize % (stream.len() + 1);
            for mut piece in [&stream[..cut], &stream[cut..]] {
                while let Some(frame) = decoder.next_frame(&mut piece) {
                    reply.clear();
                    answer(&mut model, &frame, &mut reply);
                    assert!(reply.len() <= 64, "a reply of {} bytes", reply.len());
                    obeyed += 1;
                }
            }
            now_ns += bits.next() % 8 * 1_000_000;
            model.advance_to(now_ns);
            let report = model.report();
            assert!(report.joints_rad.iter().chain(&report.pose).all(|value| value.is_finite()));
        }
    }

    #[test]
    fn a_storm_of_frames_is_survived() {
        storm(100_000);
    }

    #[test]
    #[ignore = "ten million frames take minutes"]
    fn a_long_storm_of_frames_is_survived() {
        storm(10_000_000);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        /// Whatever the body, a reply to it is a reply.
        #[test]
        fn every_request_has_its_reply(
            transaction in any::<u16>(),
            protocol in 2..=3_u16,
            body in prop::collection::vec(any::<u8>(), 1..60),
        ) {
            let mut reply = Vec::new();
            answer(&mut Model::new(0), &Frame { transaction, protocol, body: &body }, &mut reply);
            let mut decoder = Decoder::new();
            let mut input = &reply[..];
            let frame = decoder.next_frame(&mut input).expect("a whole frame");
            prop_assert_eq!((frame.transaction, frame.protocol, frame.body[0]), (transaction, protocol, body[0]));
            prop_assert!(input.is_empty());
        }
    }
}
