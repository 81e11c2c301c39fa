//! Where programs connect, as `[acquisition.stream]` in a configuration says.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

/// Where the program that sends samples connects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StreamSettings {
    /// Where this computer waits for it. Anybody who can reach it can send samples, so by default only this computer can.
    pub address: SocketAddr,
}

impl Default for StreamSettings {
    fn default() -> StreamSettings {
        StreamSettings { address: SocketAddr::from(([127, 0, 0, 1], 5577)) }
    }
}
