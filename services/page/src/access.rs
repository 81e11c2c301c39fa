//! Who may see the page and who may give orders.
//!
//! ```text
//! request ─▶ Host known? ─▶ Origin absent or the same? ─▶ token known? ─▶ Rights
//!               403               403                        401
//! ```
//! Any web page that a browser shows can send requests to this machine. It cannot choose Host and Origin, and does not know
//! the token.

use std::net::{IpAddr, SocketAddr};

use axum::http::StatusCode;
use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use tendon_process::PageKeys;

/// What somebody with a token may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rights {
    /// See, and stop and arm.
    Orders,
    /// See.
    Watch,
}

impl Rights {
    /// As the page reads it.
    pub fn name(self) -> &'static str {
        match self {
            Rights::Orders => "orders",
            Rights::Watch => "watch",
        }
    }
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It names a machine that this is not.
    #[error("this page is not at that address: open the address that was printed")]
    Host,
    /// Another web page sent it.
    #[error("another web page must not use this one")]
    Origin,
    /// It has no token, or a wrong one.
    #[error("the token is missing or not that of this page: open the address that was printed")]
    Token,
}

impl Refusal {
    /// Of the answer.
    pub fn status(self) -> StatusCode {
        match self {
            Refusal::Host | Refusal::Origin => StatusCode::FORBIDDEN,
            Refusal::Token => StatusCode::UNAUTHORIZED,
        }
    }
}

/// What a request says of itself, and who sent it.
#[derive(Clone, Copy, Debug)]
pub struct Claimed<'a> {
    /// Its header Host.
    pub host: Option<&'a str>,
    /// Its header Origin.
    pub origin: Option<&'a str>,
    /// What stands behind `token=` in its address.
    pub token: Option<&'a str>,
    /// The machine that sent it.
    pub peer: IpAddr,
}

/// The page's address and its tokens.
#[derive(Debug)]
pub struct Access {
    address: SocketAddr,
    /// `None` where nobody may give orders.
    orders: Option<String>,
    watch: String,
}

impl Access {
    /// New tokens for a page at `address`.
    ///
    /// # Errors
    ///
    /// When the system gives no random numbers.
    pub fn new(address: SocketAddr, is_watch_only: bool) -> Result<Access, getrandom::Error> {
        let orders = if is_watch_only { None } else { Some(new_token()?) };
        Ok(Access { address, orders, watch: new_token()? })
    }

    /// The tokens of the page before, for the one at `address` that takes its place. Nobody gets more rights by that.
    pub fn again(address: SocketAddr, is_watch_only: bool, before: PageKeys) -> Access {
        let orders = before.orders.filter(|_| !is_watch_only);
        Access { address, orders, watch: before.watch }
    }

    /// Where to open the page, and its tokens.
    pub fn keys(&self) -> PageKeys {
        let mut address = self.address;
        if address.ip().is_unspecified() {
            let loopback = if address.is_ipv4() { "127.0.0.1" } else { "::1" };
            address.set_ip(loopback.parse().expect("a loopback address"));
        }
        PageKeys { address, orders: self.orders.clone(), watch: self.watch.clone() }
    }

    /// Whether `host` is this page: so no name that somebody else lets point to this machine is.
    ///
    /// # Errors
    ///
    /// [`Refusal::Host`].
    pub fn check_host(&self, host: Option<&str>) -> Result<(), Refusal> {
        let host = host.ok_or(Refusal::Host)?;
        let name = host.strip_suffix(&format!(":{}", self.address.port())).unwrap_or(host);
        let ip: Option<IpAddr> = name.trim_start_matches('[').trim_end_matches(']').parse().ok();
        // A number cannot be made to point elsewhere.
        let is_own =
            |ip: IpAddr| ip.is_loopback() || ip == self.address.ip() || self.address.ip().is_unspecified();
        let is_known = name.eq_ignore_ascii_case("localhost") || ip.is_some_and(is_own);
        if is_known { Ok(()) } else { Err(Refusal::Host) }
    }

    /// What whoever sent a request may do. Orders come from this machine only.
    ///
    /// # Errors
    ///
    /// [`Refusal`].
    pub fn rights(&self, claimed: &Claimed<'_>) -> Result<Rights, Refusal> {
        self.check_host(claimed.host)?;
        let own_origin = claimed.host.map(|host| format!("http://{host}"));
        if claimed.origin.is_some_and(|origin| Some(origin) != own_origin.as_deref()) {
            return Err(Refusal::Origin);
        }
        let token = claimed.token.ok_or(Refusal::Token)?;
        let is_here = claimed.peer.to_canonical().is_loopback() || claimed.peer == self.address.ip();
        match &self.orders {
            Some(orders) if is_same(orders, token) => {
                Ok(if is_here { Rights::Orders } else { Rights::Watch })
            }
            _ if is_same(&self.watch, token) => Ok(Rights::Watch),
            _ => Err(Refusal::Token),
        }
    }
}

/// 128 random bits.
fn new_token() -> Result<String, getrandom::Error> {
    let mut bits = [0; 16];
    getrandom::fill(&mut bits)?;
    Ok(BASE64_URL_SAFE_NO_PAD.encode(bits))
}

/// Takes as long wherever the first difference is.
fn is_same(ours: &str, theirs: &str) -> bool {
    let difference = ours.bytes().zip(theirs.bytes()).fold(0, |sum, (ours, theirs)| sum | (ours ^ theirs));
    ours.len() == theirs.len() && difference == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(address: &str, is_watch_only: bool) -> Access {
        Access::new(address.parse().unwrap(), is_watch_only).unwrap()
    }

    fn claimed<'a>(host: &'a str, token: &'a str) -> Claimed<'a> {
        Claimed { host: Some(host), origin: None, token: Some(token), peer: "127.0.0.1".parse().unwrap() }
    }

    #[test]
    fn a_token_gives_its_rights_and_nothing_else_gives_any() {
        let access = access("127.0.0.1:8423", false);
        let orders = access.orders.clone().unwrap();
        assert_ne!(orders, access.watch);
        assert_eq!(orders.len(), 22);
        let host = "127.0.0.1:8423";
        assert_eq!(access.rights(&claimed(host, &orders)), Ok(Rights::Orders));
        assert_eq!(access.rights(&claimed(host, &access.watch)), Ok(Rights::Watch));
        let longer = format!("{orders}A");
        for wrong in ["", "A", &orders[1..], &longer, &orders.to_lowercase()] {
            assert_eq!(access.rights(&claimed(host, wrong)), Err(Refusal::Token), "{wrong}");
        }
        let nothing = Claimed { token: None, ..claimed(host, "") };
        assert_eq!(access.rights(&nothing), Err(Refusal::Token));
    }

    #[test]
    fn another_host_or_origin_is_refused_with_the_right_token() {
        let access = access("127.0.0.1:8423", false);
        let token = access.orders.clone().unwrap();
        for host in ["localhost:8423", "LocalHost:8423", "[::1]:8423", "127.0.0.1:8423"] {
            let own = format!("http://{host}");
            let same = Claimed { origin: Some(&own), ..claimed(host, &token) };
            assert_eq!(access.rights(&same), Ok(Rights::Orders), "{host}");
        }
        for host in ["", "example.org", "example.org:8423", "127.0.0.1.example.org:8423", "192.168.1.5:8423"]
        {
            assert_eq!(access.rights(&claimed(host, &token)), Err(Refusal::Host), "{host}");
        }
        assert_eq!(access.rights(&Claimed { host: None, ..claimed("", &token) }), Err(Refusal::Host));
        let host = "127.0.0.1:8423";
        for origin in ["null", "http://example.org", "https://127.0.0.1:8423", "http://127.0.0.1:8424"] {
            let other = Claimed { origin: Some(origin), ..claimed(host, &token) };
            assert_eq!(access.rights(&other), Err(Refusal::Origin), "{origin}");
        }
    }

    #[test]
    fn other_machines_watch_and_a_page_without_orders_has_no_token_for_them() {
        let access_from_others = access("192.168.1.5:8423", false);
        let orders = access_from_others.orders.clone().unwrap();
        let from = |peer: &str| {
            let peer = peer.parse().unwrap();
            access_from_others.rights(&Claimed { peer, ..claimed("192.168.1.5:8423", &orders) })
        };
        assert_eq!(from("192.168.1.5"), Ok(Rights::Orders));
        assert_eq!(from("192.168.1.77"), Ok(Rights::Watch));
        let watch_only = access("127.0.0.1:8423", true).keys();
        assert_eq!(watch_only.links().0, None);
        assert_eq!(watch_only.links().1, format!("http://127.0.0.1:8423/#{}", watch_only.watch));
    }

    #[test]
    fn the_next_page_has_the_same_tokens_and_the_address_of_any_is_that_of_this_machine() {
        let address: SocketAddr = "0.0.0.0:8423".parse().unwrap();
        let keys = Access::new(address, false).unwrap().keys();
        assert_eq!(keys.address, "127.0.0.1:8423".parse().unwrap());
        assert_eq!(Access::again(address, false, keys.clone()).keys(), keys);
        assert_eq!(Access::again(address, true, keys.clone()).keys(), PageKeys { orders: None, ..keys });
    }
}
