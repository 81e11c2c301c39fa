//! Answers requests, independent of any network.

use tendon_xarm::command::register;
use tendon_xarm::frame::{Frame, HEARTBEAT_PROTOCOL};
use tendon_xarm::gripper::{self, MODBUS_READ, MODBUS_WRITE};
use tendon_xarm::reply::{Reply, StateByte};
use tendon_xarm::{Command, GripperRequest};

use crate::Model;
use crate::model::Taken;

/// Carries out one request and appends its reply, if it has one.
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
        Command::GetVersion => put_text(parameters, &model.properties().version()),
        Command::GetSerialNumber => put_text(parameters, &model.properties().serial_number),
        Command::Enable { axis, on } => return model.enable(axis, on),
        Command::SetState(order) => return model.set_state(order),
        Command::GetState => parameters.push(model.state() as u8),
        Command::GetCommandCount => parameters.extend([0, 0]),
        Command::GetErrors => parameters.extend(<[u8; 2]>::from(model.codes())),
        Command::ClearError => model.clear_error(),
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

/// Set in the function of a Modbus reply that is a refusal; its code follows.
const MODBUS_REFUSED: u8 = 0x80;
/// Code of a refusal: the device cannot do that now.
const DEVICE_FAILURE: u8 = 4;

fn gripper_status(model: &Model) -> u8 {
    match model.gripper() {
        gripper if gripper.moves() => gripper::MOVING,
        gripper if gripper.holds() => gripper::HOLDING,
        _ => gripper::STANDING,
    }
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
            model.gripper_mut().enable(on);
            wrote(ENABLE, 1);
        }
        GripperRequest::SetMode(_) => wrote(MODE, 1),
        GripperRequest::SetSpeed(speed) => {
            model.gripper_mut().set_speed(speed);
            wrote(SPEED, 1);
        }
        GripperRequest::MoveTo(pulses) => {
            if model.gripper_mut().move_to(pulses) {
                wrote(TARGET, 2);
            } else {
                parameters.extend([MODBUS_WRITE | MODBUS_REFUSED, DEVICE_FAILURE]);
            }
        }
        GripperRequest::GetPosition => {
            parameters.extend([MODBUS_READ, 4]);
            parameters.extend((model.gripper().position_pulses.round() as i32).to_be_bytes());
        }
        GripperRequest::GetStatus => parameters.extend([MODBUS_READ, 2, 0, gripper_status(model)]),
        GripperRequest::GetError => {
            parameters.extend([MODBUS_READ, 2]);
            parameters.extend(model.gripper().error.to_be_bytes());
        }
    }
}

/// Requests that only the vendor's client sends.
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
    use tendon_xarm::frame::Decoder;

    use super::*;
    use crate::Properties;

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
        let mut model = Model::new(Properties::default(), 0);
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
            answer(&mut Model::new(Properties::default(), 0), &Frame { transaction, protocol, body: &body }, &mut reply);
            let mut decoder = Decoder::new();
            let mut input = &reply[..];
            let frame = decoder.next_frame(&mut input).expect("a whole frame");
            prop_assert_eq!((frame.transaction, frame.protocol, frame.body[0]), (transaction, protocol, body[0]));
            prop_assert!(input.is_empty());
        }
    }
}
