//! Whole sessions: `tendon run` as a user starts it, and its report.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use tendon_report::Report;

/// The program `tendon` beside this one; `None`, said on the terminal, where it has not been built.
pub fn program() -> anyhow::Result<Option<PathBuf>> {
    let program =
        std::env::current_exe().context("cannot find this program's file")?.with_file_name("tendon");
    if program.exists() {
        return Ok(Some(program));
    }
    println!("\nSessions are left out: {} has not been built", program.display());
    Ok(None)
}

/// Runs a session to its end.
///
/// # Errors
///
/// What the session said when it failed.
pub fn run(program: &PathBuf, options: &[&str]) -> anyhow::Result<Report> {
    let directory = tempfile::tempdir().context("cannot make a folder for a report")?;
    let report = directory.path().join("report.json");
    let output = Command::new(program)
        .arg("run")
        .args(options)
        .arg("--json")
        .arg(&report)
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("cannot start {}", program.display()))?;
    if !output.status.success() {
        bail!("`tendon run` failed ({}): {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    let text = std::fs::read_to_string(&report).context("`tendon run` wrote no report")?;
    serde_json::from_str(&text).context("the report of `tendon run`")
}
