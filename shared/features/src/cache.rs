//! The logarithms of the pieces of the latest windows of a stream, for windows that overlap.
//!
//! ```text
//! window at 0     [ piece 0   ][ piece 150 ]
//! window at 50        [ piece 50  ][ piece 200 ]
//! window at 100           [ piece 100 ][ piece 250 ]
//! window at 150               [ piece 150 ][ piece 300 ]      piece 150 is that of the first window
//! ```
//!
//! Every window begins one increment after the one before it, so pieces meet again where the increment divides their
//! length. A piece depends on its own samples only, so that its logarithm is the same to the bit in every window.

/// Holds as many pieces as lie at the increments between a window's first and last piece: one place each.
#[derive(Clone, Debug, Default)]
pub(crate) struct PieceCache {
    /// Of the windows whose pieces are kept; 0 if none are, because they never meet again.
    window_samples: usize,
    increment_samples: u64,
    feature_count: usize,
    /// Where the next window begins if none is missing.
    next_first_sample: Option<u64>,
    /// First sample of the piece in each place.
    pieces: Vec<Option<u64>>,
    /// Places x features.
    logarithms: Vec<f64>,
}

impl PieceCache {
    /// A cache for windows of `window_samples`, divided into `pieces`.
    pub(crate) fn new(
        window_samples: usize,
        pieces: usize,
        increment_samples: usize,
        feature_count: usize,
    ) -> PieceCache {
        let piece_samples = window_samples / pieces.max(1);
        let meet = pieces > 1
            && increment_samples > 0
            && window_samples.is_multiple_of(pieces)
            && piece_samples.is_multiple_of(increment_samples);
        if !meet {
            return PieceCache::default();
        }
        let places = (window_samples - piece_samples) / increment_samples + 1;
        PieceCache {
            window_samples,
            increment_samples: increment_samples as u64,
            feature_count,
            next_first_sample: None,
            pieces: vec![None; places],
            logarithms: vec![0.0; places * feature_count],
        }
    }

    /// Forgets everything unless the window at `first_sample` follows the one before.
    pub(crate) fn follow(&mut self, first_sample: u64) {
        if self.next_first_sample != Some(first_sample) {
            self.pieces.fill(None);
        }
        self.next_first_sample = first_sample.checked_add(self.increment_samples);
    }

    /// The logarithm of the piece that begins at the sample `piece` of the stream.
    pub(crate) fn get(&self, piece: u64, window_samples: usize) -> Option<&[f64]> {
        let place = self.place(piece, window_samples)?;
        let is_there = self.pieces[place] == Some(piece);
        is_there.then(|| &self.logarithms[place * self.feature_count..][..self.feature_count])
    }

    /// Keeps a logarithm, in the place of one that no later window needs.
    pub(crate) fn put(&mut self, piece: u64, window_samples: usize, logarithm: &[f64]) {
        if let Some(place) = self.place(piece, window_samples) {
            self.pieces[place] = Some(piece);
            self.logarithms[place * self.feature_count..][..self.feature_count].copy_from_slice(logarithm);
        }
    }

    fn place(&self, piece: u64, window_samples: usize) -> Option<usize> {
        let is_kept = self.window_samples > 0 && window_samples == self.window_samples;
        is_kept.then(|| (piece / self.increment_samples) as usize % self.pieces.len())
    }
}
