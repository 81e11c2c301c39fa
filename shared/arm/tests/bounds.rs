//! Whatever is commanded: speed, acceleration, jerk, workspace, joint limits and singularities keep their bounds.
//!
//! A million random sequences, in release in ten to twenty minutes:
//! `cargo test --release -p tendon-arm --test bounds -- --ignored --nocapture`

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use nalgebra::{SVector, Vector3};
use tendon_arm::kinematics::{LOWER_LIMITS_RAD, UPPER_LIMITS_RAD};
use tendon_arm::velocity::{SMALLEST_SINGULAR_VALUE, singularity_distance, smallest_singular_value};
use tendon_arm::{ArmSettings, JointVector, MotionBounds, STEP_NS, STOP_NS, SimulatedArm, Twist, XArm7};

const STEP_S: f64 = STEP_NS as f64 * 1e-9;
const STOP_STEPS: u64 = STOP_NS / STEP_NS;

/// Bounds hold up to this share of them: rounding errors of second differences.
const RELATIVE_TOLERANCE: f64 = 1e-6;

/// The flange may be elsewhere than its velocity says by so much a step, in mm: the midpoint rule's error.
const FOLLOWING_TOLERANCE_MM: f64 = 2e-3;

/// No start is nearer to a joint limit. Motion leads no joint nearer than 0.02 rad; a start within that margin leaves
/// room for less than what the prediction errs by, and the joint limit comes before the acceleration.
const LEAST_ROOM_RAD: f64 = 0.005;

/// Uniform random numbers: SplitMix64.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut number = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        number = (number ^ (number >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        number ^ (number >> 31)
    }

    fn between(&mut self, lowest: f64, highest: f64) -> f64 {
        lowest + (highest - lowest) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    fn steps(&mut self, fewest: u64, most: u64) -> u64 {
        fewest + self.bits() % (most - fewest + 1)
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Joint angles (rad) away from singularities and at least [`LEAST_ROOM_RAD`] from joint limits, often near one of
    /// either.
    fn posture(&mut self, arm: &XArm7) -> JointVector {
        let near_singularity = self.chance(0.3);
        let near_limit = self.chance(0.4);
        loop {
            let mut joints = JointVector::from_fn(|joint, _| {
                self.between(LOWER_LIMITS_RAD[joint], UPPER_LIMITS_RAD[joint])
            });
            if near_limit {
                let (joint, off_rad) = (self.bits() as usize % 7, self.between(1e-9, 0.1));
                joints[joint] = if self.chance(0.5) {
                    LOWER_LIMITS_RAD[joint] + off_rad
                } else {
                    UPPER_LIMITS_RAD[joint] - off_rad
                };
            }
            let farthest = if near_singularity { 0.08 } else { f64::INFINITY };
            let room_rad = (UPPER_LIMITS_RAD - joints).inf(&(joints - LOWER_LIMITS_RAD)).min();
            if room_rad >= LEAST_ROOM_RAD && (0.045..farthest).contains(&singularity_distance(arm, &joints)) {
                return joints;
            }
        }
    }

    /// Settings with a random start and a workspace around it, whose faces are often near.
    fn settings(&mut self, arm: &XArm7) -> ArmSettings {
        let joints = self.posture(arm);
        let position_mm = arm.flange_pose_m(&joints).translation.vector * 1e3;
        let mut settings = ArmSettings {
            // Within the limits by a hair, since degrees do not hold every angle in radians.
            start_joints_deg: joints.map(|angle| (angle * (1.0 - 1e-12)).to_degrees()).into(),
            watchdog_ms: if self.chance(0.5) { 150 } else { self.steps(10, 150) },
            ..ArmSettings::default()
        };
        for axis in 0..3 {
            let mut away_mm =
                || if self.chance(0.3) { self.between(0.5, 26.0) } else { self.between(30.0, 500.0) };
            settings.workspace_min_mm[axis] = position_mm[axis] - away_mm();
            settings.workspace_max_mm[axis] =
                (position_mm[axis] + away_mm()).max(settings.workspace_min_mm[axis] + 11.0);
        }
        if self.chance(0.3) {
            settings.linear_speed_limit_mm_per_s = self.between(20.0, 250.0);
            settings.linear_acceleration_mm_per_s2 = self.between(200.0, 1500.0);
            settings.linear_jerk_mm_per_s3 = self.between(4000.0, 60_000.0);
        }
        settings
    }

    /// An axis push, a pure rotation, the reverse of the last twist, anything, or silence.
    fn command(&mut self, last: Option<Twist>) -> Option<Twist> {
        let kind = self.between(0.0, 1.0);
        let mut twist = Twist::ZERO;
        if kind < 0.4 {
            twist.linear_mm_per_s[self.bits() as usize % 3] = self.between(20.0, 200.0) * self.sign();
        } else if kind < 0.5 {
            twist.angular_rad_per_s[self.bits() as usize % 3] = self.between(0.1, 1.0) * self.sign();
        } else if kind < 0.65 {
            twist = last.unwrap_or_default().scaled(-1.0);
        } else if kind < 0.9 {
            twist.linear_mm_per_s = [(); 3].map(|()| self.between(-200.0, 200.0));
            twist.angular_rad_per_s = [(); 3].map(|()| self.between(-1.0, 1.0));
        } else {
            return None;
        }
        Some(twist)
    }
}

/// The velocities of the last three steps and what bounds hold for them.
struct Watch {
    model: XArm7,
    settings: ArmSettings,
    /// The newest first.
    velocities: [Twist; 3],
    position_mm: Vector3<f64>,
    /// Steps of the present stop.
    stop_steps: u64,
    /// Steps since the last one of a stop.
    steps_since_stop: u64,
}

impl Watch {
    fn new(settings: &ArmSettings, arm: &SimulatedArm) -> Watch {
        Watch {
            model: XArm7::new(),
            settings: settings.clone(),
            velocities: [Twist::ZERO; 3],
            position_mm: arm.state().position_mm.into(),
            stop_steps: 0,
            steps_since_stop: u64::MAX,
        }
    }

    /// Everything that must hold after a step.
    fn check(&mut self, arm: &SimulatedArm) -> Result<(), String> {
        self.velocities.rotate_right(1);
        self.velocities[0] = arm.velocity();
        if arm.motion().is_stopping() {
            (self.stop_steps, self.steps_since_stop) = (self.stop_steps + 1, 0);
        } else {
            (self.stop_steps, self.steps_since_stop) = (0, self.steps_since_stop.saturating_add(1));
        }
        if self.stop_steps >= STOP_STEPS {
            return Err("a stop that does not end".into());
        }
        // A jerk is a difference over three steps, one of which may belong to a stop.
        let bounds = |following: MotionBounds| {
            if self.steps_since_stop <= 2 { following.while_stopping() } else { following }
        };
        let linear = self.velocities.map(|twist| Vector3::from(twist.linear_mm_per_s));
        let angular = self.velocities.map(|twist| Vector3::from(twist.angular_rad_per_s));
        within("linear", &linear, bounds(self.settings.linear_bounds()))?;
        within("angular", &angular, bounds(self.settings.angular_bounds()))?;

        let state = arm.state();
        let joints = JointVector::from(state.joints_rad);
        if !(joints >= LOWER_LIMITS_RAD && joints <= UPPER_LIMITS_RAD) {
            return Err(format!("joint limits: {joints}"));
        }
        if singularity_distance(&self.model, &joints) < SMALLEST_SINGULAR_VALUE
            && smallest_singular_value(&self.model, &joints) < SMALLEST_SINGULAR_VALUE
        {
            return Err(format!("singular value {}", smallest_singular_value(&self.model, &joints)));
        }
        let position_mm = Vector3::from(state.position_mm);
        let (lowest, highest) = (self.settings.workspace_min_mm, self.settings.workspace_max_mm);
        if !(position_mm >= lowest.into() && position_mm <= highest.into()) {
            return Err(format!("workspace {lowest:?} to {highest:?}: {position_mm}"));
        }
        let astray_mm = position_mm - self.position_mm - linear[0] * STEP_S;
        if astray_mm.norm() > FOLLOWING_TOLERANCE_MM {
            return Err(format!("moved other than told by {} mm", astray_mm.norm()));
        }
        self.position_mm = position_mm;
        Ok(())
    }
}

/// Whether the last three velocities keep the bounds by their norms.
fn within(what: &str, velocities: &[SVector<f64, 3>; 3], bounds: MotionBounds) -> Result<(), String> {
    let [new, old, older] = velocities;
    for (quantity, value, bound) in [
        ("speed", new.norm(), bounds.speed),
        ("acceleration", (new - old).norm() / STEP_S, bounds.acceleration),
        ("jerk", (new - old * 2.0 + older).norm() / STEP_S.powi(2), bounds.jerk),
    ] {
        if value.is_nan() || value > bound * (1.0 + RELATIVE_TOLERANCE) {
            return Err(format!("{what} {quantity} {value} above {bound}"));
        }
    }
    Ok(())
}

/// One random sequence of so many commands, each held for at most so many steps, and the stop after it. Returns
/// the number of steps, and what went wrong.
fn sequence(seed: u64, most_commands: u64, most_steps: u64) -> (u64, Result<(), String>) {
    let mut random = Random(seed);
    let settings = random.settings(&XArm7::new());
    let mut arm = match SimulatedArm::new(settings.clone(), 0) {
        Ok(arm) => arm,
        Err(error) => return (0, Err(error.to_string())),
    };
    let mut watch = Watch::new(&settings, &arm);
    let mut step = 0;
    let mut last = None;
    let mut run = |random: &mut Random, twist: Option<Twist>, steps: u64| -> Result<(), String> {
        let every = random.steps(1, 5);
        for held in 0..steps {
            let now_ns = step * STEP_NS;
            if let Some(twist) = twist
                && held % every == 0
            {
                arm.command(twist, now_ns).map_err(|error| error.to_string())?;
            }
            if random.chance(0.002) {
                arm.stop();
            }
            arm.step();
            step += 1;
            watch.check(&arm).map_err(|error| format!("{error} in step {step} of {settings:?}"))?;
        }
        Ok(())
    };
    let mut outcome = Ok(());
    for _ in 0..random.steps(1, most_commands) {
        let twist = random.command(last);
        last = twist.or(last);
        let steps = random.steps(5, most_steps);
        outcome = outcome.and_then(|()| run(&mut random, twist, steps));
    }
    // Silence: at rest after the watchdog's time, the stop's, and the step in which each ends.
    let silence = settings.watchdog_ns().div_ceil(STEP_NS) + STOP_STEPS + 1;
    outcome = outcome.and_then(|()| run(&mut random, None, silence));
    if outcome.is_ok() && arm.velocity() != Twist::ZERO {
        outcome = Err(format!("not at rest: {:?}", arm.velocity()));
    }
    (step, outcome)
}

#[test]
fn bounds_hold_in_random_sequences() {
    for seed in 0..300 {
        let (_, outcome) = sequence(seed, 5, 500);
        assert_eq!(outcome, Ok(()), "sequence {seed}");
    }
}

#[test]
#[ignore = "takes ten minutes or more, in release"]
fn a_million_random_sequences() {
    const SEQUENCES: u64 = 1_000_000;
    const THREADS: u64 = 2;
    let (done, steps, violations) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let begin = Instant::now();
    std::thread::scope(|scope| {
        for thread in 0..THREADS {
            let (done, steps, violations) = (&done, &steps, &violations);
            scope.spawn(move || {
                for seed in (thread..SEQUENCES).step_by(THREADS as usize) {
                    let (taken, outcome) = sequence(seed ^ 0x5EED_0000_0000, 3, 40);
                    steps.fetch_add(taken, Ordering::Relaxed);
                    if let Err(error) = outcome
                        && violations.fetch_add(1, Ordering::Relaxed) < 20
                    {
                        eprintln!("sequence {seed}: {error}");
                    }
                    done.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        while done.load(Ordering::Relaxed) < SEQUENCES {
            std::thread::sleep(Duration::from_secs(5));
            let [done, steps, violations] =
                [&done, &steps, &violations].map(|count| count.load(Ordering::Relaxed));
            let seconds = begin.elapsed().as_secs();
            eprintln!("{seconds} s: {done} sequences, {steps} steps, {violations} violations");
        }
    });
    assert_eq!(violations.into_inner(), 0);
}
