//! Which electrodes are off, said once of each.

use tendon_signal::Fault;

/// A channel that is at fault for so long is named, s: a cable that is touched is at fault for less.
const LASTS_S: f64 = 1.0;

/// What was seen of the electrodes so far.
#[derive(Debug)]
pub struct Electrodes {
    channels: Vec<Seen>,
    lasts_samples: u64,
}

/// What was seen of one channel.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// First sample of the first of the windows without a break in which the channel is at fault.
    since_sample: Option<u64>,
    was_named: bool,
}

impl Electrodes {
    /// Nothing was seen yet.
    pub fn new(channels: usize, sample_rate_hz: f64) -> Electrodes {
        Electrodes {
            channels: vec![Seen::default(); channels],
            lasts_samples: (LASTS_S * sample_rate_hz) as u64,
        }
    }

    /// Takes what is wrong with each channel in the window that begins with sample `first_sample`. Gives a warning once of
    /// every channel that stays at fault. Allocates only for that.
    pub fn look(&mut self, first_sample: u64, faults: &[Option<Fault>]) -> Option<String> {
        let mut named = Vec::new();
        for (channel, (seen, fault)) in self.channels.iter_mut().zip(faults).enumerate() {
            let Some(fault) = fault else {
                seen.since_sample = None;
                continue;
            };
            let since_sample = *seen.since_sample.get_or_insert(first_sample);
            if !seen.was_named && first_sample.saturating_sub(since_sample) >= self.lasts_samples {
                seen.was_named = true;
                named.push(format!("channel {channel} is {fault}"));
            }
        }
        (!named.is_empty()).then(|| {
            format!("{}: check the electrodes and cables; until then the arm stays at rest", named.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_that_stays_at_fault_is_named_once() {
        let mut electrodes = Electrodes::new(3, 1000.0);
        let mut warnings = Vec::new();
        for first_sample in (0..6000).step_by(100) {
            let fault = |begin, end, fault| (begin..end).contains(&first_sample).then_some(fault);
            let faults = [
                fault(1000, 2000, Fault::Noise),
                // A fault that ends in between is a new one.
                fault(2000, 6000, Fault::Flat).filter(|_| first_sample != 2500),
                fault(2600, 6000, Fault::Hum),
            ];
            warnings.extend(electrodes.look(first_sample, &faults).map(|warning| (first_sample, warning)));
        }
        let [(at, warning)] = &warnings[..] else { panic!("{warnings:?}") };
        assert_eq!(*at, 3600);
        assert!(warning.starts_with("channel 1 is flat, channel 2 is hum: check"), "{warning}");
    }
}
