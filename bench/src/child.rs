//! Processes of this same program, which tell their results in lines of JSON.

use std::io::{BufRead, BufReader};
use std::os::fd::AsFd;
use std::process::{ChildStdout, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use serde::de::DeserializeOwned;

/// A child process; ended when dropped.
#[derive(Debug)]
pub struct Child {
    process: std::process::Child,
    output: BufReader<ChildStdout>,
    name: String,
}

impl Child {
    /// Starts this program with `arguments`. Its standard input stays open as long as the child is kept.
    pub fn start(arguments: &[String]) -> anyhow::Result<Child> {
        let program = std::env::current_exe().context("cannot find this program's file")?;
        let name = arguments.join(" ");
        let mut process = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start `bench {name}`"))?;
        let output = process.stdout.take().context("a child started with a pipe has one")?;
        Ok(Child { process, output: BufReader::new(output), name })
    }

    /// The next line the child writes, waited for up to `patience`.
    pub fn line<T: DeserializeOwned>(&mut self, patience: Duration) -> anyhow::Result<T> {
        if self.output.buffer().is_empty() {
            let timeout = PollTimeout::try_from(patience).context("cannot wait that long for a child")?;
            let mut output = [PollFd::new(self.output.get_ref().as_fd(), PollFlags::POLLIN)];
            if poll(&mut output, timeout).context("cannot wait for a child")? == 0 {
                bail!("`bench {}` said nothing for {patience:?}: a message was lost, or it hangs", self.name);
            }
        }
        let mut line = String::new();
        self.output.read_line(&mut line).with_context(|| format!("cannot hear `bench {}`", self.name))?;
        if line.is_empty() {
            bail!("`bench {}` ended early; what it wrote above says why", self.name);
        }
        serde_json::from_str(&line).with_context(|| format!("`bench {}` said {line:?}", self.name))
    }

    /// Tells the child to stop, by the end of its standard input, and waits until it has.
    pub fn finish(mut self) -> anyhow::Result<()> {
        drop(self.process.stdin.take());
        let status = self.process.wait().with_context(|| format!("cannot wait for `bench {}`", self.name))?;
        if !status.success() {
            bail!("`bench {}` failed ({status}); what it wrote above says why", self.name);
        }
        Ok(())
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Both fail only for a process that is gone, which is what is wanted.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
