//! The server: files, and one WebSocket a viewer.
//!
//! ```text
//! GET /ws ─▶ Access ─▶ seat free? ─▶ upgrade ─┬─ writing: hello, desk, then every update, answers; 5 s for each at most
//!                         503                 └─ reading: ping, orders, requests; whatever is too long, too often or no message
//!                                                of the page, and silence of a minute, end the connection
//! ```

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{ConnectInfo, RawQuery, Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream::SplitStream;
use futures_util::{Sink, SinkExt, StreamExt};
use serde::Deserialize;
use serde_json::json;
use tendon_process::Answer;
use tendon_transport::now_ns;
use tokio::net::TcpListener;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::access::{Access, Claimed, Rights};
use crate::connections;
use crate::files::Files;
use crate::orders::{Orders, Told, What};
use crate::requests::{Requests, Wish};
use crate::watching::Audience;

/// Viewers at a time.
const SEATS: usize = 8;
/// Seats among them that nobody takes who may only watch: whoever may stop the arm finds one.
const KEPT_FOR_ORDERS: usize = 2;
/// Longest message of a viewer, bytes.
const LONGEST_MESSAGE: usize = 4096;
/// Most messages of a viewer in a second.
const MOST_MESSAGES: u32 = 50;
/// How long a viewer may take for one message before it is left.
const PATIENCE: Duration = Duration::from_secs(5);
/// Time between two pings to a viewer, which its browser answers by itself, also while the page sleeps.
const PING: Duration = Duration::from_secs(5);
/// How long a viewer may be silent before it is left: its machine may be gone.
const SILENCE: Duration = Duration::from_secs(60);
/// Why the connection ends, for the page: the session has ended as it should.
const SESSION_ENDED: &str = "session-ended";
/// Answers and pongs that wait for a slow viewer.
const WAITING: usize = 64;

/// What every answer says to the browser: nothing from elsewhere, and in no other page.
const SAFETY: [(&str, &str); 5] = [
    (
        "content-security-policy",
        "default-src 'self'; connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
];

/// What the requests share.
#[derive(Debug)]
pub struct Page {
    /// Who may do what.
    pub access: Access,
    /// What is shown.
    pub files: Files,
    /// What the viewers are told.
    pub audience: Arc<Audience>,
    /// The way to the robot.
    pub orders: Orders,
    /// The way to the supervisor and the recorder.
    pub requests: Requests,
    seats: Arc<Semaphore>,
    seats_for_orders: Arc<Semaphore>,
}

impl Page {
    /// Without viewers.
    pub fn new(
        access: Access,
        files: Files,
        audience: Arc<Audience>,
        orders: Orders,
        requests: Requests,
    ) -> Page {
        let seats = Arc::new(Semaphore::new(SEATS - KEPT_FOR_ORDERS));
        let seats_for_orders = Arc::new(Semaphore::new(KEPT_FOR_ORDERS));
        Page { access, files, audience, orders, requests, seats, seats_for_orders }
    }

    /// A seat for somebody with these rights, if there is one.
    fn seat(&self, rights: Rights) -> Option<OwnedSemaphorePermit> {
        let free = |seats: &Arc<Semaphore>| seats.clone().try_acquire_owned().ok();
        let kept = (rights == Rights::Orders).then(|| free(&self.seats_for_orders)).flatten();
        kept.or_else(|| free(&self.seats))
    }
}

/// Serves until it is dropped.
///
/// # Errors
///
/// When the listener cannot be used.
pub async fn serve(listener: std::net::TcpListener, page: Arc<Page>) -> std::io::Result<()> {
    let router = Router::new()
        .route("/ws", get(enter))
        .fallback(get(file))
        .layer(axum::middleware::from_fn_with_state(page.clone(), guard))
        .with_state(page);
    let listener = TcpListener::from_std(listener)?;
    match connections::serve(listener, router).await {}
}

/// Refuses requests to names that are not this page's, and adds the headers of safety.
async fn guard(State(page): State<Arc<Page>>, request: Request, next: Next) -> Response {
    let mut response = match page.access.check_host(text(request.headers(), &HOST)) {
        Ok(()) => next.run(request).await,
        Err(refusal) => (refusal.status(), refusal.to_string()).into_response(),
    };
    for (name, value) in SAFETY {
        response.headers_mut().insert(
            HeaderName::from_static(name),
            value.parse().expect("the constants are header values: tested"),
        );
    }
    response
}

async fn file(State(page): State<Arc<Page>>, request: Request) -> Response {
    page.files.answer(request.uri().path(), request.headers())
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).map(|value| value.to_str().unwrap_or("?"))
}

/// Lets a viewer in.
async fn enter(
    State(page): State<Arc<Page>>,
    ConnectInfo(peer): ConnectInfo<SocketAddr>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let query = query.unwrap_or_default();
    let claimed = Claimed {
        host: text(&headers, &HOST),
        origin: text(&headers, &ORIGIN),
        token: query.split('&').find_map(|pair| pair.strip_prefix("token=")),
        peer: peer.ip(),
    };
    let rights = match page.access.rights(&claimed) {
        Ok(rights) => rights,
        Err(refusal) => return (refusal.status(), refusal.to_string()).into_response(),
    };
    let Some(seat) = page.seat(rights) else {
        let words = format!("{SEATS} browsers look at this session already: close one");
        return (StatusCode::SERVICE_UNAVAILABLE, words).into_response();
    };
    match upgrade {
        Ok(upgrade) => upgrade
            .max_message_size(LONGEST_MESSAGE)
            .max_frame_size(LONGEST_MESSAGE)
            .on_upgrade(move |socket| attend(socket, page, rights, seat)),
        Err(rejection) => rejection.into_response(),
    }
}

/// Attends to a viewer until either side ends it.
async fn attend(socket: WebSocket, page: Arc<Page>, rights: Rights, _seat: OwnedSemaphorePermit) {
    let (output, input) = socket.split();
    let (answers, answered) = channel(WAITING);
    // Reading goes on while writing waits: a stop is heard from a browser that does not read.
    tokio::select! {
        () = tell(output, &page, rights, answered) => {}
        () = hear(input, &page, rights, answers) => {}
    }
}

/// Tells a viewer everything, until it takes nothing more.
async fn tell(
    mut output: impl Sink<Message> + Unpin,
    page: &Page,
    rights: Rights,
    mut answered: Receiver<Reply>,
) {
    let mut hello = page.audience.hello.subscribe();
    hello.mark_changed();
    let mut desk = page.audience.desk.subscribe();
    let mut updates = page.audience.updates.subscribe();
    let mut has_ended = page.audience.has_ended.subscribe();
    let mut pings = tokio::time::interval(PING);
    loop {
        let messages: Arc<[Message]> = tokio::select! {
            biased;
            Ok(()) = has_ended.changed() => {
                let goodbye = Message::Close(Some(CloseFrame { code: close_code::AWAY, reason: SESSION_ENDED.into() }));
                // Whoever takes nothing any more is not told.
                let _ = tokio::time::timeout(PATIENCE, output.send(goodbye)).await;
                return;
            }
            _ = pings.tick() => [Message::Ping(Bytes::new())].into(),
            Some(reply) = answered.recv() => [Message::Text(reply.text().into())].into(),
            Ok(()) = hello.changed() => {
                let mut facts = hello.borrow_and_update().clone();
                facts.iter_mut().for_each(|facts| facts["rights"] = rights.name().into());
                let hello = Message::Text(json!({ "hello": facts }).to_string().into());
                // With a hello the page forgets all that it knew.
                [hello, Message::Text(desk.borrow_and_update().message(rights))].into()
            }
            Ok(()) = desk.changed() => {
                [Message::Text(desk.borrow_and_update().message(rights))].into()
            }
            update = updates.recv() => match update {
                Ok(update) => update,
                // It is slow: it goes on with what is new.
                Err(RecvError::Lagged(_)) => continue,
                Err(RecvError::Closed) => return,
            },
        };
        let mut messages = futures_util::stream::iter(messages.iter().cloned().map(Ok));
        match tokio::time::timeout(PATIENCE, output.send_all(&mut messages)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) | Err(_) => return,
        }
    }
}

/// What one viewer alone is told.
#[derive(Debug)]
enum Reply {
    Pong { t: f64 },
    Told(Told),
}

impl Reply {
    fn text(self) -> String {
        match self {
            Reply::Pong { t } => json!({"pong": {"t": t, "now_ns": now_ns()}}).to_string(),
            Reply::Told(told) => json!({ "answer": told }).to_string(),
        }
    }
}

/// What a viewer says.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum Said {
    Ping {
        t: f64,
    },
    Order {
        id: u64,
        what: What,
        /// When the arm was as the page shows it, as the newest state says. Without it an order to arm is too late.
        #[serde(default)]
        seen_ns: u64,
    },
    Request {
        id: u64,
        what: Wish,
    },
}

/// The answer to somebody who gives an order or asks for something and may only watch.
fn refusal(id: u64, order: &'static str) -> Told {
    let answer =
        Answer::refused("this address only watches: open the one for orders on the session's machine");
    Told { id, order, answer: answer.with_key("only-watches") }
}

/// Hears a viewer until it says what no page of ours says.
async fn hear(mut input: SplitStream<WebSocket>, page: &Page, rights: Rights, replies: Sender<Reply>) {
    let (answers, mut answered) = channel(WAITING);
    let mut pace = Pace::new(Instant::now());
    let mut heard = Instant::now();
    loop {
        let message = tokio::select! {
            biased;
            Some(told) = answered.recv() => {
                if replies.try_send(Reply::Told(told)).is_err() {
                    return;
                }
                continue;
            }
            message = tokio::time::timeout_at((heard + SILENCE).into(), input.next()) => message,
        };
        let Ok(Some(Ok(message))) = message else { return };
        heard = Instant::now();
        if !pace.allows(Instant::now()) {
            return;
        }
        let said = match message {
            Message::Text(text) => serde_json::from_str(&text),
            Message::Ping(_) | Message::Pong(_) => continue,
            Message::Binary(_) | Message::Close(_) => return,
        };
        match said {
            Ok(Said::Ping { t }) => {
                if replies.try_send(Reply::Pong { t }).is_err() {
                    return;
                }
            }
            Ok(Said::Order { id, what, seen_ns }) if rights == Rights::Orders => {
                page.orders.give(id, what, seen_ns, answers.clone())
            }
            Ok(Said::Request { id, what }) if rights == Rights::Orders => {
                page.requests.pass(id, what, answers.clone())
            }
            // A viewer that takes no answers gets none.
            Ok(Said::Order { id, what, .. }) => drop(answers.try_send(refusal(id, what.name()))),
            Ok(Said::Request { id, what }) => drop(answers.try_send(refusal(id, what.name()))),
            Err(_) => return,
        }
    }
}

/// Counts a viewer's messages by the second.
#[derive(Debug)]
struct Pace {
    since: Instant,
    messages: u32,
}

impl Pace {
    fn new(now: Instant) -> Pace {
        Pace { since: now, messages: 0 }
    }

    /// Whether one more message is in order.
    fn allows(&mut self, now: Instant) -> bool {
        if now.duration_since(self.since) >= Duration::from_secs(1) {
            *self = Pace::new(now);
        }
        self.messages += 1;
        self.messages <= MOST_MESSAGES
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use tendon_transport::SessionName;
    use tokio::sync::mpsc::unbounded_channel;

    #[test]
    fn the_headers_of_safety_are_headers() {
        for (name, value) in SAFETY {
            assert_eq!(HeaderName::from_static(name).as_str(), name);
            assert!(value.parse::<HeaderValue>().is_ok(), "{value}");
        }
    }

    #[test]
    fn a_viewer_that_comes_early_is_told_the_desk_with_every_hello() {
        let audience = Arc::new(Audience::new());
        let name: SessionName = "early".parse().unwrap();
        let access = Access::new(SocketAddr::from(([127, 0, 0, 1], 1)), false).unwrap();
        let (orders, requests) = (Orders::new(name.clone()), Requests::new(name));
        let page = Page::new(access, Files::new().unwrap(), audience.clone(), orders, requests);
        audience.desk.send_modify(|desk| desk.facts = json!({"person": "anna"}));
        let (said, mut heard) = unbounded_channel();
        let output = futures_util::sink::unfold(said, |said, message: Message| async move {
            said.send(message).map(|()| said)
        });
        let (_replies, answered) = channel(1);
        let checking = async {
            let mut next_text = async || loop {
                if let Some(Message::Text(text)) = heard.recv().await {
                    return text.to_string();
                }
            };
            assert_eq!(next_text().await, r#"{"hello":null}"#);
            assert_eq!(next_text().await, r#"{"desk":{"person":"anna"}}"#);
            for _ in 0..2 {
                audience.hello.send_replace(Some(json!({})));
                assert_eq!(next_text().await, r#"{"hello":{"rights":"orders"}}"#);
                assert_eq!(next_text().await, r#"{"desk":{"person":"anna"}}"#);
            }
        };
        tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap().block_on(async {
            tokio::select! {
                () = tell(Box::pin(output), &page, Rights::Orders, answered) => panic!("it went"),
                () = checking => {}
            }
        });
    }

    #[test]
    fn fifty_messages_in_a_second_are_in_order_and_one_more_is_not() {
        let begun = Instant::now();
        let mut pace = Pace::new(begun);
        assert!((0..MOST_MESSAGES).all(|_| pace.allows(begun)));
        assert!(!pace.allows(begun + Duration::from_millis(999)));
        assert!(pace.allows(begun + Duration::from_secs(1)));
    }

    #[test]
    fn only_what_the_page_says_is_understood() {
        let understood = |text: &str| serde_json::from_str::<Said>(text).is_ok();
        assert!(understood(r#"{"ping":{"t":12.5}}"#));
        assert!(understood(r#"{"order":{"id":1,"what":"stop"}}"#));
        assert!(understood(r#"{"order":{"id":1,"what":"arm","seen_ns":7}}"#));
        assert!(understood(r#"{"request":{"id":1,"what":{"note":"electrode 3 is loose"}}}"#));
        assert!(understood(r#"{"request":{"id":1,"what":{"record":true}}}"#));
        assert!(understood(r#"{"request":{"id":1,"what":{"calibration":"go-on"}}}"#));
        for text in [
            "",
            "{}",
            r#"{"order":{"id":1,"what":"start"}}"#,
            r#"{"order":{"id":-1,"what":"stop"}}"#,
            r#"{"order":{"id":1,"what":"arm","seen_ns":-7}}"#,
            r#"{"order":{"what":"stop"}}"#,
            r#"{"request":{"id":1,"what":{"note":7}}}"#,
            r#"{"request":{"id":1,"what":{"note":"a","record":true}}}"#,
            r#"{"request":{"id":1,"what":"stop"}}"#,
            r#"{"request":{"what":{"record":true}}}"#,
            r#"{"order":{"id":1,"what":"arm","also":1}}"#,
            r#"{"ping":{"t":1},"order":{"id":1,"what":"arm"}}"#,
        ] {
            assert!(!understood(text), "{text}");
        }
    }
}
