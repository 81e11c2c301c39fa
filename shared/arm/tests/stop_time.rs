//! After the last command, the arm is at rest within the watchdog's 150 ms and the ramp's 80 ms, whatever it was doing.

use tendon_arm::{ArmSettings, STEP_NS, STOP_NS, SimulatedArm, Twist};

const WATCHDOG_NS: u64 = 150_000_000;
/// A command comes with every window.
const INCREMENT_NS: u64 = 75_000_000;

fn along(axis: usize, speed_mm_per_s: f64) -> Twist {
    let mut linear_mm_per_s = [0.0; 3];
    linear_mm_per_s[axis] = speed_mm_per_s;
    Twist { linear_mm_per_s, angular_rad_per_s: [0.0; 3] }
}

/// Gives `commands`, one each [`INCREMENT_NS`] from `first_ns` on, then none; how long after the last one the arm
/// still moved.
fn moves_on_ns(commands: &[Twist], first_ns: u64) -> u64 {
    let mut arm = SimulatedArm::new(ArmSettings::default(), 0).expect("the default settings are valid");
    let mut last_ns = first_ns;
    for (index, twist) in commands.iter().enumerate() {
        last_ns = first_ns + index as u64 * INCREMENT_NS;
        arm.command(*twist, last_ns).expect("the twist is finite");
    }
    let mut moved_ns = last_ns;
    for step in 1..500 {
        let now_ns = (last_ns / STEP_NS + step) * STEP_NS;
        arm.tick(now_ns);
        if arm.velocity() != Twist::ZERO {
            moved_ns = now_ns;
        }
    }
    assert!(arm.is_still());
    moved_ns - last_ns
}

#[test]
fn after_the_last_command_the_arm_rests_within_150_and_80_ms() {
    assert_eq!(ArmSettings::default().watchdog_ms, WATCHDOG_NS / 1_000_000);
    assert_eq!(STOP_NS, 80_000_000);
    let full = ArmSettings::default().linear_speed_limit_mm_per_s;
    for axis in 0..3 {
        for speed_mm_per_s in [5.0, 50.0, full] {
            let [forward, back] = [1.0, -1.0].map(|sign| along(axis, sign * speed_mm_per_s));
            // While it sets off, at its speed, while it turns round, and while it has just been told to rest.
            for commands in [
                vec![forward],
                vec![forward; 3],
                vec![forward, forward, forward, back],
                vec![forward, back, forward],
            ] {
                // At every place within a step.
                for first_ns in [0, 1, STEP_NS / 3, STEP_NS - 1] {
                    let moved_ns = moves_on_ns(&commands, first_ns);
                    let bound_ns = WATCHDOG_NS + STOP_NS + STEP_NS;
                    assert!(moved_ns <= bound_ns, "{moved_ns} ns after {commands:?} from {first_ns} ns");
                    // At the limit of speed, a face of the workspace may have stopped it before.
                    let was_moving = moved_ns >= WATCHDOG_NS || speed_mm_per_s == full;
                    assert!(was_moving, "{moved_ns} ns: nothing was to be stopped, {commands:?}");
                }
            }
        }
    }
}
