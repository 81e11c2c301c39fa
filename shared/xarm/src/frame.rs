//! Frames of the control connection (TCP port 502): requests, replies, and a decoder for their stream.
//!
//! ```text
//! request  transaction u16be │ protocol u16be │ length u16be │ register u8 │              │ parameters
//! reply    transaction u16be │ protocol u16be │ length u16be │ register u8 │ state byte u8 │ parameters
//!          └────────────── header, 6 bytes ───────────────┘ └──────── body, `length` bytes ────────┘
//! ```
//!
//! The protocol is 2. On the same port the vendor's client may send its heartbeat (protocol 1), plain Modbus TCP
//! (protocol 0) and protocol 3, which is 2 under another number; all share the header.

/// The protocol number of requests and replies.
pub const PROTOCOL: u16 = 2;

/// The protocol number of the heartbeat, which has no reply.
pub const HEARTBEAT_PROTOCOL: u16 = 1;

/// The highest protocol number that the arm knows.
pub const HIGHEST_PROTOCOL: u16 = 3;

/// The register of frames that the arm sends unasked.
pub const FEEDBACK_REGISTER: u8 = 0xFF;

/// Bytes of the header.
pub const HEADER_LENGTH: usize = 6;

/// Longest accepted body in bytes: twice that of the longest known reply.
pub const LONGEST_BODY: usize = 512;

/// The shortest body in bytes: a request without parameters.
const SHORTEST_BODY: usize = 1;

/// The transaction id after this one: 1 to 65535, then 1 again.
pub fn next_transaction(transaction: u16) -> u16 {
    if transaction == u16::MAX { 1 } else { transaction + 1 }
}

/// One frame of either direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Id of the request, or of the request that this answers.
    pub transaction: u16,
    /// Protocol number, 0 to [`HIGHEST_PROTOCOL`].
    pub protocol: u16,
    /// What follows the header: 1 to [`LONGEST_BODY`] bytes.
    pub body: &'a [u8],
}

impl Frame<'_> {
    /// Appends the bytes of this frame.
    ///
    /// # Panics
    /// If the body is longer than [`LONGEST_BODY`] bytes.
    pub fn encode(&self, into: &mut Vec<u8>) {
        assert!(self.body.len() <= LONGEST_BODY, "a body of {} bytes", self.body.len());
        encode_header(into, self.transaction, self.protocol, self.body.len());
        into.extend_from_slice(self.body);
    }
}

/// Appends a request: the register and its parameters.
///
/// # Panics
/// If there are more parameters than fit into [`LONGEST_BODY`] bytes.
pub fn encode_request(into: &mut Vec<u8>, transaction: u16, register: u8, parameters: &[u8]) {
    assert!(parameters.len() < LONGEST_BODY, "{} bytes of parameters", parameters.len());
    encode_header(into, transaction, PROTOCOL, 1 + parameters.len());
    into.push(register);
    into.extend_from_slice(parameters);
}

pub(crate) fn encode_header(into: &mut Vec<u8>, transaction: u16, protocol: u16, body_length: usize) {
    into.extend_from_slice(&transaction.to_be_bytes());
    into.extend_from_slice(&protocol.to_be_bytes());
    into.extend_from_slice(&(body_length as u16).to_be_bytes());
}

/// Splits a byte stream into frames, whether they arrive in pieces, several at once, or with garbage in between.
///
/// Bytes that cannot begin a frame are skipped one by one and counted. The decoder buffers at most one frame and does
/// not allocate after construction.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: Box<[u8; HEADER_LENGTH + LONGEST_BODY]>,
    filled: usize,
    /// The frame handed out last still lies in the buffer.
    handed_out: bool,
    skipped_bytes: u64,
}

impl Default for Decoder {
    fn default() -> Decoder {
        Decoder::new()
    }
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new() -> Decoder {
        Decoder {
            buffer: Box::new([0; HEADER_LENGTH + LONGEST_BODY]),
            filled: 0,
            handed_out: false,
            skipped_bytes: 0,
        }
    }

    /// The next frame. Takes from the front of `input` what it needs; `None` once all is taken and no frame is
    /// complete.
    pub fn next_frame(&mut self, input: &mut &[u8]) -> Option<Frame<'_>> {
        if std::mem::take(&mut self.handed_out) {
            self.filled = 0;
        }
        loop {
            if !self.fill(HEADER_LENGTH, input) {
                return None;
            }
            let [t0, t1, p0, p1, l0, l1, ..] = *self.buffer;
            let protocol = u16::from_be_bytes([p0, p1]);
            let length = usize::from(u16::from_be_bytes([l0, l1]));
            if protocol > HIGHEST_PROTOCOL || !(SHORTEST_BODY..=LONGEST_BODY).contains(&length) {
                self.buffer.copy_within(1..HEADER_LENGTH, 0);
                self.filled = HEADER_LENGTH - 1;
                self.skipped_bytes += 1;
                continue;
            }
            let end = HEADER_LENGTH + length;
            if !self.fill(end, input) {
                return None;
            }
            self.handed_out = true;
            return Some(Frame {
                transaction: u16::from_be_bytes([t0, t1]),
                protocol,
                body: &self.buffer[HEADER_LENGTH..end],
            });
        }
    }

    /// How many bytes were skipped since the beginning.
    pub fn skipped_bytes(&self) -> u64 {
        self.skipped_bytes
    }

    /// Discards an incomplete frame, which may be garbage that claims a long body.
    pub fn give_up(&mut self) {
        if !std::mem::take(&mut self.handed_out) {
            self.skipped_bytes += self.filled as u64;
        }
        self.filled = 0;
    }

    /// Fills the buffer up to `end`, if `input` has that much.
    fn fill(&mut self, end: usize, input: &mut &[u8]) -> bool {
        fill(&mut self.buffer[..], &mut self.filled, end, input)
    }
}

/// Fills `buffer`, of which `filled` bytes are there, up to `end`; whether `input` had that much.
pub(crate) fn fill(buffer: &mut [u8], filled: &mut usize, end: usize, input: &mut &[u8]) -> bool {
    let taken = end.saturating_sub(*filled).min(input.len());
    let (now, later) = input.split_at(taken);
    buffer[*filled..*filled + taken].copy_from_slice(now);
    *filled += taken;
    *input = later;
    *filled >= end
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::command::{ALL_AXES, Command, CommandError, Mode, StateOrder, TwistFrame};
    use crate::gripper::GripperRequest;
    use crate::reply::{Reply, ReplyError, StateByte, fault};

    fn encoded(command: Command, transaction: u16) -> Vec<u8> {
        let mut bytes = Vec::new();
        command.encode(transaction, &mut bytes);
        bytes
    }

    fn hex(text: &str) -> Vec<u8> {
        let digits: String = text.split_whitespace().collect();
        (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
    }

    fn velocity() -> Command {
        Command::CartesianVelocity {
            twist: [30.0, 0.0, 20.0, std::f32::consts::FRAC_PI_6, 0.0, 0.0],
            frame: TwistFrame::Base,
            duration_s: Some(0.2),
        }
    }

    /// From the vendor's pages, whole frames.
    #[test]
    fn requests_are_the_vendors_bytes() {
        let vectors = [
            (
                velocity(),
                1,
                "0001 0002 001E 52 0000F041 00000000 0000A041 920A063F 00000000 00000000 00 CDCC4C3E",
            ),
            (Command::GetVersion, 1, "0001 0002 0001 01"),
            (Command::Enable { axis: ALL_AXES, on: true }, 1, "0001 0002 0003 0B 08 01"),
            (Command::SetMode(Mode::CartesianVelocity), 2, "0002 0002 0002 13 05"),
            (Command::SetState(StateOrder::Run), 3, "0003 0002 0002 0C 00"),
            (Command::SetState(StateOrder::Stop), 3, "0003 0002 0002 0C 04"),
            (
                Command::Gripper(GripperRequest::Enable(true)),
                1,
                "0001 0002 000B 7C 09 08 10 0100 0001 02 0001",
            ),
            (
                Command::Gripper(GripperRequest::MoveTo(850)),
                1,
                "0001 0002 000D 7C 09 08 10 0700 0002 04 00000352",
            ),
            (Command::Gripper(GripperRequest::GetPosition), 1, "0001 0002 0008 7C 09 08 03 0702 0002"),
        ];
        for (command, transaction, bytes) in vectors {
            assert_eq!(encoded(command, transaction), hex(bytes), "{command:?}");
            assert_eq!(Command::decode(&hex(bytes)[HEADER_LENGTH..]), Ok(command));
        }
    }

    fn parse(bytes: &[u8], look: impl FnOnce(Reply<'_>)) {
        let mut decoder = Decoder::new();
        let mut input = bytes;
        let frame = decoder.next_frame(&mut input).expect("a whole frame");
        look(Reply::parse(&frame).unwrap());
        assert!(input.is_empty());
    }

    #[test]
    fn replies_are_read_as_the_vendor_means_them() {
        parse(&hex("0001 0002 0002 52 00"), |reply| {
            assert_eq!((reply.transaction, reply.register, reply.state), (1, 0x52, StateByte(0)));
        });
        let mut version = hex("0001 0002 002A 01 00");
        version.extend(b"6,6,XI1202,AC1302,v1.12.10");
        version.resize(48, 0);
        parse(&version, |reply| assert_eq!(reply.text(), Ok("6,6,XI1202,AC1302,v1.12.10")));
        parse(&hex("0001 0002 0009 7C 00 09 08 10 0100 0001"), |reply| {
            assert_eq!(reply.gripper_took_it(), Ok(()));
        });
        parse(&hex("0001 0002 000A 7C 00 09 08 03 04 FFFFFFF6"), |reply| {
            assert_eq!(reply.gripper_position_pulses(), Ok(-10));
        });
        parse(&hex("0001 0002 0006 7C 00 09 08 83 02"), |reply| {
            assert_eq!(reply.gripper_position_pulses(), Err(ReplyError::Gripper { code: 2 }));
        });
        parse(&hex("0007 0002 0004 0F 50 17 00"), |reply| {
            assert_eq!(reply.codes(), Ok((23, 0)));
            assert!(reply.state.has_error() && reply.state.is_not_ready());
            assert!(!reply.state.is_invalid() && !reply.state.has_warning());
        });
        parse(&hex("0007 0002 0003 0D 00 04"), |reply| {
            assert_eq!(reply.arm_state(), Ok(crate::ArmState::Stopped));
        });
    }

    #[test]
    fn transactions_wrap_to_one() {
        assert_eq!((next_transaction(1), next_transaction(65534), next_transaction(65535)), (2, 65535, 1));
    }

    #[test]
    fn a_request_that_is_none_is_named() {
        assert_eq!(Command::decode(&[]), Err(CommandError::Empty));
        assert_eq!(Command::decode(&[0xEE]), Err(CommandError::UnknownRegister(0xEE)));
        assert_eq!(Command::decode(&[0x13, 3]), Err(CommandError::Parameters { register: 0x13, length: 1 }));
        let mut not_finite = encoded(velocity(), 1);
        not_finite[7..11].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(Command::decode(&not_finite[HEADER_LENGTH..]).is_err());
    }

    #[test]
    fn the_newer_clients_set_mode_is_understood() {
        assert_eq!(Command::decode(&[0x13, 5, 0]), Ok(Command::SetMode(Mode::CartesianVelocity)));
    }

    fn finite() -> impl Strategy<Value = f32> {
        -1e6..1e6_f32
    }

    fn any_command() -> impl Strategy<Value = Command> {
        let duration = || prop::option::of(0.0..10.0_f32);
        prop_oneof![
            Just(Command::GetVersion),
            Just(Command::GetErrors),
            Just(Command::GetJoints),
            (1..=8_u8, any::<bool>()).prop_map(|(axis, on)| Command::Enable { axis, on }),
            any::<[i32; 6]>().prop_map(Command::SetBoundary),
            finite().prop_map(Command::SetReducedSpeed),
            any::<bool>().prop_map(Command::SetFence),
            any::<i32>().prop_map(|pulses| Command::Gripper(GripperRequest::MoveTo(pulses))),
            any::<u16>().prop_map(|speed| Command::Gripper(GripperRequest::SetSpeed(speed))),
            (prop::array::uniform6(finite()), any::<bool>(), duration()).prop_map(
                |(twist, in_tool, duration_s)| Command::CartesianVelocity {
                    twist,
                    frame: if in_tool { TwistFrame::Tool } else { TwistFrame::Base },
                    duration_s,
                }
            ),
            (prop::array::uniform7(finite()), any::<bool>(), duration()).prop_map(
                |(velocities_rad_per_s, synchronous, duration_s)| Command::JointVelocity {
                    velocities_rad_per_s,
                    synchronous,
                    duration_s,
                }
            ),
        ]
    }

    proptest! {
        #[test]
        fn commands_survive_the_wire(
            commands in prop::collection::vec((any_command(), any::<u16>()), 0..20),
            piece in 1..100_usize,
        ) {
            let mut stream = Vec::new();
            for (command, transaction) in &commands {
                command.encode(*transaction, &mut stream);
            }
            let mut decoder = Decoder::new();
            let mut received = Vec::new();
            for mut piece in stream.chunks(piece) {
                while let Some(frame) = decoder.next_frame(&mut piece) {
                    received.push((Command::decode(frame.body).unwrap(), frame.transaction));
                }
            }
            prop_assert_eq!(received, commands);
            prop_assert_eq!(decoder.skipped_bytes(), 0);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        /// Frames with some bytes changed and garbage behind, in pieces: it ends, never panics, and a whole frame
        /// after the longest that a false length can swallow is found.
        #[test]
        fn whatever_comes_the_decoder_goes_on(
            commands in prop::collection::vec(any_command(), 0..4),
            garbage in prop::collection::vec(any::<u8>(), 0..200),
            changes in prop::collection::vec((any::<usize>(), any::<u8>()), 0..6),
            piece in 1..300_usize,
        ) {
            let mut stream = Vec::new();
            for command in &commands {
                command.encode(1, &mut stream);
            }
            stream.extend(garbage);
            let length = stream.len();
            for (place, value) in changes {
                if length > 0 {
                    stream[place % length] = value;
                }
            }
            stream.extend([0xAA; HEADER_LENGTH + LONGEST_BODY]);
            velocity().encode(4711, &mut stream);
            let mut decoder = Decoder::new();
            let mut last = None;
            for mut piece in stream.chunks(piece) {
                while let Some(frame) = decoder.next_frame(&mut piece) {
                    // None of these may panic, whatever the frame.
                    if let Ok(reply) = Reply::parse(&frame) {
                        let _ = (reply.text(), reply.arm_state(), fault(&reply), reply.command_count());
                        let _ = (reply.floats::<6>(), reply.floats::<7>());
                        let _ = (reply.gripper_position_pulses(), reply.gripper_took_it());
                    }
                    last = Some((frame.transaction, Command::decode(frame.body)));
                }
            }
            prop_assert_eq!(last, Some((4711, Ok(velocity()))));
        }
    }
}
