//! `tendon stop` and `tendon arm`: orders to the robot of a running session, past everything else.

use tendon_process::{Order, OrderError, order_robot};

use crate::Failure;
use crate::output::print;
use crate::running_session::RunningSession;

/// Gives the robot the order and says what it answered.
pub fn give(session: &RunningSession, order: Order) -> Result<(), Failure> {
    let answer = order_robot(&session.name, session.user()?, order).map_err(|error| match error {
        OrderError::Find(_) => Failure::input(error),
        OrderError::NoAnswer(_) | OrderError::Socket { .. } => Failure::running(error),
    })?;
    // See `StopAnswer` and `ArmAnswer` of the robot.
    if answer.starts_with("not armed") || answer.starts_with("not confirmed") {
        return Err(Failure::running(anyhow::anyhow!(answer)));
    }
    print(answer).map_err(Failure::running)?;
    Ok(())
}
