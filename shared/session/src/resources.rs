//! Processor time and memory of processes, from /proc (see proc(5)).

use std::fs;

/// Processor time of all threads of a process so far, in s; `None` when it is gone.
///
/// From `schedstat`, in ns: the ticks of `stat` miss work that is shorter than they are.
pub fn cpu_s(process_id: u32) -> Option<f64> {
    let mut total_ns = 0;
    for task in fs::read_dir(format!("/proc/{process_id}/task")).ok()?.flatten() {
        // A thread may end meanwhile.
        let Ok(text) = fs::read_to_string(task.path().join("schedstat")) else { continue };
        total_ns += text.split_whitespace().next()?.parse::<u64>().ok()?;
    }
    Some(total_ns as f64 / 1e9)
}

/// Proportional resident memory of a process in MB: pages that several processes share are divided among
/// them. `None` when the process is gone.
pub fn memory_mb(process_id: u32) -> Option<f64> {
    let text = fs::read_to_string(format!("/proc/{process_id}/smaps_rollup")).ok()?;
    let line = text.lines().find(|line| line.starts_with("Pss:"))?;
    let kilobytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024.0 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_uses_time_and_memory() {
        let before = cpu_s(std::process::id()).unwrap();
        let mut sum = 0.0_f64;
        while cpu_s(std::process::id()).unwrap() < before + 0.01 {
            sum += (0..10_000).map(f64::from).map(f64::sqrt).sum::<f64>();
        }
        assert!(sum > 0.0);
        assert!(memory_mb(std::process::id()).unwrap() > 0.1);
        assert_eq!(memory_mb(u32::MAX), None);
    }
}
