//! How far something has come that takes longer than two seconds: a bar on a terminal, else a line now and then.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::output::tell;

/// Time between two lines where a bar cannot be drawn.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// Progress on standard error, gone when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    things: &'static str,
    next_line: Instant,
}

impl Progress {
    /// Of `total` things that are called `things`.
    pub fn of(total: usize, things: &'static str) -> Progress {
        let style =
            ProgressStyle::with_template("{bar:30} {pos}/{len} {prefix}{msg}, {elapsed}, {eta} to go")
                .expect("the template is well formed");
        let bar = ProgressBar::new(total as u64).with_style(style).with_prefix(things);
        Progress { bar, things, next_line: Instant::now() + LINE_INTERVAL }
    }

    /// Says that this many were done before; the time to go counts from here.
    pub fn go_on_from(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.bar.reset_eta();
    }

    /// Says that this many are done, and what else there is to say, such as `, 7 windows`.
    pub fn show(&mut self, done: usize, more: impl FnOnce() -> String) {
        if !self.bar.is_hidden() {
            self.bar.set_message(more());
            self.bar.set_position(done as u64);
        } else if Instant::now() >= self.next_line {
            self.next_line = Instant::now() + LINE_INTERVAL;
            let total = self.bar.length().unwrap_or_default();
            tell(format_args!("{done} of {total} {}{}", self.things, more()));
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Progress of a series of works, each of which counts from 0 again.
#[derive(Debug, Default)]
pub struct Works {
    current: Option<(usize, Progress)>,
}

impl Works {
    /// Shows that `done` of `total` are done; a smaller number than before starts the next work.
    pub fn show(&mut self, done: usize, total: usize, things: &'static str, more: impl FnOnce() -> String) {
        if self.current.as_ref().is_none_or(|(before, _)| done < *before) {
            self.current = Some((0, Progress::of(total, things)));
        }
        if let Some((before, progress)) = &mut self.current {
            *before = done;
            progress.show(done, more);
        }
    }

    /// The work is done: the bar goes.
    pub fn clear(&mut self) {
        self.current = None;
    }
}
