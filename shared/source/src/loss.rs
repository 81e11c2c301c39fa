//! Lost samples of a device that does not count its samples.
//!
//! ```text
//! lateness of a sample ─┐        ┌─────────── it never catches up: samples were lost
//!              _________│________│
//!                       ▲ some are lost      a delay of the network ends, and lateness falls again
//! ```

/// Lateness must have been there so long, ns.
const WATCHED_NS: u64 = 1_000_000_000;

/// Watches how late samples come.
#[derive(Clone, Debug)]
pub struct LossByTime {
    /// A smaller lateness is no loss, ns.
    allowed_ns: u64,
    began_ns: u64,
    least_ns: u64,
}

impl LossByTime {
    /// Lateness that stays is a loss if it is greater than this, ns.
    pub fn new(allowed_ns: u64) -> LossByTime {
        LossByTime { allowed_ns, began_ns: 0, least_ns: u64::MAX }
    }

    /// Takes how late the newest sample is, and gives the time in which samples were lost, ns; 0 if none were.
    pub fn observe(&mut self, now_ns: u64, lateness_ns: u64) -> u64 {
        if self.least_ns == u64::MAX {
            self.began_ns = now_ns;
        }
        self.least_ns = self.least_ns.min(lateness_ns);
        if now_ns.saturating_sub(self.began_ns) < WATCHED_NS {
            return 0;
        }
        let least_ns = std::mem::replace(&mut self.least_ns, u64::MAX);
        if least_ns > self.allowed_ns { least_ns } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Time lost in all, when every 10 ms a sample is this late.
    fn lost_ns(lateness_ms: impl Fn(u64) -> u64) -> u64 {
        let mut loss = LossByTime::new(20 * MS);
        (0..500).map(|step| loss.observe(step * 10 * MS, lateness_ms(step) * MS)).sum()
    }

    #[test]
    fn lateness_that_stays_is_a_loss_and_lateness_that_passes_is_none() {
        assert_eq!(lost_ns(|step| if (100..150).contains(&step) { 80 } else { step % 15 }), 0);
        let mut loss = LossByTime::new(20 * MS);
        let found: Vec<u64> = (0..300)
            .map(|step| loss.observe(step * 10 * MS, if step > 50 { 60 * MS } else { 0 }))
            .filter(|lost| *lost > 0)
            .collect();
        assert_eq!(found, [60 * MS]);
    }
}
