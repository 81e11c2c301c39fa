//! XDF, as LabRecorder writes streams of the Lab Streaming Layer; compressed by gzip it is called `.xdfz`.
//!
//! ```text
//! XDF:  then chunks: length, tag, content
//!   1 head of the file       2 head of a stream: XML with name, type, rate, channels
//!   3 samples of a stream, some with a time stamp        4 offset of the stream's clock from the recorder's
//!   5 boundary: 16 known bytes from which a damaged file is read on          6 foot of a stream
//!
//! stamps     ·  ·· ·   ·  ·      jitter ─▶ a straight line a stretch; more than a second apart: a gap
//! + offsets  ────────────        of another clock, as a straight line that outliers do not bend
//! ```
//! One stream is read: that of the channel `STREAM: CHANNEL` chosen first, else the only one of type EMG, or the only one of EEG or
//! EXG, or the only one with a rate. Texts that name gestures, of streams of the type Markers, Events or Stimuli, are cues.
//! Layout: [the XDF specification](https://github.com/sccn/xdf/wiki/Specifications).

mod chunks;
mod clock;
mod stream;

use std::io::{ErrorKind, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use tendon_signal::unit_factor;

use crate::segment::Notice;
use crate::signals::{CUE_IS_OVER, Cue, Gap, Signals, SignalsError, choose, gesture_of};
use crate::table::Channel;

use chunks::Contents;
use clock::{Clock, Stretch, stretches};
use stream::{Samples, Stream};

/// The content of a file `.xdfz`, which is compressed by gzip; of one that was cut off what comes before.
///
/// # Errors
/// When it is no such file, is damaged, or holds more than 8 GiB.
pub fn unpacked(bytes: &[u8]) -> Result<Vec<u8>, SignalsError> {
    const LARGEST: u64 = 8 << 30;
    let mut content = Vec::new();
    let read = MultiGzDecoder::new(bytes).take(LARGEST + 1).read_to_end(&mut content);
    match read {
        Err(error) if error.kind() != ErrorKind::UnexpectedEof => Err(if content.is_empty() {
            SignalsError::OtherKind("XDF compressed by gzip")
        } else {
            SignalsError::Damaged(format!("it cannot be unpacked ({error})"))
        }),
        _ if content.len() as u64 > LARGEST => {
            Err(SignalsError::Damaged("unpacked, it would have more than 8 GiB".to_owned()))
        }
        _ => Ok(content),
    }
}

/// Reads the file `path` with the content `bytes`: these channels of one stream, by name or number.
///
/// # Errors
/// When it is no such file, is damaged from the start, has no stream to read or several to choose from, or lacks a channel. A file
/// that is cut off is read up to there.
pub fn read(path: &Path, bytes: &[u8], channels: &[Channel]) -> Result<Signals, SignalsError> {
    let contents = Contents::read(bytes)?;
    let stream = choose_stream(&contents.streams, channels)?;
    let names: Vec<String> = stream.channels.iter().map(|channel| channel.label.clone()).collect();
    let chosen = choose(&without_stream(stream, channels), &names)?;
    let unit = chosen.first().map_or_else(String::new, |first| stream.channels[*first].unit.clone());
    let factors: Vec<f64> = chosen
        .iter()
        .map(|number| unit_factor(&stream.channels[*number].unit, &unit).unwrap_or(1.0))
        .collect();

    let Samples { mut columns, stamps, is_damaged } = stream.samples(&contents, &chosen);
    let stamps_s = &stamps.times_s;
    if stamps_s.is_empty() {
        return Err(SignalsError::Empty("the stream was announced, but gave none"));
    }
    for (column, factor) in columns.iter_mut().zip(factors) {
        column.iter_mut().for_each(|value| *value = (f64::from(*value) * factor) as f32);
    }
    let clock = Clock::of(stream, &contents);
    let stretches = stretches(stamps_s, &stamps.own, stream.rate_hz, stream.can_drop_samples, &clock);
    let sample_rate_hz = true_rate(stream.rate_hz, &stretches, stamps_s, &clock);
    let gaps = gaps(&stretches, sample_rate_hz);
    let mut cues: Vec<Cue> = contents
        .streams
        .iter()
        .filter(|stream| stream.is_of_markers())
        .flat_map(|markers| cues(markers, &contents, &stretches, stamps_s.len() as u64))
        .collect();
    cues.sort_by_key(|cue| cue.start_sample);

    let mut notices = Vec::new();
    if contents.damaged_bytes > 0 || is_damaged {
        notices.push(Notice::PartsDamaged { file: path.to_owned() });
    }
    if !contents.has_foot(stream.id) {
        let read = format!("{:.1} s of {}", stamps_s.len() as f64 / sample_rate_hz, stream.name);
        notices.push(Notice::CutOff { file: path.to_owned(), read });
    }
    if sample_rate_hz != stream.rate_hz {
        let (stated_hz, found_hz) = (stream.rate_hz, sample_rate_hz);
        notices.push(Notice::OtherRateFound { file: path.to_owned(), stated_hz, found_hz });
    }
    let missing = Vec::new();
    Ok(Signals { names, chosen, columns, unit, sample_rate_hz, gaps, cues, missing, notices })
}

/// The stream that is read.
fn choose_stream<'a>(streams: &'a [Stream], channels: &[Channel]) -> Result<&'a Stream, SignalsError> {
    let readable = || streams.iter().filter(|stream| stream.is_readable());
    let named = channels.iter().find_map(|channel| match channel {
        Channel::Name(name) => readable().find(|stream| stream.own_channel(name).is_some()),
        Channel::Index(_) => None,
    });
    if let Some(stream) = named {
        return Ok(stream);
    }
    for kinds in [&["EMG"][..], &["EMG", "EEG", "EXG"], &[]] {
        let is_kind = |stream: &&Stream| {
            kinds.is_empty() || kinds.iter().any(|kind| stream.content_type.eq_ignore_ascii_case(kind))
        };
        let mut found = readable().filter(is_kind);
        match (found.next(), found.next()) {
            (None, _) => {}
            (Some(stream), None) => return Ok(stream),
            (Some(first), Some(_)) => {
                let streams = readable().filter(is_kind).map(|stream| stream.name.clone()).collect();
                let channel =
                    first.channels.first().map_or_else(String::new, |channel| channel.label.clone());
                let example = format!("{}: {channel}", first.name);
                return Err(SignalsError::SeveralStreams { streams, example });
            }
        }
    }
    Err(SignalsError::Empty("no stream in it has numbers at a rate"))
}

/// The channels without the name of the stream.
fn without_stream(stream: &Stream, channels: &[Channel]) -> Vec<Channel> {
    let without = |channel: &Channel| match channel {
        Channel::Name(name) => stream.own_channel(name).map_or_else(|| channel.clone(), Channel::from),
        Channel::Index(_) => channel.clone(),
    };
    channels.iter().map(without).collect()
}

/// The stated rate, unless the stamps say that it is another one.
fn true_rate(stated_hz: f64, stretches: &[Stretch], stamps_s: &[f64], clock: &Clock) -> f64 {
    /// So far a clock may be off.
    const TOLERANCE: f64 = 0.01;
    /// With fewer, stamps say nothing about it.
    const ENOUGH_SAMPLES: u64 = 1000;
    let is_other = |period_s: f64, rate_hz: f64| (period_s * rate_hz - 1.0).abs() > TOLERANCE;
    let longest = stretches.iter().filter(|stretch| stretch.samples >= ENOUGH_SAMPLES);
    let Some(longest) = longest.max_by_key(|stretch| stretch.samples) else { return stated_hz };
    // A jump that is too short to divide the samples bends the line, but not this.
    let usual_s = longest.usual_period_s(stamps_s, clock);
    match is_other(usual_s, stated_hz) {
        false => stated_hz,
        true if is_other(usual_s, 1.0 / longest.period_s) => 1.0 / usual_s,
        true => 1.0 / longest.period_s,
    }
}

fn gaps(stretches: &[Stretch], sample_rate_hz: f64) -> Vec<Gap> {
    let gap = |pair: &[Stretch]| {
        let missing_s = pair[1].start_s - pair[0].time_of(pair[0].samples);
        // Where time jumped back nobody knows how many, but no window may span that place.
        Gap::of(pair[1].first_sample, missing_s * sample_rate_hz)
    };
    stretches.windows(2).map(gap).collect()
}

/// What the markers of a stream ask for. Until when, only some of them say.
fn cues(markers: &Stream, contents: &Contents<'_>, stretches: &[Stretch], samples: u64) -> Vec<Cue> {
    let clock = Clock::of(markers, contents);
    let mut cues: Vec<Cue> = Vec::new();
    for (stamp_s, text) in markers.texts(contents) {
        let at_sample = || sample_at(stretches, clock.corrected(stamp_s));
        if text == CUE_IS_OVER {
            let open = cues.last_mut().filter(|cue| cue.end_sample.is_none());
            open.into_iter().for_each(|cue| cue.end_sample = Some(at_sample()));
        } else if let Some(gesture) = gesture_of(&text) {
            cues.push(Cue { gesture, start_sample: at_sample(), end_sample: None });
        }
    }
    cues.retain(|cue| {
        cue.start_sample < samples && cue.end_sample.is_none_or(|end_sample| end_sample > cue.start_sample)
    });
    cues
}

/// The sample at a time: what lies in a gap belongs to its end, what lies before all to the first.
fn sample_at(stretches: &[Stretch], time_s: f64) -> u64 {
    let begun = stretches.iter().rev().find(|stretch| stretch.start_s <= time_s + 0.5 * stretch.period_s);
    begun.map_or(0, |stretch| {
        let sample = ((time_s - stretch.start_s) / stretch.period_s).round().max(0.0) as u64;
        stretch.first_sample + sample.min(stretch.samples)
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;
    use tendon_gesture::Gesture;

    use super::*;

    /// Made by `tests/golden/make_xdf.py`, which says what it holds.
    const STREAMS: &[u8] = include_bytes!("../tests/golden/streams.xdf");

    fn open(bytes: &[u8], channels: &[Channel]) -> Result<Signals, SignalsError> {
        read(Path::new("a.xdf"), bytes, channels)
    }

    fn chunk(tag: u16, content: &[u8]) -> Vec<u8> {
        [&[4][..], &(content.len() as u32 + 2).to_le_bytes(), &tag.to_le_bytes(), content].concat()
    }

    fn of_stream(tag: u16, stream: u32, content: &[u8]) -> Vec<u8> {
        chunk(tag, &[&stream.to_le_bytes(), content].concat())
    }

    fn head(stream: u32, name: &str, kind: &str, rate_hz: f64, format: &str, more: &str) -> Vec<u8> {
        let xml = format!(
            "<info><name>{name}</name><type>{kind}</type><channel_count>1</channel_count>\
             <nominal_srate>{rate_hz}</nominal_srate><channel_format>{format}</channel_format><desc>{more}</desc></info>"
        );
        of_stream(2, stream, xml.as_bytes())
    }

    /// Samples of one channel, the first one with a stamp.
    fn samples(stream: u32, stamp_s: f64, values: &[f32]) -> Vec<u8> {
        let mut content = vec![4];
        content.extend((values.len() as u32).to_le_bytes());
        for (number, value) in values.iter().enumerate() {
            if number == 0 {
                content.push(8);
                content.extend(stamp_s.to_le_bytes());
            } else {
                content.push(0);
            }
            content.extend(value.to_le_bytes());
        }
        of_stream(3, stream, &content)
    }

    fn file(chunks: &[Vec<u8>]) -> Vec<u8> {
        [b"XDF:".to_vec(), chunks.concat()].concat()
    }

    #[test]
    fn a_file_that_pyxdf_reads_is_read_with_units_gaps_and_cues() {
        let signals = open(STREAMS, &["extensor".into(), "flexor".into()]).unwrap();
        assert_eq!(
            (signals.names.as_slice(), signals.unit.as_str()),
            (["flexor", "extensor"].map(str::to_owned).as_slice(), "mV")
        );
        assert_eq!(signals.sample_rate_hz, 200.0);
        for (column, (channel, factor)) in signals.columns.iter().zip([(1, 1.0), (0, 1e-3)]) {
            assert_eq!(column.len(), 600);
            for (sample, value) in column.iter().enumerate() {
                let scale = f64::from(channel + 1);
                let expected = 100.0 * scale * (TAU * scale * sample as f64 / 40.0).sin() * factor;
                assert!((f64::from(*value) - expected).abs() < 1e-4 * factor, "{channel}, {sample}");
            }
        }
        assert_eq!(signals.gaps, [Gap { before_sample: 400, lost_samples: 600 }]);
        let cue = |gesture, start_sample| Cue { gesture, start_sample, end_sample: None };
        let expected = [cue(Gesture::REST, 50), cue(Gesture::GRIP, 200), cue(Gesture::REST, 500)];
        assert_eq!(signals.cues, expected);
        assert_eq!(signals.notices, []);
        let segments = signals.segments(Path::new("a.xdf"));
        let ends: Vec<_> =
            segments.iter().map(|segment| (segment.end_sample, segment.samples_lost_before)).collect();
        assert_eq!(ends, [(Some(50), 0), (Some(200), 0), (Some(400), 0), (Some(500), 600), (None, 0)]);
        // Another stream, by its name.
        let motion = open(STREAMS, &["Motion: x".into()]).unwrap();
        assert_eq!(
            (motion.names, motion.unit, motion.columns[0].len()),
            (vec!["x".to_owned()], "g".to_owned(), 10)
        );
    }

    #[test]
    fn a_damaged_part_is_passed_over_and_a_cut_is_named() {
        let head = head(7, "A", "EMG", 100.0, "float32", "");
        let boundary = chunk(5, &super::chunks::BOUNDARY);
        let first = samples(7, 0.0, &[1.0; 100]);
        let mut broken = samples(7, 1.0, &[2.0; 100]);
        broken[0] = 3;
        let last = samples(7, 2.0, &[3.0; 100]);
        let foot = of_stream(6, 7, b"<info/>");
        let whole = file(&[head, first, broken, boundary, last, foot.clone()]);
        let signals = open(&whole, &[0.into()]).unwrap();
        assert_eq!(signals.columns[0], [vec![1.0; 100], vec![3.0; 100]].concat());
        assert_eq!(signals.gaps, []);
        assert_eq!(signals.notices, [Notice::PartsDamaged { file: "a.xdf".into() }]);
        let cut = open(&whole[..whole.len() - foot.len()], &[0.into()]).unwrap();
        let read = "2.0 s of A".to_owned();
        assert_eq!(cut.notices[1..], [Notice::CutOff { file: "a.xdf".into(), read }]);
    }

    #[test]
    fn a_compressed_file_holds_the_same_and_is_read_up_to_where_it_was_cut_off() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.xdfz");
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Signals::read(&path, &["flexor".into()]).map_err(|error| error.to_string())
        };
        let mut packed = Vec::new();
        let mut encoder = flate2::write::GzEncoder::new(&mut packed, flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, STREAMS).unwrap();
        encoder.finish().unwrap();
        let whole = open(STREAMS, &["flexor".into()]).unwrap();
        assert_eq!(read(&packed).unwrap(), whole);
        let cut = read(&packed[..packed.len() * 9 / 10]).unwrap();
        assert!(whole.columns[0].starts_with(&cut.columns[0]) && cut.columns[0].len() > 100);
        assert!(matches!(cut.notices[..], [Notice::CutOff { .. }]), "{:?}", cut.notices);
        assert!(
            read(STREAMS).unwrap_err().contains("of the kind that its name says (XDF compressed by gzip)")
        );
        packed[300..400].fill(0xFF);
        assert!(read(&packed).unwrap_err().contains("is damaged"));
    }

    #[test]
    fn a_jump_in_the_stamps_is_none_of_the_rate() {
        let head = head(7, "A", "EMG", 1000.0, "float32", "");
        // Every sample with a stamp; 0.3 s are lost in the middle.
        let stamp_s = |row: usize, period_s: f64| row as f64 * period_s + if row < 7000 { 0.0 } else { 0.3 };
        let rate_hz = |period_s: f64| {
            let chunks = (0..15_000).map(|row| samples(7, stamp_s(row, period_s), &[1.0]));
            let whole =
                file(&[vec![head.clone()], chunks.collect(), vec![of_stream(6, 7, b"<info/>")]].concat());
            open(&whole, &[0.into()]).unwrap().sample_rate_hz
        };
        assert_eq!(rate_hz(0.001), 1000.0);
        assert!((rate_hz(0.00125) / 800.0 - 1.0).abs() < 1e-3, "{}", rate_hz(0.00125));
    }

    #[test]
    fn which_stream_is_meant_must_be_clear() {
        let numbers = |stream: u32, name: &str, kind: &str| {
            [head(stream, name, kind, 100.0, "float32", ""), samples(stream, 0.0, &[stream as f32; 3])]
                .concat()
        };
        let value = |chunks: &[Vec<u8>], channel: Channel| {
            open(&file(chunks), &[channel])
                .map(|signals| signals.columns[0][0])
                .map_err(|error| error.to_string())
        };
        let [emg, eeg, other] = [numbers(1, "A", "EMG"), numbers(2, "B", "EEG"), numbers(3, "C", "ACC")];
        assert_eq!(value(&[other.clone(), eeg.clone(), emg.clone()], 0.into()), Ok(1.0));
        assert_eq!(value(&[other.clone(), eeg.clone()], 0.into()), Ok(2.0));
        assert_eq!(value(std::slice::from_ref(&other), 0.into()), Ok(3.0));
        let two = [emg, numbers(4, "D", "EMG")];
        let message = value(&two, 0.into()).unwrap_err();
        assert_eq!(
            message,
            "has several streams of muscles (A, D): name the channels with their stream, such as `A: 0`"
        );
        assert_eq!(value(&two, "D: 0".into()), Ok(4.0));
        assert!(
            value(&[head(5, "E", "EMG", 0.0, "float32", "")], 0.into()).unwrap_err().contains("at a rate")
        );
        assert!(
            value(&[head(5, "E", "EMG", 100.0, "float32", "")], 0.into())
                .unwrap_err()
                .contains("but gave none")
        );
        assert!(open(b"XDF;", &[0.into()]).unwrap_err().to_string().contains("(XDF)"));
    }

    #[test]
    fn a_rate_that_the_stamps_contradict_is_not_believed() {
        let chunks: Vec<Vec<u8>> = (0..20).map(|chunk| samples(1, f64::from(chunk), &[0.0; 100])).collect();
        let signals =
            open(&file(&[head(1, "A", "EMG", 110.0, "float32", ""), chunks.concat()]), &[0.into()]).unwrap();
        assert!((signals.sample_rate_hz - 100.0).abs() < 0.1, "{}", signals.sample_rate_hz);
        assert!(signals.notices.iter().any(|notice| matches!(notice, Notice::OtherRateFound { .. })));
    }

    #[test]
    fn short_gaps_are_believed_of_a_stream_that_says_that_it_loses_samples() {
        let gaps = |more: &str| {
            let chunks = [samples(1, 0.0, &[0.0; 100]), samples(1, 1.3, &[0.0; 100])].concat();
            open(&file(&[head(1, "A", "EMG", 100.0, "float32", more), chunks]), &[0.into()]).unwrap().gaps
        };
        let says = "<synchronization><can_drop_samples>true</can_drop_samples></synchronization>";
        assert_eq!(gaps(says), [Gap { before_sample: 100, lost_samples: 30 }]);
        // But what may be jitter is none, where there is enough to tell.
        let gaps_of = |late_s: f64| {
            let jitter_s = |chunk: usize| (chunk * 7 % 5) as f64 * 2e-3;
            let chunk = |chunk: usize| {
                let late_s = if chunk >= 20 { late_s } else { 0.0 };
                samples(1, chunk as f64 * 0.2 + jitter_s(chunk) + late_s, &[0.0; 20])
            };
            let chunks: Vec<Vec<u8>> = (0..40).map(chunk).collect();
            open(&file(&[head(1, "A", "EMG", 100.0, "float32", says), chunks.concat()]), &[0.into()])
                .unwrap()
                .gaps
        };
        assert_eq!(gaps_of(0.02), []);
        assert_eq!(gaps_of(0.2), [Gap { before_sample: 400, lost_samples: 20 }]);
        assert_eq!(gaps(""), []);
    }

    proptest! {
        #[test]
        fn no_damage_makes_it_panic(
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
            length in any::<prop::sample::Index>(),
        ) {
            let mut bytes = STREAMS.to_vec();
            for (place, value) in damage {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            for bytes in [&bytes[..], &bytes[..length.index(bytes.len())]] {
                let signals = open(bytes, &[0.into()]).and_then(|signals| signals.without_missing(Path::new("a")));
                if let Ok(signals) = signals {
                    prop_assert!(signals.columns[0].iter().all(|sample| sample.is_finite()));
                    let end = signals.columns[0].len() as u64;
                    prop_assert!(signals.cues.iter().all(|cue| cue.start_sample < end));
                    prop_assert!(signals.gaps.iter().all(|gap| gap.before_sample < end));
                    let segments = signals.segments(Path::new("a"));
                    prop_assert!(segments.iter().filter_map(|segment| segment.end_sample).is_sorted());
                }
            }
        }
    }
}
