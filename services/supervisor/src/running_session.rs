//! Which of the sessions that run on this machine a command is about.

use anyhow::Context;
use clap::Args;
use nix::unistd::User;
use tendon_transport::SessionName;

use crate::Failure;

/// Which running session is meant.
#[derive(Debug, Args)]
pub struct RunningSession {
    /// Name of the session.
    #[arg(long = "session", value_name = "SESSION", default_value = "tendon")]
    pub name: SessionName,
    /// Whose session, if several users run one of this name; for root.
    #[arg(long)]
    user: Option<String>,
}

impl RunningSession {
    /// The number of the user whose session it is, if one was given, by name or number.
    pub fn user(&self) -> Result<Option<u32>, Failure> {
        let number = |name: &String| {
            let user = User::from_name(name).ok().flatten();
            user.map(|user| user.uid.as_raw())
                .or(name.parse().ok())
                .with_context(|| format!("there is no user `{name}`"))
        };
        self.user.as_ref().map(number).transpose().map_err(Failure::input)
    }
}
