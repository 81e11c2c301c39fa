//! The right to supervise a session.

use std::path::PathBuf;

use tendon_paths::{Claim, ClaimError, Holder, PathError, runtime_folder, user_name};

use crate::clock::now_ns;
use crate::session::{Run, SessionName, own_user};

/// The right to be the one supervisor of a session; given back when dropped or when the process dies.
#[derive(Debug)]
pub struct SessionLock {
    session: SessionName,
    run: Run,
    // Given back after the file of the run is gone.
    _claim: Claim,
}

/// Why a session cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum SessionLockError {
    /// Another supervisor runs it.
    #[error(
        "session `{session}` is in use by {holder}: stop that one, or choose another name (--set session=NAME)"
    )]
    InUse {
        /// Session name.
        session: SessionName,
        /// The other supervisor: process and, if it is another's, user.
        holder: String,
    },
    /// The system refused.
    #[error("cannot take session `{session}`")]
    System {
        /// Session name.
        session: SessionName,
        /// The system's reason.
        source: ClaimError,
    },
    /// There is no place for run-time state.
    #[error(transparent)]
    Folder(#[from] PathError),
}

impl SessionLock {
    /// Takes the session. No file stands for it, so nobody can remove it; the kernel knows who holds it.
    ///
    /// # Errors
    ///
    /// [`SessionLockError::InUse`] while another process holds it.
    pub fn take(session: &SessionName) -> Result<SessionLock, SessionLockError> {
        let run = Run { began_ns: now_ns(), folder: runtime_folder()? };
        let card = run.folder.path().to_string_lossy();
        match Claim::take(&session.claim_of(own_user()), &card) {
            Ok(claim) => {
                let lock = SessionLock { session: session.clone(), run, _claim: claim };
                lock.run.folder.write(&session.run_file(), lock.run.began_ns.to_string().as_bytes())?;
                Ok(lock)
            }
            Err(ClaimError::Held(holder)) => {
                let holder = match holder {
                    Some(Holder { process_id, user, .. }) if user == own_user() => {
                        format!("process {process_id}")
                    }
                    Some(Holder { process_id, user, .. }) => {
                        format!("process {process_id} of {}", user_name(user))
                    }
                    None => "another process".to_owned(),
                };
                Err(SessionLockError::InUse { session: session.clone(), holder })
            }
            Err(source) => Err(SessionLockError::System { session: session.clone(), source }),
        }
    }
}

impl SessionLock {
    /// Keeps the session's configuration where observers that it did not start find it. It goes with the session's other
    /// leftovers.
    ///
    /// # Errors
    ///
    /// [`PathError`] when it cannot be written.
    pub fn keep_configuration(&self, configuration: &str) -> Result<(), PathError> {
        self.run.folder.write(&self.session.configuration_file(&self.run), configuration.as_bytes())
    }

    pub(crate) fn session(&self) -> &SessionName {
        &self.session
    }

    /// The file that says which run goes on.
    pub(crate) fn run_file(&self) -> PathBuf {
        self.run.folder.path().join(self.session.run_file())
    }
}

impl Drop for SessionLock {
    fn drop(&mut self) {
        // What resists goes with what else the session left.
        let _ = std::fs::remove_file(self.run_file());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_supervisors_cannot_take_one_session() {
        let name: SessionName = format!("lock-{}", std::process::id()).parse().unwrap();
        let lock = SessionLock::take(&name).unwrap();
        let error = SessionLock::take(&name).unwrap_err();
        assert!(error.to_string().contains(&format!("in use by process {}", std::process::id())), "{error}");
        drop(lock);
        SessionLock::take(&name).unwrap();
    }
}
