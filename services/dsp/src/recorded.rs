//! In the replay of a recorded session, the windows that were recorded.
//!
//! ```text
//! session   blocks ─────────────────────────▶
//!           windows [──────][──────][──────][──────]
//! recording blocks       ╴begun by key────▶        ╴missing╶ ──────▶
//! replay    windows         [──────][──────]                  [──────]     where the recording has them, not from its first block
//! ```

use std::path::Path;

use tendon_config::{Config, Source};
use tendon_session_file::{Head, ReplayMarks, is_session_file};
use tendon_signal::SignalChain;

/// The windows of the recorded session, and where dsp began anew in it.
#[derive(Debug)]
pub struct RecordedWindows {
    marks: ReplayMarks,
    window_samples: u64,
    /// First sample since which none is missing.
    stretch_start: u64,
}

impl RecordedWindows {
    /// `None` for any other source, and where the windows are not those of the recording.
    pub fn of(config: &Config) -> anyhow::Result<Option<RecordedWindows>> {
        let replay = &config.acquisition.replay;
        let is_replay = config.acquisition.source == Source::Replay;
        match replay.path.as_deref().filter(|path| is_replay && is_session_file(path)) {
            Some(path) => RecordedWindows::read(path, config),
            None => Ok(None),
        }
    }

    fn read(path: &Path, config: &Config) -> anyhow::Result<Option<RecordedWindows>> {
        let recorded = Config::parse(&Head::read(path)?.configuration, path)?;
        if recorded.dsp.windows != config.dsp.windows {
            tracing::warn!(
                "{}: recorded with other windows (dsp.windows), so what stages left out then, and where they began anew, is not \
                 repeated",
                path.display()
            );
            return Ok(None);
        }
        let marks = ReplayMarks::read(path)?;
        if marks.is_empty() {
            tracing::warn!(
                "{}: no window is in the recording, so what stages left out then, and where they began anew, is not repeated",
                path.display()
            );
            return Ok(None);
        }
        let window_samples = config.dsp.windows.window_samples as u64;
        Ok(Some(RecordedWindows { marks, window_samples, stretch_start: 0 }))
    }

    /// Takes the next block of the replay; whether dsp began anew with it.
    pub fn begins_anew(&mut self, first_sample: u64) -> bool {
        self.marks.begins_anew(first_sample)
    }

    /// Lets a window end in the block that comes next where one of the recording did. `follows`: it continues the one before.
    pub fn align(&mut self, chain: &mut SignalChain, first_sample: u64, samples: usize, follows: bool) {
        if !follows {
            self.stretch_start = first_sample;
        }
        // The first samples of windows whose last one is in the block.
        let end = first_sample + samples as u64 + 1;
        let from = (first_sample + 1).saturating_sub(self.window_samples).max(self.stretch_start);
        if let Some(window) = self.marks.window_from(from..end.saturating_sub(self.window_samples)) {
            chain.align_windows((window + self.window_samples - first_sample) as usize);
        }
    }

    /// The marks of a window of the newest block, for its context; `None` if dsp left it out.
    pub fn marks(&self, first_sample: u64) -> Option<u8> {
        self.marks.window(first_sample)
    }

    /// The mode that decision was ordered to take with a window of the newest block, for its context; 0 if none was.
    pub fn ordered_mode(&self, first_sample: u64) -> u8 {
        self.marks.ordered_mode(first_sample)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::convert::Infallible;
    use std::ops::Range;

    use tendon_messages::{Stage, Truth};
    use tendon_session_file::{
        Block, CONFIGURATION, CommandRecord, ContextRecord, Message, Number, TraceRecord, Writer,
    };

    use super::*;

    const BLOCK: u64 = 10;
    const WINDOW: u64 = 600;
    const INCREMENT: u64 = 150;
    const SESSION: Range<u64> = 0..1000;
    const BY_KEY: Range<u64> = 203..1000;

    fn when(block: u64) -> u64 {
        1_000_000_000 + block * 5_000_000
    }

    /// The recording of a session of these blocks in which dsp began to cut windows at these samples.
    fn recording(path: &Path, blocks: &[Range<u64>], grid_starts: &[u64]) -> BTreeSet<u64> {
        let mut writer = Writer::begin(std::fs::File::create(path).unwrap(), "test", 0).unwrap();
        writer.attach(CONFIGURATION, "application/toml", Config::default().to_toml().as_bytes()).unwrap();
        let mut windows = BTreeSet::new();
        for number in blocks.iter().cloned().flatten() {
            let block = Block {
                sequence: number,
                captured_ns: when(number) - 1000,
                published_ns: when(number),
                first_sample: number * BLOCK,
                sample_rate_hz: 2000.0,
                truth: Truth::default(),
                channels: 1,
                samples: BLOCK as u32,
                non_finite_samples: 0,
                values: vec![0.0; BLOCK as usize],
            };
            writer.write(&Message::Block(block), when(number)).unwrap();
            let end = (number + 1) * BLOCK;
            let Some(begun) = grid_starts.iter().rev().find(|start| **start + WINDOW <= end) else {
                continue;
            };
            if (end - begun - WINDOW).is_multiple_of(INCREMENT) {
                let mut trace = TraceRecord { sequence: number, ..TraceRecord::default() };
                trace.published_ns[0] = when(number);
                trace.published_ns[Stage::Decision.index()] = when(number) + 1;
                let command = CommandRecord {
                    trace,
                    context: ContextRecord { first_sample: end - WINDOW, ..ContextRecord::default() },
                    gesture: 0,
                    voted: 0,
                    confidence: Number(0.0),
                    mode: 0,
                    ordered_mode: 0,
                    frame: 0,
                    is_unsure: 0,
                    gripper_toggles: 0,
                    twist: vec![Number(0.0); 6],
                };
                writer.write(&Message::Command(command), when(number) + 2).unwrap();
                windows.insert(end - WINDOW);
            }
        }
        writer.finish().unwrap();
        windows
    }

    /// The windows that the replay of these blocks publishes.
    fn replayed(path: &Path, blocks: &[Range<u64>]) -> BTreeSet<u64> {
        let config = Config::default();
        let mut recorded = RecordedWindows::read(path, &config).unwrap().unwrap();
        let mut chain = SignalChain::new(&config.dsp, 1, 2000.0).unwrap();
        let mut windows = BTreeSet::new();
        let mut next = None;
        for first_sample in blocks.iter().cloned().flatten().map(|number| number * BLOCK) {
            assert!(!recorded.begins_anew(first_sample));
            if let Some(expected) = next.filter(|expected| *expected != first_sample) {
                chain.gap(first_sample - expected);
            }
            recorded.align(&mut chain, first_sample, BLOCK as usize, next == Some(first_sample));
            next = Some(first_sample + BLOCK);
            let block = [0.0; BLOCK as usize];
            let Ok(_) = chain.push_block(&block, |_, _, end| {
                let window = first_sample + end as u64 - WINDOW;
                windows.extend(recorded.marks(window).map(|_| window));
                Ok::<(), Infallible>(())
            });
        }
        windows
    }

    #[test]
    fn every_recorded_window_whose_samples_are_there_is_cut_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        let is_whole = |blocks: &[Range<u64>], window: u64| {
            blocks.iter().any(|range| range.start * BLOCK <= window && window + WINDOW <= range.end * BLOCK)
        };
        for (what, blocks, grid_starts) in [
            ("all of it", vec![SESSION], vec![0]),
            ("begun by key", vec![BY_KEY], vec![0]),
            ("begun by key, and a chunk is missing", vec![203..500, 537..1000], vec![0]),
            ("dsp lost blocks that were recorded", vec![SESSION], vec![0, 4010]),
            ("the source lost blocks", vec![0..300, 311..1000], vec![0, 3110]),
        ] {
            let mut expected = recording(&path, &blocks, &grid_starts);
            // Windows over a gap that only the recording has cannot be made again.
            expected.retain(|window| is_whole(&blocks, *window));
            assert!(expected.len() > 20, "{what}");
            assert_eq!(replayed(&path, &blocks), expected, "{what}");
        }
    }

    #[test]
    fn a_recording_without_any_window_leaves_none_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.mcap");
        recording(&path, &[SESSION], &[]);
        assert!(RecordedWindows::read(&path, &Config::default()).unwrap().is_none());
    }
}
