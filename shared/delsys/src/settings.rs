//! Where the server is, as `[acquisition.delsys]` in a configuration says.

use std::net::{IpAddr, Ipv4Addr};

use serde::{Deserialize, Serialize};

/// The computer on which the Trigno Control Utility runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DelsysSettings {
    /// Its address. Default: this computer.
    pub address: IpAddr,
    /// Port of its commands. Default: 50040.
    pub command_port: u16,
    /// Port of its EMG samples. Default: 50043.
    pub emg_port: u16,
}

impl Default for DelsysSettings {
    fn default() -> DelsysSettings {
        DelsysSettings { address: Ipv4Addr::LOCALHOST.into(), command_port: 50040, emg_port: 50043 }
    }
}
