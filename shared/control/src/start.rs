//! Whether an arm may set out for its start position by itself, and how fast it goes.
//!
//! ```text
//! record: left in good order, at these joints? ── no ──▶ wait for `tendon arm`, then follow from where it is
//!    │ yes                                                   ▲
//! start within the joint limits, way inside the box? ── no ──┘
//!    │ yes
//! way: short? ── no ──▶ wait; `tendon arm` sends it off
//!    │ yes
//!    ▼ go
//! ```

use tendon_arm::{ArmSettings, JointLimits, JointVector, STEP_NS, XArm7};
use tendon_messages::StopReason;

/// How the last session left the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Departure {
    /// In good order, at these joint angles in rad.
    LeftAt(JointVector),
    /// There is no record: it is a new arm, or the last session did not end in good order.
    NoRecord,
    /// In good order, but another user's session has used it since.
    UsedSince,
    /// There is a record that cannot be read or is not to be trusted.
    Unusable,
}

/// The arm is where it was left if no joint is further off than this, in rad: 1 degree.
const SAME_PLACE_RAD: f64 = 0.0175;
/// A flange that gets no further from its start position than this, in mm, may go there by itself.
const NEAR_MM: f64 = 100.0;
/// Postures of the way that are looked at.
const POSTURES: u32 = 100;
/// Joints this near to the start position, rad, are there.
const ARRIVED_RAD: f64 = 0.002;
/// On the way to the start position: acceleration in rad/s², and the speed near the end in 1/s of the distance left.
const ACCELERATION_RAD_PER_S2: f64 = 0.5;
const APPROACH_PER_S: f64 = 2.0;

/// The way to the start position.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    arm: XArm7,
    joints_rad: JointVector,
    workspace_min_mm: [f64; 3],
    workspace_max_mm: [f64; 3],
    joint_speed_rad_per_s: f64,
    flange_speed_mm_per_s: f64,
}

impl Start {
    /// Joints turn at `joint_speed_rad_per_s` at most, and the flange keeps its speed limit.
    pub fn new(settings: &ArmSettings, joint_speed_rad_per_s: f64) -> Start {
        Start {
            arm: XArm7::new(),
            joints_rad: settings.start_joints_rad(),
            workspace_min_mm: settings.workspace_min_mm,
            workspace_max_mm: settings.workspace_max_mm,
            joint_speed_rad_per_s,
            flange_speed_mm_per_s: settings.linear_speed_limit_mm_per_s,
        }
    }

    /// Whether the arm may set out by itself from these joint angles in rad.
    ///
    /// # Errors
    ///
    /// Why it waits for `tendon arm`.
    pub fn permit(
        &self,
        departure: Departure,
        joints_rad: &JointVector,
        limits: &JointLimits,
    ) -> Result<(), StopReason> {
        match departure {
            Departure::NoRecord => return Err(StopReason::NotLeftInGoodOrder),
            Departure::UsedSince => return Err(StopReason::UsedSince),
            Departure::Unusable => return Err(StopReason::RecordUnusable),
            Departure::LeftAt(left_rad) => {
                let is_same = (left_rad - joints_rad).iter().all(|off| off.abs() <= SAME_PLACE_RAD);
                if !is_same {
                    return Err(StopReason::MovedSince);
                }
            }
        }
        if !(self.joints_rad >= limits.lower_rad && self.joints_rad <= limits.upper_rad) {
            return Err(StopReason::StartBeyondLimit);
        }
        self.survey(joints_rad)
    }

    /// Looks at the straight way of the joints from where they are.
    fn survey(&self, joints_rad: &JointVector) -> Result<(), StopReason> {
        let way = self.joints_rad - joints_rad;
        let mut furthest_mm = 0.0_f64;
        for posture in 0..=POSTURES {
            let on_the_way_rad = joints_rad + way * (f64::from(posture) / f64::from(POSTURES));
            let position_mm = self.arm.flange_pose_m(&on_the_way_rad).translation.vector * 1e3;
            let is_inside = (0..3).all(|axis| {
                (self.workspace_min_mm[axis]..=self.workspace_max_mm[axis]).contains(&position_mm[axis])
            });
            if !is_inside {
                let is_here = posture == 0;
                return Err(if is_here { StopReason::OutsideBox } else { StopReason::WayLeavesBox });
            }
            furthest_mm = furthest_mm.max(self.distance_mm(&on_the_way_rad));
        }
        if furthest_mm.is_nan() || furthest_mm > NEAR_MM {
            return Err(StopReason::StartIsFar);
        }
        Ok(())
    }

    /// Distance of the flange from its start position in mm.
    pub fn distance_mm(&self, joints_rad: &JointVector) -> f64 {
        let [here, start] = [joints_rad, &self.joints_rad]
            .map(|joints_rad| self.arm.flange_pose_m(joints_rad).translation.vector * 1e3);
        (here - start).norm()
    }

    /// Whether the joints (rad) are there.
    pub fn is_at(&self, joints_rad: &JointVector) -> bool {
        (self.joints_rad - joints_rad).amax() < ARRIVED_RAD
    }

    /// The velocities of the joints in rad/s in the coming step, after one in which the fastest had `speed_rad_per_s`.
    pub fn step(&self, joints_rad: &JointVector, speed_rad_per_s: f64) -> JointVector {
        let way = self.joints_rad - joints_rad;
        let distance = way.amax();
        let gained = speed_rad_per_s + ACCELERATION_RAD_PER_S2 * STEP_NS as f64 * 1e-9;
        let direction = way / distance.max(f64::MIN_POSITIVE);
        let flange_mm = (self.arm.jacobian(joints_rad) * direction).fixed_rows::<3>(0).norm() * 1e3;
        let speed = gained
            .min(self.joint_speed_rad_per_s)
            .min(APPROACH_PER_S * distance)
            .min(self.flange_speed_mm_per_s / flange_mm.max(f64::MIN_POSITIVE));
        direction * speed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start() -> (Start, JointVector) {
        let settings = ArmSettings::default();
        (Start::new(&settings, 0.17), settings.start_joints_rad())
    }

    fn permit(start: &Start, left_rad: JointVector, joints_rad: JointVector) -> Result<(), StopReason> {
        start.permit(Departure::LeftAt(left_rad), &joints_rad, &JointLimits::default())
    }

    #[test]
    fn only_an_arm_that_is_where_it_was_left_in_good_order_sets_out() {
        let (start, joints_rad) = start();
        let limits = JointLimits::default();
        assert_eq!(permit(&start, joints_rad, joints_rad), Ok(()));
        let mut moved_rad = joints_rad;
        moved_rad[4] += 0.03;
        assert_eq!(permit(&start, joints_rad, moved_rad), Err(StopReason::MovedSince));
        moved_rad[4] = f64::NAN;
        assert_eq!(permit(&start, moved_rad, joints_rad), Err(StopReason::MovedSince));
        for (departure, reason) in [
            (Departure::NoRecord, StopReason::NotLeftInGoodOrder),
            (Departure::UsedSince, StopReason::UsedSince),
            (Departure::Unusable, StopReason::RecordUnusable),
        ] {
            assert_eq!(start.permit(departure, &joints_rad, &limits), Err(reason));
        }
        let narrow = JointLimits { upper_rad: joints_rad.add_scalar(-0.01), ..limits };
        let permitted = start.permit(Departure::LeftAt(joints_rad), &joints_rad, &narrow);
        assert_eq!(permitted, Err(StopReason::StartBeyondLimit));
    }

    #[test]
    fn a_far_start_and_a_way_out_of_the_box_ask_first() {
        let (start, start_rad) = start();
        let turned = |joint: usize, by_deg: f64| {
            let mut joints_rad = start_rad;
            joints_rad[joint] += by_deg.to_radians();
            permit(&start, joints_rad, joints_rad)
        };
        assert_eq!(turned(0, 10.0), Ok(()));
        // 386 mm from the axis, 16 degrees are 108 mm, and 180 degrees lead out of the box.
        assert_eq!(turned(0, 16.0), Err(StopReason::StartIsFar));
        assert_eq!(turned(0, 180.0), Err(StopReason::OutsideBox), "it would come in by itself");
        assert_eq!(turned(0, 360.0), Err(StopReason::WayLeavesBox), "once around: the distance is 0");
    }

    #[test]
    fn the_way_keeps_the_speeds_and_arrives() {
        let (start, start_rad) = start();
        let mut joints_rad = start_rad;
        joints_rad[0] += 0.2;
        joints_rad[1] -= 0.1;
        let (mut speed, mut steps) = (0.0, 0);
        while !start.is_at(&joints_rad) {
            let before = joints_rad;
            let velocities = start.step(&joints_rad, speed);
            let next = velocities.amax();
            assert!(next <= 0.17 + 1e-9 && next - speed <= 0.5 * 4e-3 + 1e-9);
            joints_rad += velocities * 4e-3;
            let [from, to] =
                [before, joints_rad].map(|joints| start.arm.flange_pose_m(&joints).translation.vector);
            assert!((to - from).norm() * 1e3 / 4e-3 <= 100.5);
            (speed, steps) = (next, steps + 1);
            assert!(steps < 10_000);
        }
    }
}
