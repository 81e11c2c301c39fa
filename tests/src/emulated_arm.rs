//! An emulated arm of a test's own.

use std::net::IpAddr;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::wait_until;
use tendon_xarm_emulator::{Emulator, Listen, Properties};

/// Where sessions note that they have used an arm.
const TOKENS: &str = "/var/tmp/tendon-arms";

/// An emulated arm with a serial number that no other test's arm has at the time.
pub struct EmulatedArm {
    emulator: Emulator,
}

impl EmulatedArm {
    /// Listens on ports that are free.
    ///
    /// # Panics
    ///
    /// Without free ports.
    pub fn start() -> EmulatedArm {
        EmulatedArm::start_at(Listen::anywhere().address)
    }

    /// As [`EmulatedArm::start`], on another address.
    ///
    /// # Panics
    ///
    /// Without free ports.
    pub fn start_at(address: IpAddr) -> EmulatedArm {
        EmulatedArm::start_on(Listen { address, ..Listen::anywhere() })
    }

    /// As [`EmulatedArm::start`], on these ports, once they are free.
    ///
    /// # Panics
    ///
    /// When they stay taken.
    pub fn start_on(listen: Listen) -> EmulatedArm {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed) % 1000;
        let serial_number = format!("XI1300{:07}{number:03}", std::process::id());
        let properties = Properties { serial_number, ..Properties::default() };
        let emulator = wait_until("free ports", || Emulator::start_as(properties.clone(), listen).ok());
        EmulatedArm { emulator }
    }

    fn serial_number(&self) -> String {
        self.model().properties().serial_number.clone()
    }

    /// The file below `state_home` that says that the arm was left in good order.
    pub fn record(&self, state_home: &Path) -> PathBuf {
        state_home.join(format!("tendon/arms/{}.json", self.serial_number()))
    }

    /// Writes the record with which a session starts to move the arm by itself.
    ///
    /// # Panics
    ///
    /// When it cannot be written.
    pub fn leave_in_good_order(&self, state_home: &Path) {
        let record = self.record(state_home);
        let folder = record.parent().unwrap();
        std::fs::DirBuilder::new().recursive(true).create(folder).unwrap();
        let joints_rad = self.model().report().joints_rad.map(f64::from);
        let tokens = self.tokens().into_iter().map(|(user, path)| {
            let token = std::fs::read_to_string(path).unwrap();
            (user.to_string(), serde_json::Value::from(token))
        });
        let contents = serde_json::json!({
            "left_in_good_order_at_joints_rad": joints_rad,
            "tokens": tokens.collect::<serde_json::Map<_, _>>(),
        });
        std::fs::write(record, contents.to_string()).unwrap();
    }

    /// The users that have used the arm, and their tokens.
    fn tokens(&self) -> Vec<(u32, PathBuf)> {
        let prefix = format!("{}.", self.serial_number());
        let entries = std::fs::read_dir(TOKENS).into_iter().flatten().flatten();
        let of_arm = entries.filter_map(|entry| {
            let user = entry.file_name().to_str()?.strip_prefix(&prefix)?.parse().ok()?;
            Some((user, entry.path()))
        });
        of_arm.collect()
    }
}

impl Deref for EmulatedArm {
    type Target = Emulator;

    fn deref(&self) -> &Emulator {
        &self.emulator
    }
}

impl Drop for EmulatedArm {
    fn drop(&mut self) {
        for (_, token) in self.tokens() {
            // Those of other users are theirs to remove.
            let _ = std::fs::remove_file(token);
        }
    }
}
