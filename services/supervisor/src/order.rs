//! `tendon stop` and `tendon arm`: orders to the robot of a running session, past everything else.

use anyhow::Context;
use clap::Args;
use nix::unistd::User;
use tendon_process::{Order, OrderError, order_robot};
use tendon_transport::SessionName;

use crate::Failure;
use crate::output::print;

/// Whom to order.
#[derive(Debug, Args)]
pub struct Options {
    /// Name of the session.
    #[arg(long, default_value = "tendon")]
    session: SessionName,
    /// Whose session, if several users run one of this name; for root.
    #[arg(long)]
    user: Option<String>,
}

/// Gives the robot the order and says what it answered.
pub fn give(options: &Options, order: Order) -> Result<(), Failure> {
    let user = options.user.as_deref().map(user_number).transpose().map_err(Failure::input)?;
    let answer = order_robot(&options.session, user, order).map_err(|error| match error {
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

/// The number of a user who is given by name or number.
pub fn user_number(name: &str) -> anyhow::Result<u32> {
    let user = User::from_name(name).ok().flatten();
    user.map(|user| user.uid.as_raw())
        .or(name.parse().ok())
        .with_context(|| format!("there is no user `{name}`"))
}
