//! How far something has come that takes longer than two seconds: a bar on a terminal, else a line now and then.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Time between two lines where a bar cannot be drawn.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// Progress on standard error, gone when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    things: String,
    next_line: Instant,
}

impl Progress {
    /// Of `total` things that are called `things`.
    pub fn of(total: usize, things: &str) -> Progress {
        let style =
            ProgressStyle::with_template("{bar:30} {pos}/{len} {prefix}{msg}, {elapsed}, {eta} to go")
                .expect("the template is well formed");
        let bar = ProgressBar::new(total as u64).with_style(style).with_prefix(things.to_owned());
        Progress { bar, things: things.to_owned(), next_line: Instant::now() + LINE_INTERVAL }
    }

    /// That this many of them were done before; the time to go counts from here.
    pub fn go_on_from(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.bar.reset_eta();
    }

    /// That this many are done, with what else there is to say of it, such as `, 7 windows`.
    #[allow(clippy::print_stderr, reason = "progress is for the person who waits")]
    pub fn show(&mut self, done: usize, more: impl FnOnce() -> String) {
        if !self.bar.is_hidden() {
            self.bar.set_message(more());
            self.bar.set_position(done as u64);
        } else if Instant::now() >= self.next_line {
            self.next_line = Instant::now() + LINE_INTERVAL;
            let total = self.bar.length().unwrap_or_default();
            eprintln!("{done} of {total} {}{}", self.things, more());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
