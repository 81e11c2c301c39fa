//! `tendon stop` and `tendon arm`: orders to the robot of a running session, past everything else.

use tendon_process::{Order, OrderError, order_robot};

use crate::Failure;
use crate::output::print;
use crate::running_session::RunningSession;

/// Gives the robot the order and says what it answered.
pub fn give(session: &RunningSession, order: Order) -> Result<(), Failure> {
    let answer = order_robot(&session.name, session.user()?, order).map_err(|error| match error {
        OrderError::Find(_) => Failure::input(error),
        OrderError::NoAnswer(_)
        | OrderError::NotListening(_)
        | OrderError::Nonsense(_)
        | OrderError::Socket { .. } => Failure::running(error),
    })?;
    if !answer.ok {
        return Err(Failure::running(anyhow::anyhow!(answer.text)));
    }
    print(answer.text).map_err(Failure::running)?;
    Ok(())
}
