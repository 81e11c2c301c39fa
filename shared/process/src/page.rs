//! What a session and the program of its page tell each other.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

/// The variable of the environment by which a page gets the address and tokens of the one before it, so that a browser finds it
/// again. Whoever reads it does not hand it on to other programs.
pub const PAGE_VARIABLE: &str = "TENDON_PAGE";

/// The variables of the environment that tell a program its listening socket, whose file descriptor is `descriptor`: those of
/// socket activation, sd_listen_fds(3), with the first descriptor beside them, as the crate listenfd reads them.
pub fn socket_variables(descriptor: i32) -> [(&'static str, String); 2] {
    [("LISTEN_FDS", "1".to_owned()), ("LISTEN_FDS_FIRST_FD", descriptor.to_string())]
}

/// Where a page is, and its tokens. The page says it as one line of JSON on standard output once it listens.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PageKeys {
    /// Where it listens, as a browser on this machine gets there.
    pub address: SocketAddr,
    /// The token for orders; `None` where nobody may give any.
    pub orders: Option<String>,
    /// The token for those who watch.
    pub watch: String,
}

impl PageKeys {
    /// What to open in a browser, with orders and without.
    pub fn links(&self) -> (Option<String>, String) {
        let link = |token: &String| format!("http://{}/#{token}", self.address);
        (self.orders.as_ref().map(link), link(&self.watch))
    }
}
