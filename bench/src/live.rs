//! A live session of all stages: idle and with saturated cores, with real-time scheduling and without rights.
//!
//! Before each one a *bare timer* says what the machine itself allows: how late a thread wakes that does nothing
//! but sleep until the next multiple of a block's 5 ms. A virtual machine whose host is busy, or a laptop that
//! sleeps deeply, wakes late; no session can then be faster.

use std::time::{Duration, Instant};

use serde::Serialize;
use tendon_report::{LatencySummary, Report, duration_histogram};

use crate::{busy, session};

/// A session in one condition.
#[derive(Debug, Serialize)]
pub struct Live {
    saturated: bool,
    /// Of dsp; the other stages have the same but for the priority.
    scheduling: String,
    cpu_percent: f64,
    /// How late a thread wakes that only sleeps, just before the session; of the default scheduling policy.
    bare_timer_late: LatencySummary,
    report: Report,
}

/// Time between two wakes of the bare timer: a block's.
const BARE_TIMER_PERIOD: Duration = Duration::from_millis(5);
/// How long the bare timer is measured.
const BARE_TIMER_DURATION: Duration = Duration::from_secs(5);

/// Runs four sessions of `seconds` each on the simulated amplifier; `None` where `tendon` has not been built.
pub fn measure(seconds: f64, cores: usize) -> anyhow::Result<Option<Vec<Live>>> {
    let Some(program) = session::program()? else { return Ok(None) };
    let mut sessions = Vec::new();
    println!("\nLive session, simulated amplifier, {seconds} s each");
    for realtime in ["auto", "off"] {
        for saturated in [false, true] {
            let busy = if saturated { busy::saturate(cores)? } else { Vec::new() };
            let bare_timer_late = bare_timer_late();
            let duration = format!("{seconds}s");
            let report = session::run(
                &program,
                &["--session", "bench-live", "--duration", &duration, "--realtime", realtime],
            )?;
            drop(busy);
            let scheduling = report.scheduling.get("dsp").cloned().unwrap_or_default();
            let cpu_percent = 100.0 * report.cpu_s.values().sum::<f64>() / report.duration_s;
            let live = Live { saturated, scheduling, cpu_percent, bare_timer_late, report };
            live.print();
            sessions.push(live);
        }
    }
    Ok(Some(sessions))
}

/// Sleeps until the next due time, again and again, and measures how late that is.
fn bare_timer_late() -> LatencySummary {
    let mut late = duration_histogram();
    let start = Instant::now();
    let mut due = Duration::ZERO;
    while due < BARE_TIMER_DURATION {
        due += BARE_TIMER_PERIOD;
        std::thread::sleep(due.saturating_sub(start.elapsed()));
        late.saturating_record(start.elapsed().saturating_sub(due).as_nanos() as u64);
    }
    LatencySummary::of(&late)
}

impl Live {
    fn print(&self) {
        let load = if self.saturated { "every core saturated" } else { "no load added" };
        println!("  {load}, {}", self.scheduling);
        println!("    {:<26}  {}", "", crate::COLUMNS);
        let row =
            |name: &str, latency: &LatencySummary| println!("    {name:<26}  {}", crate::columns(latency));
        row("bare timer, alone", &self.bare_timer_late);
        for hop in &self.report.hops {
            row(&format!("{} to {}", hop.from, hop.to), &hop.transit);
        }
        row("newest sample to command", &self.report.newest_sample_to_command);
        let window = &self.report.window_start_to_command;
        let lost: u64 = self.report.messages.values().map(|topic| topic.lost + topic.stale).sum::<u64>()
            + self.report.skipped_blocks;
        println!(
            "    window start to command: mean {:.2} ms, sd {:.2}; {lost} messages lost, stale or skipped; processor {:.1} % of \
             a core, memory {:.0} MB",
            window.mean_ms,
            window.sd_ms,
            self.cpu_percent,
            self.report.memory_mb.values().sum::<f64>()
        );
    }
}
