//! Orders of viewers, to the robot's own socket: nothing that this program or the session does is in their way.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tendon_process::{Answer, Order, OrderError, order_robot, with_causes};
use tendon_transport::{SessionName, own_user};
use tokio::sync::Mutex;
use tokio::sync::mpsc::Sender;

/// What the page can order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// Stop the arm.
    Stop,
    /// Permit motion again.
    Arm,
}

impl What {
    /// Its name in the answer.
    pub fn name(self) -> &'static str {
        match self {
            What::Stop => "stop",
            What::Arm => "arm",
        }
    }
}

/// What came of an order or a request.
#[derive(Clone, Debug, Serialize)]
pub struct Told {
    /// The number that the page gave it.
    pub id: u64,
    /// Its name.
    pub order: &'static str,
    /// The word of whoever was asked, or why nobody was.
    #[serde(flatten)]
    pub answer: Answer,
}

/// The way to the robot of one session.
#[derive(Debug)]
pub struct Orders {
    session: SessionName,
    /// Held while the robot is being asked to arm, which can take seconds.
    arming: Arc<Mutex<()>>,
}

impl Orders {
    /// To the robot of this session.
    pub fn new(session: SessionName) -> Orders {
        Orders { session, arming: Arc::default() }
    }

    /// Gives the robot an order of somebody to whom the page showed the arm as it was at `seen_ns`; its answer goes to
    /// `answers` when it comes. The robot refuses an order to arm by somebody who cannot have seen the newest stop.
    pub fn give(&self, id: u64, order: What, seen_ns: u64, answers: Sender<Told>) {
        let told = move |answer| Told { id, order: order.name(), answer };
        let (order, arming) = match order {
            What::Stop => (Order::Stop, None),
            What::Arm => match self.arming.clone().try_lock_owned() {
                Ok(arming) => (Order::arm_shown_at(seen_ns), Some(arming)),
                Err(_) => {
                    let answer =
                        Answer::refused("the robot is already being asked to arm: wait for its answer");
                    let _ = answers.try_send(told(answer.with_key("arming")));
                    return;
                }
            },
        };
        let session = self.session.clone();
        tokio::spawn(async move {
            let answer = ask(session, order).await;
            drop(arming);
            // Whoever asked may be gone.
            let _ = answers.send(told(answer)).await;
        });
    }
}

/// Asks the robot in a thread that may wait. Whether it obeyed, and what it said.
async fn ask(session: SessionName, order: Order) -> Answer {
    let asked = tokio::task::spawn_blocking(move || order_robot(&session, Some(own_user()), order));
    match asked.await {
        Ok(Ok(answer)) => answer,
        Ok(Err(error)) => {
            let refused = Answer::refused(with_causes(&error));
            match error {
                OrderError::Find(_) => refused.with_key("session-not-running"),
                OrderError::NoAnswer(_) => refused.with_key("robot-silent"),
                OrderError::NotListening(_) => refused.with_key("robot-not-listening"),
                OrderError::Nonsense(_) | OrderError::Socket { .. } => refused,
            }
        }
        Err(error) => Answer::refused(format!("the order was not given: {error}")),
    }
}
