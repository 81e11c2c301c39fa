//! The report as a table for people, and the table that `tendon latency` shows while a session runs.

use std::fmt::{Result, Write};
use std::time::Duration;

use tendon_messages::Stage;

use crate::measurements::SessionMeasurements;
use crate::report::{LatencySummary, Recognition, Report};

const TOPICS: [&str; 4] = ["blocks", "windows", "predictions", "commands"];

impl Report {
    /// The report as a table for people.
    pub fn table(&self) -> String {
        let mut table = String::new();
        self.write_table(&mut table).expect("writing to a String cannot fail");
        table
    }

    fn write_table(&self, out: &mut String) -> Result {
        write_heading(out, "")?;
        writeln!(out, "transit (publish to receive)")?;
        for hop in &self.hops {
            write_latency(out, &format!("{} to {}", hop.from, hop.to), &hop.transit)?;
        }
        writeln!(out, "work (receive to publish)")?;
        for work in &self.work {
            write_latency(out, &work.stage, &work.work)?;
        }
        self.write_whole_path(out)?;
        self.write_messages(out)?;
        self.write_recognition(out)?;
        self.write_resources(out)?;
        if let Some(speed) = self.replay_x_real_time {
            writeln!(out, "replay  {speed:.0} x real time")?;
        }
        if let Some(task) = &self.task {
            writeln!(out, "{task}")?;
        }
        Ok(())
    }

    fn write_whole_path(&self, out: &mut String) -> Result {
        writeln!(out, "whole path")?;
        write_latency(out, "newest sample to command", &self.newest_sample_to_command)?;
        let window = &self.window_start_to_command;
        writeln!(
            out,
            "  window start to command: mean {:.1} ms, sd {:.2}, min {:.1}, median {:.1}, max {:.1} \
             (the paper: mean 324, sd 14.6, min 297, median 326, max 356)",
            window.mean_ms, window.sd_ms, window.min_ms, window.median_ms, window.max_ms
        )?;
        if self.control_tick.count > 0 {
            write_latency(out, "robot's control tick, lateness", &self.control_tick)?;
        }
        if self.command_to_wire.count > 0 {
            write_latency(out, "command to the arm's network", &self.command_to_wire)?;
        }
        Ok(())
    }

    fn write_messages(&self, out: &mut String) -> Result {
        write!(out, "messages")?;
        for topic in TOPICS {
            let counts = self.messages.get(topic).copied().unwrap_or_default();
            write!(out, "  {topic} {} (lost {}, stale {})", counts.published, counts.lost, counts.stale)?;
        }
        writeln!(out)?;
        if self.restarts > 0 {
            writeln!(out, "stages  ended and were started again: {}", self.restarts)?;
        }
        if self.lost_samples > 0 {
            writeln!(out, "source  samples lost of each channel: {}", self.lost_samples)?;
        }
        if self.skipped_blocks > 0 {
            writeln!(
                out,
                "source  blocks lost, or too late to act upon and left out: {}",
                self.skipped_blocks
            )?;
        }
        if let Some(drift_ppm) = self.clock_drift_ppm {
            let than = if drift_ppm < 0.0 { "slower" } else { "faster" };
            writeln!(out, "source  its clock counts {:.1} ppm {than} than this computer's", drift_ppm.abs())?;
        }
        if self.lost_measurement_batches > 0 {
            writeln!(
                out,
                "measurements  {} batches came too fast to be gathered: the latencies lack their messages",
                self.lost_measurement_batches
            )?;
        }
        if self.replaced_samples > 0 {
            writeln!(out, "samples  {} were NaN or infinite and were replaced", self.replaced_samples)?;
        }
        Ok(())
    }

    fn write_recognition(&self, out: &mut String) -> Result {
        let Recognition { windows, correct, per_gesture } = &self.recognition;
        if *windows == 0 {
            return writeln!(out, "recognition  no window lay wholly inside a known gesture");
        }
        write!(
            out,
            "recognition  {correct} of {windows} windows inside a gesture ({:.1} %):",
            percent(*correct, *windows)
        )?;
        for (gesture, recognition) in per_gesture {
            write!(out, "  {gesture} {:.0} %", percent(recognition.correct, recognition.windows))?;
        }
        writeln!(out)
    }

    fn write_resources(&self, out: &mut String) -> Result {
        let share = |seconds: f64| 100.0 * seconds / self.duration_s.max(1e-9);
        write!(out, "processor  {:.1} % of one core:", share(self.cpu_s.values().sum()))?;
        for (process, seconds) in &self.cpu_s {
            write!(out, "  {process} {:.2}", share(*seconds))?;
        }
        writeln!(out)?;
        write!(out, "memory  {:.0} MB:", self.memory_mb.values().sum::<f64>())?;
        for (process, megabytes) in &self.memory_mb {
            write!(out, "  {process} {megabytes:.0}")?;
        }
        writeln!(out)
    }
}

/// The latencies that were gathered in the last `elapsed` of a session that runs on.
pub fn running_table(elapsed: Duration, measurements: &SessionMeasurements) -> String {
    let mut table = String::new();
    write_running_table(&mut table, elapsed, measurements).expect("writing to a String cannot fail");
    table
}

fn write_running_table(out: &mut String, elapsed: Duration, measurements: &SessionMeasurements) -> Result {
    write_heading(out, &format!("observed for {:.0} s", elapsed.as_secs_f64()))?;
    for stage in Stage::ALL {
        if let Some(upstream) = stage.upstream() {
            let name = format!("{} to {}", upstream.name(), stage.name());
            write_latency(out, &name, &LatencySummary::of(measurements.transit(stage)))?;
        }
    }
    for stage in Stage::ALL {
        let name = format!("{} (work)", stage.name());
        write_latency(out, &name, &LatencySummary::of(measurements.work(stage)))?;
    }
    let whole = LatencySummary::of(&measurements.newest_sample_to_command);
    write_latency(out, "newest sample to command", &whole)
}

fn write_heading(out: &mut String, title: &str) -> Result {
    writeln!(out, "{title:<34}{:>9}{:>11}{:>11}{:>11}{:>11}", "messages", "p50", "p99", "p99.9", "max")
}

fn write_latency(out: &mut String, name: &str, latency: &LatencySummary) -> Result {
    let LatencySummary { count, p50_us, p99_us, p999_us, max_us } = latency;
    writeln!(out, "  {name:<32}{count:>9}{p50_us:>8.0} us{p99_us:>8.0} us{p999_us:>8.0} us{max_us:>8.0} us")
}

fn percent(part: u64, whole: u64) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}
