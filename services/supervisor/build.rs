//! Tells the program the commit that it is built from; `unknown` where this folder is in no repository of its own.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    // Unpacked inside somebody else's repository, that one's commit would say nothing.
    let is_ours = git(&["ls-files", "--error-unmatch", "Cargo.toml"]).is_some();
    let commit = git(&["rev-parse", "HEAD"]).filter(|_| is_ours);
    // Git appends to this file with every commit and checkout, and at no other time.
    let log = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|path| Path::new(path).is_file());
    if let Some(log) = log.filter(|_| is_ours) {
        println!("cargo:rerun-if-changed={log}");
    }
    println!("cargo:rustc-env=TENDON_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
}
