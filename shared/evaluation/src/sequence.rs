//! Windows for models that classify several in a row.

/// The newest windows of a trial, as a model of sequences wants them.
pub(crate) struct Sequence {
    windows: usize,
    /// One after the other `[windows × channels × samples]`; not used by a model of single windows.
    samples: Vec<f32>,
    trial: Option<u64>,
    /// How many windows of the trial have come.
    windows_of_trial: usize,
}

impl Sequence {
    pub(crate) fn new(windows: usize, window_length: usize) -> Sequence {
        let length = if windows > 1 { windows * window_length } else { 0 };
        Sequence { windows, samples: vec![0.0; length], trial: None, windows_of_trial: 0 }
    }

    /// The sequence that ends with `window`; `None` while its trial has not had enough.
    pub(crate) fn push<'a>(&'a mut self, trial: u64, window: &'a [f32]) -> Option<&'a [f32]> {
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
            let trial = u64::from(index >= 4);
            ended.push(sequence.push(trial, window).map(<[f32]>::to_vec));
        }
        assert_eq!(ended[..2], [None, None]);
        assert_eq!(ended[2], Some(vec![0.0, 0.5, 1.0, 0.5, 2.0, 0.5]));
        assert_eq!(ended[3], Some(vec![1.0, 0.5, 2.0, 0.5, 3.0, 0.5]));
        assert_eq!(ended[4..], [None, None]);

        let mut single = Sequence::new(1, 2);
        assert_eq!(single.push(0, &windows[3]), Some(&windows[3][..]));
    }
}
