//! Windows for models that classify several in a row.

/// Where a window comes from: its recording, and its trial in it. A sequence has windows of one trial only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TrialId {
    pub(crate) recording: usize,
    pub(crate) trial: usize,
}

/// The newest windows of a trial, as a model of sequences wants them.
pub(crate) struct Sequence {
    windows: usize,
    /// One after the other `[windows × channels × samples]`; not used by a model of single windows.
    samples: Vec<f32>,
    trial: Option<TrialId>,
    /// How many windows of the trial have come.
    windows_of_trial: usize,
}

impl Sequence {
    pub(crate) fn new(windows: usize, window_length: usize) -> Sequence {
        let length = if windows > 1 { windows * window_length } else { 0 };
        Sequence { windows, samples: vec![0.0; length], trial: None, windows_of_trial: 0 }
    }

    /// The sequence that ends with `window`; `None` while its trial has not had enough.
    pub(crate) fn push<'a>(&'a mut self, trial: TrialId, window: &'a [f32]) -> Option<&'a [f32]> {
        if self.windows == 1 {
            return Some(window);
        }
        if self.trial.replace(trial) != Some(trial) {
            self.windows_of_trial = 0;
        }
        self.windows_of_trial += 1;
        self.samples.copy_within(window.len().., 0);
        let newest = self.samples.len() - window.len();
        self.samples[newest..].copy_from_slice(window);
        (self.windows_of_trial >= self.windows).then_some(&self.samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sequence_is_what_came_before_in_the_same_trial() {
        let mut sequence = Sequence::new(3, 2);
        let windows: Vec<[f32; 2]> = (0..6).map(|index| [index as f32, 0.5]).collect();
        let mut ended = Vec::new();
        for (index, window) in windows.iter().enumerate() {
            // Four windows of one trial, two of the next.
            let trial = TrialId { recording: 0, trial: usize::from(index >= 4) };
            ended.push(sequence.push(trial, window).map(<[f32]>::to_vec));
        }
        assert_eq!(ended[..2], [None, None]);
        assert_eq!(ended[2], Some(vec![0.0, 0.5, 1.0, 0.5, 2.0, 0.5]));
        assert_eq!(ended[3], Some(vec![1.0, 0.5, 2.0, 0.5, 3.0, 0.5]));
        assert_eq!(ended[4..], [None, None]);

        let mut single = Sequence::new(1, 2);
        assert_eq!(single.push(TrialId { recording: 0, trial: 0 }, &windows[3]), Some(&windows[3][..]));
    }

    #[test]
    fn a_sequence_never_mixes_two_recordings() {
        // The first recording breaks off in its first trial; the next one counts its trials from 0 again.
        let mut sequence = Sequence::new(2, 1);
        let of = |recording| TrialId { recording, trial: 0 };
        assert_eq!(sequence.push(of(0), &[1.0]), None);
        assert_eq!(sequence.push(of(1), &[2.0]), None);
        assert_eq!(sequence.push(of(1), &[3.0]), Some(&[2.0, 3.0][..]));
    }
}
