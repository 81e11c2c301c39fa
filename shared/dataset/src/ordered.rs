//! Work on several threads whose results are taken in the order of the items, as if there were one thread.
//!
//! ```text
//! items 0 1 2 3 4 …   ─▶ threads, each takes the next free item
//!       results of 0  ─┐
//!       results of 1  ─┼▶ taken on the calling thread: all of 0, then all of 1, …
//!       results of 2  ─┘
//! ```
//! A thread that is ahead waits once results take too much memory; the one whose results are being taken never waits
//! for others.

use std::collections::{BTreeMap, VecDeque};
use std::ops::ControlFlow;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Memory of results that wait, above which threads wait instead.
const MAX_WAITING_BYTES: usize = 64 << 20;

/// What a thread does with a result: the result and the memory it takes, in bytes.
pub(crate) type Give<'a, R> = dyn FnMut(R, usize) -> ControlFlow<()> + 'a;

struct State<R> {
    /// The first item that has not been taken.
    next: usize,
    /// The item whose results are being taken.
    front: usize,
    results: BTreeMap<usize, Results<R>>,
    waiting_bytes: usize,
    is_stopped: bool,
}

struct Results<R> {
    waiting: VecDeque<(R, usize)>,
    are_all: bool,
}

struct Shared<R> {
    state: Mutex<State<R>>,
    changed: Condvar,
}

/// Runs `work` on every item, on `threads` threads. It gives results to its second argument, and must end when that
/// breaks off. `take` gets the results in order, until it breaks off.
pub(crate) fn in_order<I: Sync, R: Send>(
    threads: usize,
    items: &[I],
    work: impl Fn(&I, &mut Give<'_, R>) + Sync,
    mut take: impl FnMut(R) -> ControlFlow<()>,
) {
    let state = State { next: 0, front: 0, results: BTreeMap::new(), waiting_bytes: 0, is_stopped: false };
    let shared = Shared { state: Mutex::new(state), changed: Condvar::new() };
    thread::scope(|scope| {
        for _ in 0..threads.clamp(1, items.len().max(1)) {
            scope.spawn(|| {
                // A thread that panics must not leave the others waiting.
                let stop = StopOnPanic(&shared);
                while let Some(index) = shared.next_item(items.len()) {
                    work(&items[index], &mut |result, bytes| shared.give(index, result, bytes));
                    shared.lock().results.entry(index).or_default().are_all = true;
                    shared.changed.notify_all();
                }
                std::mem::forget(stop);
            });
        }
        for index in 0..items.len() {
            while let ControlFlow::Continue(Some(result)) = shared.next_result(index) {
                if take(result).is_break() {
                    shared.stop();
                }
            }
        }
        shared.stop();
    });
}

impl<R> Default for Results<R> {
    fn default() -> Results<R> {
        Results { waiting: VecDeque::new(), are_all: false }
    }
}

impl<R> Shared<R> {
    /// A thread that panicked has not left the state in between: it is only changed in small steps.
    fn lock(&self) -> MutexGuard<'_, State<R>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State<R>>) -> MutexGuard<'a, State<R>> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    fn stop(&self) {
        self.lock().is_stopped = true;
        self.changed.notify_all();
    }

    fn next_item(&self, items: usize) -> Option<usize> {
        let mut state = self.lock();
        if state.is_stopped || state.next == items {
            return None;
        }
        state.next += 1;
        Some(state.next - 1)
    }

    fn give(&self, index: usize, result: R, bytes: usize) -> ControlFlow<()> {
        let mut state = self.lock();
        loop {
            if state.is_stopped {
                return ControlFlow::Break(());
            }
            let has_room = state.waiting_bytes + bytes <= MAX_WAITING_BYTES;
            // The thread at the front always has room for one result; otherwise all would wait.
            let is_awaited = index == state.front
                && state.results.get(&index).is_none_or(|results| results.waiting.is_empty());
            if has_room || is_awaited {
                break;
            }
            state = self.wait(state);
        }
        state.waiting_bytes += bytes;
        state.results.entry(index).or_default().waiting.push_back((result, bytes));
        self.changed.notify_all();
        ControlFlow::Continue(())
    }

    /// The next result of the item at the front, `None` after its last; breaks off when stopped.
    fn next_result(&self, index: usize) -> ControlFlow<(), Option<R>> {
        let mut state = self.lock();
        loop {
            if state.is_stopped {
                return ControlFlow::Break(());
            }
            let results = state.results.entry(index).or_default();
            let are_all = results.are_all;
            if let Some((result, bytes)) = results.waiting.pop_front() {
                state.waiting_bytes -= bytes;
                self.changed.notify_all();
                return ControlFlow::Continue(Some(result));
            }
            if are_all {
                state.results.remove(&index);
                state.front = index + 1;
                self.changed.notify_all();
                return ControlFlow::Continue(None);
            }
            state = self.wait(state);
        }
    }
}

struct StopOnPanic<'a, R>(&'a Shared<R>);

impl<R> Drop for StopOnPanic<'_, R> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Items give as many results as they say, each as large as a third of what may wait.
    fn taken(threads: usize, items: &[usize], limit: usize) -> Vec<(usize, usize)> {
        let mut taken = Vec::new();
        in_order(
            threads,
            items,
            |&item, give| {
                for number in 0..item {
                    if give((item, number), MAX_WAITING_BYTES / 3 + 1).is_break() {
                        return;
                    }
                }
            },
            |result| {
                taken.push(result);
                if taken.len() == limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            },
        );
        taken
    }

    #[test]
    fn results_come_in_order_however_many_threads_there_are() {
        let items = [3, 0, 17, 1, 1, 5, 0, 0, 9, 2];
        let expected: Vec<(usize, usize)> =
            items.iter().flat_map(|&item| (0..item).map(move |number| (item, number))).collect();
        for threads in [1, 2, 3, 16] {
            assert_eq!(taken(threads, &items, usize::MAX), expected, "{threads} threads");
            for limit in [1, 4, 20, 38] {
                assert_eq!(taken(threads, &items, limit), expected[..limit], "{threads} threads");
            }
        }
        assert_eq!(taken(2, &[], usize::MAX), []);
    }

    #[test]
    fn what_waits_is_bounded() {
        let given = AtomicUsize::new(0);
        let mut largest_lead = 0;
        let mut seen = 0;
        in_order(
            4,
            &[50_usize; 8],
            |&item, give| {
                for _ in 0..item {
                    given.fetch_add(1, Ordering::Relaxed);
                    let _ = give((), MAX_WAITING_BYTES / 10);
                }
            },
            |()| {
                seen += 1;
                thread::yield_now();
                largest_lead = largest_lead.max(given.load(Ordering::Relaxed) - seen);
                ControlFlow::Continue(())
            },
        );
        assert_eq!(seen, 400);
        // Ten wait, one more at the front, and each thread holds one.
        assert!(largest_lead <= 15, "{largest_lead}");
    }

    #[test]
    #[should_panic(expected = "a scoped thread panicked")]
    fn a_panic_is_not_waited_for() {
        in_order(
            2,
            &[0, 1, 2],
            |&item, _: &mut Give<'_, ()>| assert!(item != 1),
            |()| ControlFlow::Continue(()),
        );
    }
}
