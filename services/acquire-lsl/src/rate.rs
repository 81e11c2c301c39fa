//! Whether a stream's samples arrive as fast as the stream says. Time stamps cannot tell: many programs count them out of the
//! stated rate.

/// Time over which arrivals are counted, s. A chunk may come a tenth of a second late.
const PERIOD_S: f64 = 20.0;
/// Largest difference from the stated rate, as a share.
const TOLERANCE: f64 = 0.01;
/// After so long without samples counting begins anew, s.
const SILENCE_S: f64 = 1.0;

/// Counts the samples that arrive.
#[derive(Debug)]
pub struct ArrivalRate {
    stated_hz: f64,
    /// Samples since the first chunk, without it, and when that and the newest came, ns.
    counted: Option<(u64, u64, u64)>,
}

impl ArrivalRate {
    /// Of a stream that states this rate.
    pub fn new(stated_hz: f64) -> ArrivalRate {
        ArrivalRate { stated_hz, counted: None }
    }

    /// A chunk of `samples` has come at `received_ns`, on the same connection as the one before or on a new one. Returns the rate
    /// of the last 20 s, Hz, if it is another than the stated one.
    pub fn take(&mut self, samples: usize, received_ns: u64, is_new_connection: bool) -> Option<f64> {
        let seconds = |from_ns: u64| received_ns.saturating_sub(from_ns) as f64 * 1e-9;
        let (count, begun_ns) = match self.counted {
            Some((count, begun_ns, newest_ns)) if !is_new_connection && seconds(newest_ns) < SILENCE_S => {
                (count + samples as u64, begun_ns)
            }
            _ => (0, received_ns),
        };
        self.counted = Some((count, begun_ns, received_ns));
        if seconds(begun_ns) < PERIOD_S {
            return None;
        }
        self.counted = None;
        let measured_hz = count as f64 / seconds(begun_ns);
        ((measured_hz / self.stated_hz - 1.0).abs() > TOLERANCE).then_some(measured_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said of a minute of chunks of 20 samples at `real_hz`, each up to 50 ms late.
    fn said(real_hz: f64) -> Vec<f64> {
        let mut rate = ArrivalRate::new(2000.0);
        let chunks = (60.0 * real_hz / 20.0) as u64;
        let arrival_ns = |chunk: u64| {
            let late_s = 0.05 * ((chunk * 7919) % 100) as f64 / 100.0;
            ((chunk as f64 * 20.0 / real_hz + late_s) * 1e9) as u64
        };
        (0..chunks).filter_map(|chunk| rate.take(20, arrival_ns(chunk), chunk == 0)).collect()
    }

    #[test]
    fn another_rate_than_the_stated_one_is_measured() {
        for real_hz in [1000.0, 1960.0, 2040.0] {
            let said = said(real_hz);
            assert!(said.len() >= 2, "{real_hz} Hz: {said:?}");
            assert!(said.iter().all(|hz| (hz / real_hz - 1.0).abs() < 0.005), "{real_hz} Hz: {said:?}");
        }
        // Clocks differ a little.
        assert!(said(2000.0).is_empty() && said(2005.0).is_empty());
    }

    #[test]
    fn a_pause_or_a_new_connection_is_none_of_the_rate() {
        let mut rate = ArrivalRate::new(2000.0);
        // 2 s silent in every 5 s, and a new connection after every 15 s.
        for chunk in 0..6000_u64 {
            let time_s = chunk as f64 * 0.01;
            if time_s % 5.0 < 3.0 {
                assert_eq!(rate.take(20, (time_s * 1e9) as u64, chunk % 1500 == 0), None);
            }
        }
    }
}
