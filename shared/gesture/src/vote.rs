//! The paper's vote: the gesture with more than half of the last windows.

use crate::settings::MAXIMUM_VOTES;
use crate::{Gesture, GestureSet};

/// The last windows' gestures.
#[derive(Clone, Debug)]
pub(crate) struct Votes {
    votes: [Gesture; MAXIMUM_VOTES],
    count: usize,
    next: usize,
}

impl Votes {
    /// So many windows vote, all of them for rest at the beginning.
    pub(crate) fn new(count: usize) -> Votes {
        Votes { votes: [Gesture::REST; MAXIMUM_VOTES], count, next: 0 }
    }

    /// The gesture with more than half of the votes, this one included. Rest without such a majority, because an arm that
    /// waits does less harm than one that guesses.
    pub(crate) fn cast(&mut self, gestures: &GestureSet, gesture: Gesture) -> Gesture {
        self.votes[self.next] = gesture;
        self.next = (self.next + 1) % self.count;
        let votes = &self.votes[..self.count];
        gestures
            .iter()
            .find(|gesture| 2 * votes.iter().filter(|vote| *vote == gesture).count() > votes.len())
            .unwrap_or(Gesture::REST)
    }
}
