//! What the arm's replies mean for the control connection.

use std::time::Instant;

use super::{Control, Identification, KEEP_ALIVE, Outstanding, Purpose};
use crate::Source;
use crate::client::lock;
use crate::client::status::{Halt, Phase};
use crate::command::register;
use crate::identity::{Identity, Text, Unsupported};
use crate::reply::{Reply, fault};

impl Control {
    pub(super) fn take_reply(&mut self, reply: &Reply<'_>) {
        self.was_answered(reply.transaction);
        if self.stop.is_some_and(|stop| stop.sent.is_some_and(|sent| sent.is_acknowledged_by(reply))) {
            self.stop = None;
            lock(&self.shared.known).status.stops_acknowledged += 1;
            return;
        }
        if let Some(gripper) = &mut self.gripper
            && gripper.take_reply(reply)
        {
            lock(&self.shared.known).status.gripper = gripper.read();
            return;
        }
        let is_expected = |outstanding: &mut Outstanding| {
            outstanding.transaction == reply.transaction && outstanding.register == reply.register
        };
        let Some(outstanding) = self.outstanding.take_if(is_expected) else {
            lock(&self.shared.known).status.late_replies += 1;
            return;
        };
        self.keep_alive_due = Instant::now() + KEEP_ALIVE;
        match outstanding.purpose {
            Purpose::Identity => self.take_identity(reply),
            Purpose::BringUp => self.take_step(reply),
            Purpose::Velocity => self.take_velocity_reply(reply),
            Purpose::Errors => self.take_errors(reply),
        }
    }

    /// The arm answers in order, so a reply answers all requests before it. A late one is a sign of life, too.
    fn was_answered(&mut self, transaction: u16) {
        let Some(place) = self.unanswered.iter().position(|&(sent, _)| sent == transaction) else { return };
        self.unanswered.drain(..=place);
        self.timeouts_in_a_row = 0;
        let status = &mut lock(&self.shared.known).status;
        status.answered_at = Some(Instant::now());
        status.unanswered_since = self.unanswered.front().map(|&(_, sent)| sent);
    }

    fn take_identity(&mut self, reply: &Reply<'_>) {
        let text = reply.text().ok().filter(|_| !reply.state.is_invalid()).unwrap_or_default();
        let (identity, outcome) = match self.identification {
            Identification::Version(version) => match Identity::parse(version.as_str(), text) {
                Ok(identity) => (Some(identity), identity.check()),
                Err(unsupported) => (None, Err(unsupported)),
            },
            _ if text.is_empty() => (None, Err(Unsupported::Version(Text::new(text)))),
            _ => {
                self.identification = Identification::Version(Text::new(text));
                return;
            }
        };
        self.identification = match outcome {
            Ok(()) => Identification::Supported,
            Err(_) => Identification::Refused,
        };
        let status = &mut lock(&self.shared.known).status;
        status.identity = identity;
        status.phase = Phase::Connected;
        if let Err(unsupported) = outcome {
            status.halt = Some(Halt::Unsupported(unsupported));
        }
    }

    /// A refused velocity is a halt: the arm would not do what is ordered.
    fn take_velocity_reply(&mut self, reply: &Reply<'_>) {
        if reply.state.has_error() || reply.state.is_invalid() || reply.state.is_not_ready() {
            self.halt(Halt::VelocityRefused);
            self.errors_wanted = true;
        }
    }

    /// The error and warning of the arm.
    fn take_errors(&mut self, reply: &Reply<'_>) {
        match fault(reply) {
            Ok(fault) => {
                lock(&self.shared.known).status.fault = fault;
                if let Some(fault) = fault.filter(|fault| fault.source == Source::Controller) {
                    self.halt(Halt::Fault(fault));
                    lock(&self.shared.known).explain(fault);
                }
            }
            Err(error) => tracing::warn!("{error}"),
        }
    }

    /// The reply to a step of bringing up.
    fn take_step(&mut self, reply: &Reply<'_>) {
        if reply.state.is_invalid() {
            self.halt(Halt::Refused(reply.register));
            self.errors_wanted = true;
            return;
        }
        if reply.register == register::GET_ERRORS {
            self.take_errors(reply);
        }
        if let Some(bring_up) = &mut self.bring_up {
            bring_up.advance();
        }
    }
}
