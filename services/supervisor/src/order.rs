//! `tendon stop` and `tendon arm`: orders to the robot of a running session, past everything else.

use clap::Args;
use tendon_process::{Order, order_robot};
use tendon_transport::SessionName;

use crate::Failure;

/// Whom to order.
#[derive(Debug, Args)]
pub struct Options {
    /// Name of the session.
    #[arg(long, default_value = "tendon")]
    session: SessionName,
}

/// Gives the robot the order and says what it answered.
pub fn give(options: &Options, order: Order) -> Result<(), Failure> {
    let answer = order_robot(&options.session, order).map_err(Failure::running)?;
    println!("{answer}");
    Ok(())
}
