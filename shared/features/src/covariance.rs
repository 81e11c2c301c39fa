//! Lagged covariance of a window on the log scale.
//!
//! ```text
//! window, channels x samples        Z, rows = delays x channels             features
//! ch 0 ~~~~~~~~~~~~~~~~~~~~~        delay 0  ch 0 … ch 3                    upper triangle of log C,
//! ch 1 ~~~~~~~~~~~~~~~~~~~~~   ──▶  delay 2  ch 0 … ch 3   ──▶  C  ──▶      row by row, what is off the
//!  …                                   …                                    diagonal times √2
//! ```
//!
//! A window is divided into pieces of equal length, of about `piece_ms`. Its features are the mean of theirs. Windows of a
//! stream overlap, so most pieces have been computed for an earlier window (`cache.rs`).
//!
//! C = Z Zᵀ / samples + (ridge · mean diagonal + floor) · 1. Its elements are amplitudes, spectra and how the
//! channels go together. The logarithm makes them comparable across people and forces: the features are the
//! vector of the log-Euclidean metric (Arsigny et al. 2006), whose plain distance is the distance of two
//! covariances. Covariances of EMG: Gowda and Miller 2023, arXiv 2311.08548. The mean is not subtracted: the
//! filter of the dsp stage has removed it.

use crate::cache::PieceCache;
use crate::eigen::{SymmetricEigen, add_scaled};
use crate::error::FeatureError;
use crate::prior::FeatureLayout;
use crate::settings::MethodSettings;

/// Samples that are converted to `f64` and multiplied at a time: few enough to stay in the cache.
const CHUNK: usize = 256;
/// Channels that are multiplied with one channel at a time, so that this one is loaded once.
const TILE: usize = 4;
/// More channels than any amplifier for the forearm has.
const LARGEST_CHANNELS: usize = 256;
/// Smallest eigenvalue that is told from 0, as a share of the mean one: below it, `f64` has only rounding
/// errors.
const SMALLEST_EIGENVALUE: f64 = 1e-15;

/// Turns windows into features. Allocates in [`new`](Self::new) only.
#[derive(Clone, Debug)]
pub struct LaggedLogCovariance {
    channels: usize,
    rate_hz: f64,
    delays_ms: Vec<f64>,
    /// In samples, ascending from 0.
    delays: Vec<usize>,
    piece_ms: f64,
    ridge: f64,
    floor_variance: f64,
    lags: Vec<Lag>,
    /// A chunk of every channel, after as many samples of history as the longest delay has.
    chunk: Vec<f64>,
    covariance: Vec<f64>,
    eigen: SymmetricEigen,
    /// The logarithm of one piece, as in the features but for the factor of what is off the diagonal.
    logarithm: Vec<f64>,
    cache: PieceCache,
}

/// All pairs of delays that are this far apart share most of their products.
#[derive(Clone, Debug)]
struct Lag {
    samples: usize,
    /// Index of the shorter and the longer delay of each pair.
    delays: Vec<(usize, usize)>,
    /// The shortest and the longest of the shorter delays, in samples.
    shortest: usize,
    longest: usize,
    /// `[a][b]`: sum of channel a times channel b delayed by the lag, over the samples that all pairs share.
    products: Vec<f64>,
}

impl LaggedLogCovariance {
    /// Prepares for windows of `channels` at `rate_hz`. `floor_variance` is in the square of the samples'
    /// unit, from [`rest_floor`].
    ///
    /// Delays are rounded to samples, and those that fall on one sample count once. Channels x delays is at
    /// most `largest_rows`: with more channels the longest delays are left out (10 channels have three of the
    /// four default delays, 64 channels only delay 0).
    ///
    /// # Errors
    ///
    /// A constant, the number of channels, the rate or the floor is out of its range.
    pub fn new(
        settings: &MethodSettings,
        channels: usize,
        rate_hz: f64,
        floor_variance: f64,
    ) -> Result<LaggedLogCovariance, FeatureError> {
        settings.check()?;
        if !(1..=LARGEST_CHANNELS).contains(&channels) {
            return Err(FeatureError::Channels(channels));
        }
        // A delay of 1 s, the longest, is then at most a million samples.
        if !(rate_hz > 0.0 && rate_hz <= 1e6) {
            return Err(FeatureError::Rate(rate_hz));
        }
        if !(floor_variance.is_normal() && floor_variance > 0.0) {
            return Err(FeatureError::Floor(floor_variance));
        }
        let most_delays = (settings.largest_rows / channels).max(1);
        let (mut delays_ms, mut delays) = (Vec::new(), Vec::new());
        for &delay_ms in &settings.delays_ms {
            let samples = (delay_ms * rate_hz / 1000.0).round() as usize;
            if delays.last() != Some(&samples) && delays.len() < most_delays {
                delays.push(samples);
                delays_ms.push(delay_ms);
            }
        }
        let rows = channels * delays.len();
        let longest = delays.last().copied().unwrap_or(0);
        Ok(LaggedLogCovariance {
            channels,
            rate_hz,
            delays_ms,
            lags: lags(&delays, channels),
            delays,
            piece_ms: settings.piece_ms,
            ridge: settings.ridge,
            floor_variance,
            chunk: vec![0.0; channels * (longest + CHUNK)],
            covariance: vec![0.0; rows * rows],
            eigen: SymmetricEigen::new(rows),
            logarithm: vec![0.0; rows * (rows + 1) / 2],
            cache: PieceCache::default(),
        })
    }

    /// Prepares [`compute_next`](Self::compute_next) for windows of one length, of which one begins
    /// `increment_samples` after the other. Where a piece is as long as several increments, a window then costs a
    /// single logarithm: its other pieces are those of earlier windows.
    pub fn with_increment(mut self, window_samples: usize, increment_samples: usize) -> LaggedLogCovariance {
        let pieces = self.pieces(window_samples);
        self.cache = PieceCache::new(window_samples, pieces, increment_samples, self.feature_count());
        self
    }

    /// Number of features, d (d + 1) / 2 for d = channels x delays.
    pub fn feature_count(&self) -> usize {
        let rows = self.rows();
        rows * (rows + 1) / 2
    }

    /// Channels x delays.
    pub fn rows(&self) -> usize {
        self.channels * self.delays.len()
    }

    /// Mean over channels and delays of the logarithm of the variance, more exactly of the diagonal of the logarithm of
    /// the covariance, from a window's features: how strong the signal is.
    pub fn mean_log_variance(&self, features: &[f64]) -> f64 {
        let rows = self.rows();
        let mut at = 0;
        let mut sum = 0.0;
        for row in 0..rows {
            sum += features.get(at).copied().unwrap_or(f64::NAN);
            at += rows - row;
        }
        sum / rows as f64
    }

    /// The delays that are used, in ms as set.
    pub fn delays_ms(&self) -> &[f64] {
        &self.delays_ms
    }

    /// The sampling rate for which the delays were rounded.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// What the features' order depends on; a [`Prior`](crate::Prior) must fit it. The rates are this one
    /// only.
    pub fn layout(&self) -> FeatureLayout {
        FeatureLayout {
            channels: self.channels,
            delays_ms: self.delays_ms.clone(),
            lowest_rate_hz: self.rate_hz,
            highest_rate_hz: self.rate_hz,
            piece_ms: self.piece_ms,
        }
    }

    /// Samples per channel that a window needs: twice the longest delay and one more.
    pub fn shortest_window(&self) -> usize {
        2 * self.longest_delay() + 1
    }

    /// Computes the features of one window, channel-major, of any length from
    /// [`shortest_window`](Self::shortest_window).
    ///
    /// # Errors
    ///
    /// Window or `features` have the wrong length, or a sample is not finite. `features` is then left as it
    /// was or holds nothing of use.
    pub fn compute(&mut self, window: &[f32], features: &mut [f64]) -> Result<(), FeatureError> {
        self.compute_pieces(window, None, features)
    }

    /// As [`compute`](Self::compute), to the bit, for windows in the order of a stream, with what
    /// [`with_increment`](Self::with_increment) has prepared. `first_sample` is the window's place in the stream. Pieces
    /// of earlier windows are used again only if these followed one another by the increment up to this window: where
    /// there is a gap, everything is computed anew.
    ///
    /// # Errors
    ///
    /// As [`compute`](Self::compute).
    pub fn compute_next(
        &mut self,
        window: &[f32],
        first_sample: u64,
        features: &mut [f64],
    ) -> Result<(), FeatureError> {
        self.cache.follow(first_sample);
        self.compute_pieces(window, Some(first_sample), features)
    }

    /// `first_sample` is `None` for a window that is not part of the stream.
    fn compute_pieces(
        &mut self,
        window: &[f32],
        first_sample: Option<u64>,
        features: &mut [f64],
    ) -> Result<(), FeatureError> {
        if !window.len().is_multiple_of(self.channels) {
            return Err(FeatureError::Window { values: window.len(), channels: self.channels });
        }
        let samples = window.len() / self.channels;
        if samples < self.shortest_window() {
            return Err(FeatureError::TooShort { samples, needed: self.shortest_window() });
        }
        if features.len() != self.feature_count() {
            return Err(FeatureError::Length { given: features.len(), needed: self.feature_count() });
        }
        features.fill(0.0);
        let pieces = self.pieces(samples);
        let share = 1.0 / pieces as f64;
        for piece in 0..pieces {
            let piece = Piece {
                window,
                window_samples: samples,
                start: piece * samples / pieces,
                end: (piece + 1) * samples / pieces,
            };
            let place = first_sample.and_then(|first_sample| first_sample.checked_add(piece.start as u64));
            if let Some(logarithm) = place.and_then(|place| self.cache.get(place, samples)) {
                add_scaled(features, share, logarithm);
                continue;
            }
            self.take_logarithm(&piece)?;
            add_scaled(features, share, &self.logarithm);
            if let Some(place) = place {
                self.cache.put(place, samples, &self.logarithm);
            }
        }
        let (rows, mut at) = (self.rows(), 0);
        for row in 0..rows {
            features[at + 1..at + rows - row].iter_mut().for_each(|value| *value *= std::f64::consts::SQRT_2);
            at += rows - row;
        }
        Ok(())
    }

    /// Into how many pieces a window is divided; each is as long as the delays need.
    fn pieces(&self, samples: usize) -> usize {
        let wanted = (samples as f64 / (self.piece_ms * self.rate_hz / 1000.0)).round() as usize;
        wanted.min(samples / self.shortest_window()).max(1)
    }

    /// Computes the logarithm of a piece's covariance.
    fn take_logarithm(&mut self, piece: &Piece) -> Result<(), FeatureError> {
        self.multiply(piece);
        self.assemble(piece);
        let scale = self.regularise(piece.samples() - self.longest_delay())?;
        if !self.eigen.decompose(&mut self.covariance) {
            return Err(FeatureError::NoConvergence);
        }
        self.assemble_logarithm(scale.ln());
        Ok(())
    }

    fn longest_delay(&self) -> usize {
        self.delays.last().copied().unwrap_or(0)
    }

    /// Sums the products that the pairs of delays of each lag share.
    fn multiply(&mut self, piece: &Piece) {
        let samples = piece.samples();
        let longest_delay = self.longest_delay();
        let stride = longest_delay + CHUNK;
        self.lags.iter_mut().for_each(|lag| lag.products.fill(0.0));
        for start in (0..samples).step_by(CHUNK) {
            let end = (start + CHUNK).min(samples);
            let history = longest_delay.min(start);
            for (channel, chunk) in self.chunk.chunks_exact_mut(stride).enumerate() {
                let channel = piece.channel(channel);
                for (value, &sample) in
                    chunk[longest_delay - history..].iter_mut().zip(&channel[start - history..end])
                {
                    *value = f64::from(sample);
                }
            }
            for lag in &mut self.lags {
                let (from, to) = lag.shared(longest_delay, samples);
                let (from, to) = (from.max(start), to.min(end));
                if from < to {
                    let at = longest_delay + from - start;
                    lag.add_products(&self.chunk, stride, at, to - from);
                }
            }
        }
    }

    /// Lower triangle of Z Zᵀ: what the pairs share, and the few samples at either end that only some of them
    /// have.
    fn assemble(&mut self, piece: &Piece) {
        let samples = piece.samples();
        let LaggedLogCovariance { channels, ref delays, ref lags, ref mut covariance, .. } = *self;
        let (rows, longest_delay) = (channels * delays.len(), self.delays.last().copied().unwrap_or(0));
        for lag in lags {
            let (from, to) = lag.shared(longest_delay, samples);
            for &(short, long) in &lag.delays {
                let delay = delays[short];
                for a in 0..channels {
                    let lowest = if lag.samples == 0 { a } else { 0 };
                    let ahead = piece.channel(a);
                    for b in lowest..channels {
                        let behind = piece.channel(b);
                        let sum = lag.products[a * channels + b]
                            + products(ahead, behind, lag.samples, longest_delay - delay, from)
                            + products(ahead, behind, lag.samples, to, samples - delay);
                        covariance[(long * channels + b) * rows + short * channels + a] = sum;
                    }
                }
            }
        }
    }

    /// Divides by the number of samples, adds ridge and floor, and scales the mean of the diagonal to 1.
    /// Returns this mean.
    fn regularise(&mut self, samples: usize) -> Result<f64, FeatureError> {
        let rows = self.rows();
        let trace: f64 = self.covariance.iter().step_by(rows + 1).sum();
        let mean = trace / (rows * samples) as f64;
        let added = self.ridge * mean + self.floor_variance;
        let scale = mean + added;
        // A sample that is not finite is in the diagonal, squared.
        if !scale.is_finite() {
            return Err(FeatureError::NotFinite);
        }
        let divisor = samples as f64 * scale;
        self.covariance.iter_mut().for_each(|value| *value /= divisor);
        self.covariance.iter_mut().step_by(rows + 1).for_each(|value| *value += added / scale);
        Ok(scale)
    }

    /// log C = V (log Λ) Vᵀ + log(scale) · 1, of which the rows of the upper triangle are kept.
    fn assemble_logarithm(&mut self, log_scale: f64) {
        let rows = self.rows();
        let LaggedLogCovariance { eigen, logarithm, .. } = self;
        logarithm.fill(0.0);
        for (value, vector) in eigen.values().iter().zip(eigen.vectors()) {
            let log = value.max(SMALLEST_EIGENVALUE).ln();
            let mut at = 0;
            for row in 0..rows {
                let length = rows - row;
                add_scaled(&mut logarithm[at..at + length], log * vector[row], &vector[row..]);
                at += length;
            }
        }
        let mut at = 0;
        for row in 0..rows {
            logarithm[at] += log_scale;
            at += rows - row;
        }
    }
}

/// A part of a window in time, of all channels.
struct Piece<'a> {
    window: &'a [f32],
    window_samples: usize,
    /// Of each channel.
    start: usize,
    end: usize,
}

impl Piece<'_> {
    fn samples(&self) -> usize {
        self.end - self.start
    }

    fn channel(&self, channel: usize) -> &[f32] {
        let first = channel * self.window_samples;
        &self.window[first + self.start..first + self.end]
    }
}

impl Lag {
    /// The samples of the shorter delay's channel that all pairs of delays of this lag have.
    fn shared(&self, longest_delay: usize, samples: usize) -> (usize, usize) {
        (longest_delay - self.shortest, samples - self.longest)
    }

    /// Adds the products of `count` samples from `at`, for every pair of channels (once where the lag is 0).
    fn add_products(&mut self, chunk: &[f64], stride: usize, at: usize, count: usize) {
        let channels = chunk.len() / stride;
        let behind = |b: usize| &chunk[b * stride + at - self.samples..][..count];
        for a in 0..channels {
            let ahead = &chunk[a * stride + at..][..count];
            let mut b = if self.samples == 0 { a } else { 0 };
            while b + TILE <= channels {
                let sums = dots(ahead, std::array::from_fn(|i| behind(b + i)));
                for (product, sum) in self.products[a * channels + b..].iter_mut().zip::<[f64; TILE]>(sums) {
                    *product += sum;
                }
                b += TILE;
            }
            while b < channels {
                let [sum] = dots(ahead, [behind(b)]);
                self.products[a * channels + b] += sum;
                b += 1;
            }
        }
    }
}

/// Groups the pairs of delays by their distance.
fn lags(delays: &[usize], channels: usize) -> Vec<Lag> {
    let mut lags: Vec<Lag> = Vec::new();
    for (short, &delay) in delays.iter().enumerate() {
        for (long, &longer) in delays.iter().enumerate().skip(short) {
            let samples = longer - delay;
            match lags.iter_mut().find(|lag| lag.samples == samples) {
                Some(lag) => {
                    lag.delays.push((short, long));
                    lag.longest = delay;
                }
                None => lags.push(Lag {
                    samples,
                    delays: vec![(short, long)],
                    shortest: delay,
                    longest: delay,
                    products: vec![0.0; channels * channels],
                }),
            }
        }
    }
    lags
}

/// Sum of `ahead[i] · behind[i - lag]` over `from..to`.
fn products(ahead: &[f32], behind: &[f32], lag: usize, from: usize, to: usize) -> f64 {
    let pairs = ahead[from..to].iter().zip(&behind[from - lag..to - lag]);
    pairs.map(|(&ahead, &behind)| f64::from(ahead) * f64::from(behind)).sum()
}

/// Sums of the products of one channel with several. Four sums each in turns, so that the compiler may use
/// vector instructions.
fn dots<const COUNT: usize>(ahead: &[f64], behind: [&[f64]; COUNT]) -> [f64; COUNT] {
    const LANES: usize = 4;
    let length = ahead.len();
    let whole = length - length % LANES;
    let behind = behind.map(|channel| &channel[..length]);
    let mut sums = [[0.0; LANES]; COUNT];
    for at in (0..whole).step_by(LANES) {
        for (sums, behind) in sums.iter_mut().zip(behind) {
            for lane in 0..LANES {
                sums[lane] += ahead[at + lane] * behind[at + lane];
            }
        }
    }
    for at in whole..length {
        for (sums, behind) in sums.iter_mut().zip(behind) {
            sums[0] += ahead[at] * behind[at];
        }
    }
    sums.map(|lanes| (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]))
}

/// The floor of the covariance for one person: `rest_floor_share` of the median variance of channels in
/// windows of rest. The median does not mind a twitch or a single loose electrode. `windows` are
/// channel-major, in any unit; the floor is in its square.
///
/// # Errors
///
/// The windows do not fit the channels, or most of them are flat, not finite or missing.
pub fn rest_floor<'a>(
    settings: &MethodSettings,
    channels: usize,
    windows: impl IntoIterator<Item = &'a [f32]>,
) -> Result<f64, FeatureError> {
    settings.check()?;
    let mut variances = Vec::new();
    for window in windows {
        if channels == 0 || window.is_empty() || !window.len().is_multiple_of(channels) {
            return Err(FeatureError::Window { values: window.len(), channels });
        }
        for channel in window.chunks_exact(window.len() / channels) {
            let sum: f64 = channel.iter().map(|&sample| f64::from(sample) * f64::from(sample)).sum();
            variances.push(sum / channel.len() as f64);
        }
    }
    variances.sort_by(f64::total_cmp);
    let median = variances.get(variances.len() / 2).copied().unwrap_or(0.0);
    let floor = settings.rest_floor_share * median;
    if floor.is_normal() { Ok(floor) } else { Err(FeatureError::FlatRest) }
}
