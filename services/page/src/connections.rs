//! Connections of browsers that are not viewers. Each has a place, and a new one takes that of the oldest: whoever only holds
//! connections open keeps nobody out.
//!
//! ```text
//! accept ─▶ place free? ──────────▶ router ─┬─ answer, the next request
//!           else the oldest is closed       └─ WebSocket: a seat instead of the place
//! ```

use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::time::Duration;

use axum::extract::ConnectInfo;
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

/// Connections at a time: eight browsers need six each at most, and only for as long as they load the page.
const PLACES: usize = 48;
/// Time before another try where the system has no descriptor for a connection.
const RETRY: Duration = Duration::from_millis(100);

/// Answers requests by `router` until it is dropped.
pub async fn serve(listener: TcpListener, router: Router) -> Infallible {
    let mut places: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(RETRY).await;
            continue;
        };
        places.retain(|place| !place.is_finished());
        if places.len() == PLACES {
            places.pop_front().inspect(AbortHandle::abort);
        }
        places.push_back(tokio::spawn(answer(stream, peer, router.clone())).abort_handle());
    }
}

/// Answers the requests of one connection until it ends or becomes a WebSocket.
async fn answer(stream: TcpStream, peer: SocketAddr, router: Router) {
    let service = TowerToHyperService::new(router.layer(Extension(ConnectInfo(peer))));
    // One that breaks off needs no more.
    let _ = http1::Builder::new().serve_connection(TokioIo::new(stream), service).with_upgrades().await;
}
