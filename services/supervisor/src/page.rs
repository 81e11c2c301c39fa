//! The page of a session in a browser: `tendon run --page`, and `tendon page` beside a session that runs.

use std::net::{IpAddr, Ipv4Addr};
use std::os::unix::process::CommandExt;
use std::process::Command;

use anyhow::Context;
use clap::Args;
use tendon_session::become_owner;

use crate::Failure;
use crate::options::RunningSession;

/// The program that serves the page. It lies beside this one.
pub const PROGRAM: &str = "tendon-page";
/// Where it listens unless told otherwise.
const PORT: u16 = 8423;

/// The options of `tendon run` that concern the page.
#[derive(Debug, Args)]
pub struct RunOptions {
    /// Show the session in a browser: prints an address with a token, which is the key to it.
    #[arg(long)]
    pub page: bool,
    /// Port of the page; 0 for any that is free.
    #[arg(long, value_name = "PORT", default_value_t = PORT, requires = "page")]
    page_port: u16,
    /// Address of this machine at which others may watch; they give no orders.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), requires = "page")]
    page_address: IpAddr,
    /// Let nobody give orders on the page.
    #[arg(long, requires = "page")]
    page_watch_only: bool,
}

impl RunOptions {
    /// Whether somebody at the page can give orders.
    pub fn takes_orders(&self) -> bool {
        self.page && !self.page_watch_only
    }

    /// For the page's program.
    pub fn arguments(&self) -> Vec<String> {
        arguments(self.page_port, self.page_address, self.page_watch_only)
    }
}

/// Command line of `tendon page`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    session: RunningSession,
    /// Port of the page; 0 for any that is free.
    #[arg(long, value_name = "PORT", default_value_t = PORT)]
    page_port: u16,
    /// Address of this machine at which others may watch; they give no orders.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    page_address: IpAddr,
    /// Let nobody give orders on the page.
    #[arg(long)]
    page_watch_only: bool,
}

/// Goes on as the program that serves the page.
pub fn serve(options: &Options) -> Result<(), Failure> {
    let session = &options.session;
    if let Some(user) = session.user()? {
        become_owner(&session.name, Some(user)).map_err(Failure::input)?;
    }
    let own =
        std::env::current_exe().context("cannot find this program's folder").map_err(Failure::running)?;
    let error = Command::new(own.with_file_name(PROGRAM))
        .args(["--session", session.name.to_string().as_str()])
        .args(arguments(options.page_port, options.page_address, options.page_watch_only))
        .exec();
    Err(Failure::running(anyhow::Error::new(error).context(format!("cannot start {PROGRAM}"))))
}

fn arguments(port: u16, address: IpAddr, is_watch_only: bool) -> Vec<String> {
    let mut arguments = vec![format!("--port={port}"), format!("--address={address}")];
    arguments.extend(is_watch_only.then(|| "--watch-only".to_owned()));
    arguments
}
