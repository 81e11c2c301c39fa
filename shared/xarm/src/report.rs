//! Reports that the arm pushes over its report connections, and a decoder for their stream.
//!
//! ```text
//! byte   0        4            5               7             35                  59              87
//!        length   state, mode  command count   7 joints      6 pose              7 torques       …
//!        u32be    u4, u4       u16be           f32le, rad    f32le, mm and rad   f32le, Nm
//!
//! 30003  100 Hz   87 bytes, or 135: … 87 6 × external force, 111 6 × raw force
//! 30001  5 Hz     133 or 145 bytes: … 87 brakes, 88 motors, 89 error, 90 warning, 91 TCP offset, 115 load,
//!                                      131 collision sensitivity, 132 teaching sensitivity, 133 gravity
//! 30002  5 Hz     233 or 245 bytes: as 30001, and more
//! ```
//!
//! Some firmware announces 133 or 233 bytes and sends 12 more; the decoder skips those.

use crate::ArmState;
use crate::frame::fill;

/// Which of the report connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 30001, 5 Hz.
    Normal,
    /// 30002, 5 Hz.
    Rich,
    /// 30003, 100 Hz.
    RealTime,
}

impl Kind {
    /// The vendor's port.
    pub fn port(self) -> u16 {
        match self {
            Kind::Normal => 30001,
            Kind::Rich => 30002,
            Kind::RealTime => 30003,
        }
    }

    /// How many bytes the vendor's newest firmware sends, without a force sensor.
    pub fn length(self) -> usize {
        match self {
            Kind::Normal => 145,
            Kind::Rich => 245,
            Kind::RealTime => 87,
        }
    }

    /// How many bytes are needed to make sense of a frame.
    fn shortest(self) -> usize {
        match self {
            Kind::Normal => 133,
            Kind::Rich => 233,
            Kind::RealTime => 87,
        }
    }
}

/// Longest accepted report in bytes. Newer firmware may send fields that are unknown here.
pub const LONGEST_REPORT: usize = 1024;

/// Bytes of the length.
const HEADER_LENGTH: usize = 4;

/// Brakes, motors and error codes, in the reports 30001 and 30002 only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Which joints' brakes are released, joint 1 in the lowest bit.
    pub brakes_released: u8,
    /// Which joints' motors are on, joint 1 in the lowest bit.
    pub motors_on: u8,
    /// Error code, 0 for none: [`crate::Fault`].
    pub error: u8,
    /// Warning code, 0 for none.
    pub warning: u8,
}

/// What somebody set on the controller about the tool and the mounting, in the reports 30001 and 30002.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// From the flange to the tool's tip, which is what [`Report::pose`] then tells: mm, then roll, pitch, yaw in
    /// rad.
    pub tcp_offset: [f32; 6],
    /// Mass of the tool and what it holds, kg.
    pub load_kg: f32,
    /// Its centre of mass, from the flange, mm.
    pub load_centre_mm: [f32; 3],
    /// How readily the arm takes a high motor current for a collision: 0 never, 5 at the slightest.
    pub collision_sensitivity: u8,
    /// How readily the arm gives way when moved by hand: 1 to 5.
    pub teaching_sensitivity: u8,
    /// Direction of gravity in the base frame: (0, 0, −1) for an arm that stands. `None`: the firmware does not say.
    pub gravity: Option<[f32; 3]>,
}

impl Default for Setup {
    /// A standing arm as delivered, without a tool.
    fn default() -> Setup {
        Setup {
            tcp_offset: [0.0; 6],
            load_kg: 0.0,
            load_centre_mm: [0.0; 3],
            collision_sensitivity: 3,
            teaching_sensitivity: 3,
            gravity: Some([0.0, 0.0, -1.0]),
        }
    }
}

impl Setup {
    /// Whether [`Report::pose`] is that of the flange.
    pub fn has_tcp_offset(&self) -> bool {
        self.tcp_offset.iter().any(|&value| value != 0.0)
    }

    /// `None` if a number is not finite.
    fn decode(bytes: &[u8]) -> Option<Setup> {
        let [load_kg, x, y, z] = floats(&bytes[115..]);
        let setup = Setup {
            tcp_offset: floats(&bytes[91..]),
            load_kg,
            load_centre_mm: [x, y, z],
            collision_sensitivity: bytes[131],
            teaching_sensitivity: bytes[132],
            gravity: (bytes.len() >= 145).then(|| floats(&bytes[133..])),
        };
        let values =
            setup.tcp_offset.iter().chain(&setup.load_centre_mm).chain(setup.gravity.iter().flatten());
        values.chain([&setup.load_kg]).all(|value| value.is_finite()).then_some(setup)
    }

    fn encode(&self, bytes: &mut [u8]) {
        put_floats(&mut bytes[91..], &self.tcp_offset);
        put_floats(&mut bytes[115..], &[self.load_kg]);
        put_floats(&mut bytes[119..], &self.load_centre_mm);
        bytes[131..133].copy_from_slice(&[self.collision_sensitivity, self.teaching_sensitivity]);
        put_floats(&mut bytes[133..], &self.gravity.unwrap_or_default());
    }
}

/// Forces and torques at the flange, of an arm with the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forces {
    /// After compensation: 3 in N, 3 in Nm.
    pub external: [f32; 6],
    /// As measured: 3 in N, 3 in Nm.
    pub raw: [f32; 6],
}

/// One report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// State of the arm.
    pub state: ArmState,
    /// Number of the mode: [`crate::Mode`], or an unknown one.
    pub mode: u8,
    /// Number of queued commands.
    pub command_count: u16,
    /// Joint angles in rad, joint 1 first.
    pub joints_rad: [f32; 7],
    /// Position of the tool's tip in mm, then roll, pitch, yaw in rad. Without a TCP offset ([`Setup`]) the tip is the
    /// flange.
    pub pose: [f32; 6],
    /// Torque of each joint in Nm.
    pub torques_nm: [f32; 7],
    /// Only in [`Kind::Normal`] and [`Kind::Rich`].
    pub health: Option<Health>,
    /// Only in [`Kind::Normal`] and [`Kind::Rich`].
    pub setup: Option<Setup>,
    /// Only in [`Kind::RealTime`], with the sensor.
    pub forces: Option<Forces>,
}

/// A frame that is not a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReportError {
    /// Too few bytes.
    #[error("a report of {found} bytes instead of {expected} or more: is this a report port of an xArm?")]
    Short {
        /// Bytes there.
        found: usize,
        /// Bytes needed.
        expected: usize,
    },
    /// A state that does not exist.
    #[error("a report with state {0}, which does not exist: is this a report port of an xArm?")]
    State(u8),
    /// A joint angle or a pose that is no number.
    #[error("a report with a joint angle or pose that is no finite number: restart the arm")]
    NotFinite,
}

impl Report {
    /// The report in a frame (with its length) of this connection.
    ///
    /// # Errors
    /// [`ReportError`] if it is none.
    pub fn decode(kind: Kind, bytes: &[u8]) -> Result<Report, ReportError> {
        if bytes.len() < kind.shortest() {
            return Err(ReportError::Short { found: bytes.len(), expected: kind.shortest() });
        }
        let state = ArmState::from_number(bytes[4] & 0x0F).ok_or(ReportError::State(bytes[4] & 0x0F))?;
        let report = Report {
            state,
            mode: bytes[4] >> 4,
            command_count: u16::from_be_bytes([bytes[5], bytes[6]]),
            joints_rad: floats(&bytes[7..]),
            pose: floats(&bytes[35..]),
            torques_nm: floats(&bytes[59..]),
            health: (kind != Kind::RealTime).then(|| Health {
                brakes_released: bytes[87],
                motors_on: bytes[88],
                error: bytes[89],
                warning: bytes[90],
            }),
            setup: if kind == Kind::RealTime { None } else { Setup::decode(bytes) },
            forces: (kind == Kind::RealTime && bytes.len() >= 135)
                .then(|| Forces { external: floats(&bytes[87..]), raw: floats(&bytes[111..]) }),
        };
        if report.joints_rad.iter().chain(&report.pose).any(|value| !value.is_finite()) {
            return Err(ReportError::NotFinite);
        }
        Ok(report)
    }

    /// Appends the bytes of this report on this connection. What this type does not hold is zero.
    pub fn encode(&self, kind: Kind, into: &mut Vec<u8>) {
        let start = into.len();
        let length = match (kind, self.forces) {
            (Kind::RealTime, Some(_)) => 135,
            _ => kind.length(),
        };
        into.resize(start + length, 0);
        let bytes = &mut into[start..];
        bytes[..4].copy_from_slice(&(length as u32).to_be_bytes());
        bytes[4] = self.state as u8 | self.mode << 4;
        bytes[5..7].copy_from_slice(&self.command_count.to_be_bytes());
        put_floats(&mut bytes[7..], &self.joints_rad);
        put_floats(&mut bytes[35..], &self.pose);
        put_floats(&mut bytes[59..], &self.torques_nm);
        match (kind, self.forces) {
            (Kind::RealTime, Some(forces)) => {
                put_floats(&mut bytes[87..], &forces.external);
                put_floats(&mut bytes[111..], &forces.raw);
            }
            (Kind::RealTime, None) => {}
            (Kind::Normal | Kind::Rich, _) => {
                let health = self.health.unwrap_or_default();
                bytes[87..91].copy_from_slice(&[
                    health.brakes_released,
                    health.motors_on,
                    health.error,
                    health.warning,
                ]);
                self.setup.unwrap_or_default().encode(bytes);
            }
        }
    }
}

fn floats<const COUNT: usize>(bytes: &[u8]) -> [f32; COUNT] {
    let mut values = [0.0; COUNT];
    for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(4)) {
        *value = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    }
    values
}

fn put_floats(bytes: &mut [u8], values: &[f32]) {
    for (bytes, value) in bytes.chunks_exact_mut(4).zip(values) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
}

/// Splits the byte stream of a report connection into reports, whether they arrive in pieces or several at once.
///
/// Bytes that cannot begin a report are skipped one by one and counted. The decoder buffers at most one report and
/// does not allocate after construction.
#[derive(Clone, Debug)]
pub struct Decoder {
    kind: Kind,
    buffer: Box<[u8; LONGEST_REPORT]>,
    filled: usize,
    skipped_bytes: u64,
}

impl Decoder {
    /// A decoder at the beginning of a stream of this connection.
    pub fn new(kind: Kind) -> Decoder {
        Decoder { kind, buffer: Box::new([0; LONGEST_REPORT]), filled: 0, skipped_bytes: 0 }
    }

    /// The next report. Takes from the front of `input` what it needs; `None` once all is taken and no report is
    /// complete. Frames that are not reports are skipped.
    pub fn next_report(&mut self, input: &mut &[u8]) -> Option<Report> {
        loop {
            if !self.fill(HEADER_LENGTH, input) {
                return None;
            }
            let [l0, l1, l2, l3, ..] = *self.buffer;
            let length = u32::from_be_bytes([l0, l1, l2, l3]) as usize;
            if !(self.kind.shortest()..=LONGEST_REPORT).contains(&length) {
                self.buffer.copy_within(1..HEADER_LENGTH, 0);
                self.filled = HEADER_LENGTH - 1;
                self.skipped_bytes += 1;
                continue;
            }
            if !self.fill(length, input) {
                return None;
            }
            self.filled = 0;
            match Report::decode(self.kind, &self.buffer[..length]) {
                Ok(report) => return Some(report),
                Err(_) => self.skipped_bytes += length as u64,
            }
        }
    }

    /// How many bytes were skipped since the beginning.
    pub fn skipped_bytes(&self) -> u64 {
        self.skipped_bytes
    }

    /// Fills the buffer up to `end`, if `input` has that much.
    fn fill(&mut self, end: usize, input: &mut &[u8]) -> bool {
        fill(&mut self.buffer[..], &mut self.filled, end, input)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn report(kind: Kind) -> Report {
        Report {
            state: ArmState::Ready,
            mode: 5,
            command_count: 258,
            joints_rad: [0.1, -0.2, 0.3, 0.4, -0.5, 0.6, 0.7],
            pose: [206.0, 0.0, 120.5, 3.1, 0.0, -0.1],
            torques_nm: [1.0; 7],
            health: (kind != Kind::RealTime).then_some(Health {
                brakes_released: 0x7F,
                motors_on: 0x7F,
                error: 31,
                warning: 0,
            }),
            setup: (kind != Kind::RealTime).then_some(Setup {
                tcp_offset: [1.0, -2.0, 172.0, 0.0, 0.5, 0.0],
                load_kg: 0.82,
                load_centre_mm: [0.0, 1.0, 48.0],
                collision_sensitivity: 4,
                teaching_sensitivity: 2,
                gravity: Some([0.0, 1.0, 0.0]),
            }),
            forces: None,
        }
    }

    fn encoded(kind: Kind) -> Vec<u8> {
        let mut bytes = Vec::new();
        report(kind).encode(kind, &mut bytes);
        bytes
    }

    #[test]
    fn the_fields_lie_where_the_protocol_says() {
        let real_time = encoded(Kind::RealTime);
        assert_eq!(real_time.len(), 87);
        assert_eq!(real_time[..7], [0, 0, 0, 87, 0x52, 1, 2]);
        assert_eq!(real_time[7..11], 0.1_f32.to_le_bytes());
        assert_eq!(real_time[35..39], 206.0_f32.to_le_bytes());
        assert_eq!(real_time[59..63], 1.0_f32.to_le_bytes());
        let normal = encoded(Kind::Normal);
        assert_eq!((normal.len(), normal[89], normal[90]), (145, 31, 0));
        assert_eq!(normal[99..103], 172.0_f32.to_le_bytes());
        assert_eq!(normal[115..119], 0.82_f32.to_le_bytes());
        assert_eq!(normal[127..133], [0, 0, 0x40, 0x42, 4, 2]);
        assert_eq!(normal[137..141], 1.0_f32.to_le_bytes());
        assert_eq!(encoded(Kind::Rich).len(), 245);
        let mut bytes = Vec::new();
        let forces = Forces { external: [1.0; 6], raw: [2.0; 6] };
        let with_forces = Report { forces: Some(forces), ..report(Kind::RealTime) };
        with_forces.encode(Kind::RealTime, &mut bytes);
        assert_eq!((bytes.len(), &bytes[111..115]), (135, &2.0_f32.to_le_bytes()[..]));
        assert_eq!(Report::decode(Kind::RealTime, &bytes), Ok(with_forces));
    }

    #[test]
    fn a_header_that_says_133_while_145_bytes_come_loses_no_report() {
        for (kind, said) in [(Kind::Normal, 133_u32), (Kind::Rich, 233)] {
            let mut bytes = encoded(kind);
            bytes[..4].copy_from_slice(&said.to_be_bytes());
            let stream = bytes.repeat(3);
            let mut decoder = Decoder::new(kind);
            let mut input = &stream[..];
            let mut expected = report(kind);
            if kind == Kind::Normal {
                // It lies in the 12 bytes that the header does not count.
                expected.setup.as_mut().unwrap().gravity = None;
            }
            for _ in 0..3 {
                assert_eq!(decoder.next_report(&mut input), Some(expected));
            }
            assert_eq!(decoder.next_report(&mut input), None);
        }
    }

    #[test]
    fn what_is_no_report_is_named() {
        let mut bytes = encoded(Kind::RealTime);
        assert_eq!(
            Report::decode(Kind::RealTime, &bytes[..86]),
            Err(ReportError::Short { found: 86, expected: 87 })
        );
        bytes[4] = 0x59;
        assert_eq!(Report::decode(Kind::RealTime, &bytes), Err(ReportError::State(9)));
        bytes[4] = 0x52;
        bytes[7..11].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(Report::decode(Kind::RealTime, &bytes), Err(ReportError::NotFinite));
        let mut normal = encoded(Kind::Normal);
        normal[115..119].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(Report::decode(Kind::Normal, &normal).unwrap().setup, None);
    }

    fn any_kind() -> impl Strategy<Value = Kind> {
        prop_oneof![Just(Kind::Normal), Just(Kind::Rich), Just(Kind::RealTime)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        /// Random bytes, or reports with some bytes changed, in pieces: it ends, never panics, and a whole report
        /// after enough silence of garbage is found.
        #[test]
        fn whatever_comes_the_decoder_goes_on(
            kind in any_kind(),
            garbage in prop::collection::vec(any::<u8>(), 0..300),
            changes in prop::collection::vec((0..1000_usize, any::<u8>()), 0..6),
            piece in 1..400_usize,
        ) {
            let mut stream = encoded(kind).repeat(2);
            let length = stream.len();
            for (place, value) in changes {
                stream[place % length] = value;
            }
            stream.extend(garbage);
            // The longest that a false length can swallow.
            stream.extend([0xAA; LONGEST_REPORT]);
            stream.extend(encoded(kind));
            let mut decoder = Decoder::new(kind);
            let mut last = None;
            let mut taken = 0;
            for mut piece in stream.chunks(piece) {
                while let Some(report) = decoder.next_report(&mut piece) {
                    last = Some(report);
                    taken += 1;
                }
            }
            prop_assert!(taken <= 2 + 300 / 87 + 1 + 1);
            prop_assert_eq!(last, Some(report(kind)));
            prop_assert!(decoder.skipped_bytes() <= stream.len() as u64);
        }
    }
}
