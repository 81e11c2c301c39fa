//! The browser on this machine's screen.

use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use anyhow::Context;
use tendon_paths::{PrivateFolder, runtime_folder};
use tendon_process::PAGE_VARIABLE;

/// What opens a file with the program that the user has chosen for it.
const OPENER: &str = "xdg-open";

/// A file that leads a browser to the page. Its name may be seen by all users of this machine, as a command line is, but its
/// content, the token, only by this one. Removed when dropped.
#[derive(Debug)]
pub struct Signpost {
    folder: PrivateFolder,
    name: String,
}

impl Drop for Signpost {
    fn drop(&mut self) {
        // One that stays leads to a page that is gone.
        let _ = self.folder.remove(&self.name);
    }
}

/// Opens `link` in the browser, without waiting for it.
pub fn open(link: &str) -> anyhow::Result<Signpost> {
    let folder = runtime_folder()?;
    let name = format!("page-{}.html", std::process::id());
    folder.write(&name, content(link).as_bytes())?;
    let signpost = Signpost { folder, name };
    let mut opener = Command::new(OPENER)
        .arg(signpost.folder.path().join(&signpost.name))
        .env_remove(PAGE_VARIABLE)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        // It may be the browser itself, which goes on without the page.
        .process_group(0)
        .spawn()
        .with_context(|| format!("cannot start {OPENER}: open the page's address yourself"))?;
    let wait = move || drop(opener.wait());
    std::thread::Builder::new().name("browser".to_owned()).spawn(wait).context("cannot start a thread")?;
    Ok(signpost)
}

/// A page that leads to the link at once. Addresses and tokens need no escapes.
fn content(link: &str) -> String {
    format!(
        "<!doctype html><meta charset=\"utf-8\"><title>Tendon</title>\
         <meta http-equiv=\"refresh\" content=\"0; url={link}\"><a href=\"{link}\">Tendon</a>\n"
    )
}
