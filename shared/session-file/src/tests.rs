//! Files of made-up sessions: written, cut, read, replayed and compared.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use tendon_messages::{ReplayMark, Stage, Truth};

use super::*;
use crate::records::{ContextRecord, TraceRecord};

const BLOCK_SAMPLES: u64 = 10;
const WINDOW_SAMPLES: u64 = 40;
const INCREMENT_SAMPLES: u64 = 20;

/// A session of one source, dsp, inference and decision, as their topics would show it.
#[derive(Clone, Debug)]
struct Session {
    now_ns: u64,
    messages: Vec<Message>,
    blocks: u64,
    first_sample: u64,
    /// Next sequence numbers of windows, predictions, commands.
    next: [u64; 3],
}

impl Session {
    fn new() -> Session {
        Session { now_ns: 1_000_000, messages: Vec::new(), blocks: 0, first_sample: 0, next: [0; 3] }
    }

    /// The next block; `stages` of dsp, inference and decision take the window that it completes.
    fn block(&mut self, stages: usize) {
        self.now_ns += 5_000_000;
        self.messages.push(Message::Block(Block {
            sequence: self.blocks,
            captured_ns: self.now_ns - 1000,
            published_ns: self.now_ns,
            first_sample: self.first_sample,
            sample_rate_hz: 2000.0,
            truth: Truth::default(),
            channels: 1,
            samples: BLOCK_SAMPLES as u32,
            non_finite_samples: 0,
            values: (0..BLOCK_SAMPLES).map(|sample| (self.first_sample + sample) as f32).collect(),
        }));
        self.blocks += 1;
        self.first_sample += BLOCK_SAMPLES;
        let end = self.first_sample;
        if end >= WINDOW_SAMPLES && (end - WINDOW_SAMPLES).is_multiple_of(INCREMENT_SAMPLES) {
            self.window(end - WINDOW_SAMPLES, stages);
        }
    }

    fn window(&mut self, first_sample: u64, stages: usize) {
        let trace = |session: &Session, stage: Stage| {
            let mut trace = TraceRecord { captured_ns: session.now_ns - 1000, ..TraceRecord::default() };
            trace.sequence = session.next[stage.index() - 1];
            trace.published_ns[0] = session.now_ns;
            trace.published_ns[stage.index()] = session.now_ns + 1000 * stage.number() as u64;
            trace
        };
        let context = ContextRecord { first_sample, ..ContextRecord::default() };
        let (dsp, inference, decision) =
            (trace(self, Stage::Dsp), trace(self, Stage::Inference), trace(self, Stage::Decision));
        let made = [
            Message::Window(WindowRecord { trace: dsp, context }),
            Message::Prediction(PredictionRecord {
                trace: inference,
                context,
                novelty: Number(f32::NAN),
                probabilities: [0.25, 0.75].map(Number).to_vec(),
                efforts: [0.0, f32::INFINITY].map(Number).to_vec(),
            }),
            Message::Command(CommandRecord {
                trace: decision,
                context,
                gesture: 1,
                voted: 0,
                confidence: Number(0.75),
                mode: 0,
                frame: 0,
                is_unsure: 0,
                ordered_mode: 0,
                gripper_toggles: 2,
                twist: [0.0, -0.0, 1e-40, f32::MAX, 0.1, 3.0].map(Number).to_vec(),
            }),
        ];
        for (message, next) in made.into_iter().zip(&mut self.next).take(stages) {
            self.messages.push(message);
            *next += 1;
        }
    }

    /// dsp says which block was the first of this process.
    fn dsp_says(&mut self, process_id: u64, first_sequence: u64) {
        self.messages.push(Message::Measurement(MeasurementRecord {
            sequence: 0,
            stage: "dsp".to_owned(),
            process_id,
            received: 1,
            published: 0,
            lost: 0,
            first_sequence,
            next_sequence: first_sequence + 1,
            stale: 0,
            lost_samples: 0,
            clock_drift_ppm: None,
            replaced_samples: 0,
            first_message_ns: self.now_ns + 500,
            newest_message_ns: self.now_ns + 500,
            finished: 0,
        }));
    }

    fn source_begins_anew(&mut self) {
        (self.blocks, self.first_sample) = (0, 0);
    }

    /// Its file; a chunk for every `chunk` messages.
    fn file(&self, chunk: usize) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = Writer::begin(&mut bytes, "test", 0).unwrap();
        writer.attach(CONFIGURATION, "application/toml", b"session = \"test\"\n").unwrap();
        writer.attach(MODEL, "application/octet-stream", &[1, 2, 3]).unwrap();
        for messages in self.messages.chunks(chunk) {
            for message in messages {
                writer.write(message, self.now_ns).unwrap();
            }
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }
}

fn read(bytes: &[u8]) -> (Vec<Message>, bool) {
    let mut reader = Reader::new(bytes, Path::new("session.mcap"));
    let mut messages = Vec::new();
    while let Ok(Some(message)) = reader.next_message() {
        messages.push(message);
    }
    (messages, reader.is_whole())
}

fn file_of(session: &Session) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    std::fs::write(&path, session.file(16)).unwrap();
    (folder, path)
}

/// A session with all stages for so many blocks.
fn undisturbed(blocks: usize) -> Session {
    let mut session = Session::new();
    (0..blocks).for_each(|_| session.block(3));
    session
}

#[test]
fn what_was_written_reads_back() {
    let mut session = undisturbed(12);
    session.dsp_says(7, 0);
    let event = Event { at_ns: 5, kind: EventKind::Note, text: "Elektrode 3 \"lose\"\n".to_owned() };
    session.messages.push(Message::Event(event));
    let cue =
        Cue { since_sample: 3, captured_ns: 9, class_number: Some(2), gesture: Some("fist".to_owned()) };
    session.messages.push(Message::Cue(cue));
    let (messages, is_whole) = read(&session.file(5));
    assert!(is_whole);
    assert_eq!(messages, session.messages);
    let (_folder, path) = file_of(&session);
    assert!(is_session_file(&path));
    let head = Head::read(&path).unwrap();
    assert_eq!(head.configuration, "session = \"test\"\n");
    assert_eq!(head.files[MODEL], [1, 2, 3]);
}

#[test]
fn a_file_that_was_cut_anywhere_gives_what_lies_in_its_whole_chunks() {
    let session = undisturbed(8);
    let bytes = session.file(3);
    let mut most = 0;
    for length in 0..bytes.len() {
        let (messages, is_whole) = read(&bytes[..length]);
        // All in order and none twice; nothing that was whole before is missing.
        assert_eq!(messages, session.messages[..messages.len()], "cut at {length}");
        assert!(
            messages.len() >= most && (messages.len() % 3 == 0 || messages.len() == session.messages.len())
        );
        assert!(!is_whole || messages.len() == session.messages.len(), "cut at {length}");
        most = messages.len();
    }
    assert_eq!(most, session.messages.len());
}

/// Where the chunks of a file lie, with opcode and length.
fn chunks_of(file: &[u8]) -> Vec<std::ops::Range<usize>> {
    let summary = mcap::Summary::read(file).unwrap().unwrap();
    let chunks = summary.chunk_indexes.iter();
    chunks
        .map(|chunk| {
            chunk.chunk_start_offset as usize..(chunk.chunk_start_offset + chunk.chunk_length) as usize
        })
        .collect()
}

#[test]
fn a_damaged_byte_spoils_its_chunk_alone() {
    let session = undisturbed(8);
    let whole = session.file(3);
    let chunks = chunks_of(&whole);
    // The first one says which channels there are.
    assert!(chunks.len() > session.messages.len() / 3, "{chunks:?}");
    for place in 8..whole.len() {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x10;
        let mut reader = Reader::new(bytes.as_slice(), Path::new("session.mcap"));
        let mut messages = Vec::new();
        while let Ok(Some(message)) = reader.next_message() {
            messages.push(message);
        }
        let mut expected = session.messages.iter();
        assert!(messages.iter().all(|message| expected.any(|other| other == message)), "byte {place}");
        if chunks.iter().any(|chunk| chunk.contains(&place)) {
            // The first chunk has no message, and the times in which a chunk was written are covered by no checksum.
            let missing = session.messages.len() - messages.len();
            assert!(missing <= 3 && (missing == 0 || reader.damaged_pieces() == 1), "byte {place}");
            assert!(reader.is_whole() && reader.damaged_pieces() <= 1, "byte {place}");
        } else if place > chunks[1].start && place < chunks[chunks.len() - 1].end {
            assert_eq!(messages.len(), session.messages.len(), "byte {place}");
        } else if messages.len() < session.messages.len() {
            assert!(reader.damaged_pieces() > 0 || !reader.is_whole(), "byte {place}");
        }
    }
}

#[test]
fn a_damaged_byte_of_the_metadata_is_said_though_no_piece_is_left_out() {
    let session = undisturbed(2000);
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = Writer::begin(&mut bytes, "test-name", 0).unwrap();
    for name in ["provenance", "stages"] {
        writer.metadata(name, [("json", format!("{{\"fact\":\"{name} said\"}}"))]).unwrap();
    }
    // More than is kept in memory at a time.
    session.messages.iter().for_each(|message| writer.write(message, 1).unwrap());
    writer.metadata(TASK, [("json", "{\"fact\":\"task said\"}".to_owned())]).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let whole = bytes.into_inner();
    let read = |bytes: &[u8]| {
        let mut reader = Reader::new(bytes, Path::new("session.mcap"));
        while reader.next().unwrap().is_some() {}
        (reader.is_whole(), reader.is_damaged_elsewhere(), reader.damaged_pieces())
    };
    assert_eq!(read(&whole), (true, false, 0));
    for text in ["test-name", "monotonic_to_time", "provenance said", "stages said", "task said"] {
        let place = whole.windows(text.len()).position(|part| part == text.as_bytes()).unwrap();
        for bit in 0..8 {
            let mut bytes = whole.clone();
            bytes[place + 3] ^= 1 << bit;
            // A byte that is no text is no metadata, which is left out.
            let (is_whole, is_damaged_elsewhere, pieces) = read(&bytes);
            assert!(is_whole && is_damaged_elsewhere == (pieces == 0), "{text}, bit {bit}");
            assert!(bit == 7 || is_damaged_elsewhere, "{text}, bit {bit}");
        }
    }
    // What was damaged before is said as such, and a file that was cut has no checksum.
    let mut bytes = whole.clone();
    let chunk = chunks_of(&whole)[1].clone();
    bytes[chunk.end - 1] ^= 1;
    assert_eq!(read(&bytes), (true, false, 1));
    assert_eq!(read(&whole[..chunk.end]), (false, false, 0));
}

#[test]
fn a_chunk_of_any_damaged_length_is_left_out_alone() {
    let session = undisturbed(40);
    let whole = session.file(3);
    let chunk = &chunks_of(&whole)[4];
    for length in (0..2000).chain([whole.len() as u64, 1 << 20, 300 << 20, u64::MAX]) {
        let mut bytes = whole.clone();
        bytes[chunk.start + 1..chunk.start + 9].copy_from_slice(&length.to_le_bytes());
        let mut reader = Reader::new(bytes.as_slice(), Path::new("session.mcap"));
        let mut count = 0;
        while reader.next_message().unwrap().is_some() {
            count += 1;
        }
        let is_right = bytes == whole;
        let missing = session.messages.len() - count;
        assert_eq!(missing, if is_right { 0 } else { 3 }, "length {length}");
        assert_eq!(reader.damaged_pieces(), u64::from(!is_right), "length {length}");
        assert!(reader.is_whole() && reader.damaged_bytes() < 4096, "length {length}");
    }
}

#[test]
fn a_record_of_any_kind_that_is_shorter_than_it_says_is_left_out() {
    let whole = undisturbed(2).file(1);
    for opcode in 0..=u8::MAX {
        for length in 0..64_usize {
            // Zeros say that a text is empty; 255, that it is longer than the record.
            for filling in [0, 1, 255] {
                let mut bytes = whole[..8].to_vec();
                bytes.push(opcode);
                bytes.extend((length as u64).to_le_bytes());
                bytes.extend(std::iter::repeat_n(filling, length));
                bytes.extend(&whole[8..]);
                let mut reader = Reader::new(bytes.as_slice(), Path::new("session.mcap"));
                while let Ok(Some(_)) = reader.next() {}
            }
        }
    }
}

#[test]
fn blocks_alone_are_read_into_the_same_room() {
    let session = undisturbed(12);
    let file = session.file(5);
    let mut reader = Reader::new(file.as_slice(), Path::new("session.mcap"));
    let mut block = Block::default();
    let mut blocks = Vec::new();
    while reader.next_block(&mut block).unwrap() {
        blocks.push(Message::Block(block.clone()));
    }
    let is_block = |message: &&Message| matches!(message, Message::Block(_));
    assert!(blocks.iter().eq(session.messages.iter().filter(is_block)));
    assert!(reader.is_whole());
}

#[test]
fn no_chunk_is_large_however_fast_the_messages_come() {
    let bytes = undisturbed(2000).file(usize::MAX);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let largest = summary.chunk_indexes.iter().map(|chunk| chunk.chunk_length).max().unwrap();
    assert!(bytes.len() > 500_000 && largest < 110_000, "{largest} of {}", bytes.len());
}

#[test]
fn what_is_no_file_of_a_session_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.mcap");
    for bytes in [&b""[..], b"time,flexor\n1,2\n", b"\x89MCAP0\r\n"] {
        std::fs::write(&path, bytes).unwrap();
        let error = Head::read(&path).unwrap_err();
        assert!(matches!(error, SessionFileError::NotOne { .. }), "{error}");
        assert!(error.to_string().contains("other.mcap"), "{error}");
    }
    let other = mcap::WriteOptions::new().profile("ros2").create(Cursor::new(Vec::new())).unwrap();
    std::fs::write(&path, other.into_inner().into_inner()).unwrap();
    assert!(matches!(Head::read(&path), Err(SessionFileError::NotOne { .. })));
    assert!(matches!(Head::read(&folder.path().join("none")), Err(SessionFileError::Read { .. })));
}

#[test]
fn windows_that_a_stage_left_out_are_marked_and_those_that_dsp_left_out_are_missing() {
    let mut session = undisturbed(4);
    for stages in [3, 0, 3, 1, 3, 2] {
        session.block(stages);
        session.block(stages);
    }
    let (_folder, path) = file_of(&session);
    let mut marks = ReplayMarks::read(&path).unwrap();
    assert!(!marks.begins_anew(0));
    let seen: Vec<Option<u8>> = (0..7).map(|window| marks.window(window * INCREMENT_SAMPLES)).collect();
    let [inference, decision] =
        [ReplayMark::LeftOutByInference, ReplayMark::LeftOutByDecision].map(ReplayMark::bit);
    assert_eq!(seen, [Some(0), Some(0), None, Some(0), Some(inference), Some(0), Some(decision)]);
}

#[test]
fn a_stage_that_began_anew_is_marked_where_it_did() {
    let mut session = undisturbed(6);
    session.dsp_says(1, 0);
    // inference is killed, and misses a window.
    session.block(1);
    session.block(1);
    session.next[1] = 0;
    session.block(3);
    session.block(3);
    // decision, at once.
    session.next[2] = 0;
    session.block(3);
    session.block(3);
    // dsp: a new one takes block 13 first.
    session.block(0);
    session.block(0);
    session.block(0);
    session.block(0);
    session.dsp_says(2, 13);
    let (_folder, path) = file_of(&session);
    let mut marks = ReplayMarks::read(&path).unwrap();
    let anew: Vec<u64> = (0..session.blocks)
        .map(|block| block * BLOCK_SAMPLES)
        .filter(|first| marks.begins_anew(*first))
        .collect();
    assert_eq!(anew, [130]);
    let marked = |first_sample| marks.window(first_sample);
    assert_eq!(marked(40), Some(ReplayMark::LeftOutByInference.bit()));
    assert_eq!(marked(60), Some(ReplayMark::InferenceBeganAnew.bit()));
    assert_eq!(marked(80), Some(ReplayMark::DecisionBeganAnew.bit()));
    assert_eq!(marked(100), None);
}

#[test]
fn a_mode_that_was_ordered_is_repeated_with_the_window_that_it_was_taken_with() {
    let mut session = undisturbed(12);
    let commands = session.messages.iter_mut().filter_map(|message| match message {
        Message::Command(command) => Some(command),
        _ => None,
    });
    for (command, ordered_mode) in commands.zip([0, 2, 0, 1]) {
        command.ordered_mode = ordered_mode;
    }
    let (_folder, path) = file_of(&session);
    let mut marks = ReplayMarks::read(&path).unwrap();
    marks.begins_anew(0);
    let ordered: Vec<u8> = (0..4).map(|window| marks.ordered_mode(window * INCREMENT_SAMPLES)).collect();
    assert_eq!(ordered, [0, 2, 0, 1]);
}

#[test]
fn windows_of_a_source_that_began_anew_are_told_from_those_before() {
    let mut session = undisturbed(6);
    session.source_begins_anew();
    for stages in [0, 0, 0, 1, 3, 3] {
        session.block(stages);
    }
    let (_folder, path) = file_of(&session);
    let mut marks = ReplayMarks::read(&path).unwrap();
    marks.begins_anew(0);
    assert_eq!(marks.window(0), Some(0));
    marks.begins_anew(50);
    marks.begins_anew(0);
    assert_eq!(marks.window(0), Some(ReplayMark::LeftOutByInference.bit()));
}

#[test]
fn two_recordings_are_compared_window_by_window() {
    let first = undisturbed(12);
    let mut second = first.clone();
    let (_first_folder, first_path) = file_of(&first);
    let same = compare(&first_path, &first_path, |_| ()).unwrap();
    assert_eq!((same.differences(), same.predictions.same, same.commands.same), (0, 5, 5));
    // One bit of a twist, one prediction fewer, one more.
    for message in &mut second.messages {
        match message {
            Message::Command(command) if command.context.first_sample == 40 => command.twist[1] = Number(0.0),
            _ => {}
        }
    }
    second.messages.retain(|message| {
        !matches!(message, Message::Prediction(prediction) if prediction.context.first_sample == 60)
    });
    second.block(3);
    second.block(3);
    let (_second_folder, second_path) = file_of(&second);
    let found = compare(&first_path, &second_path, |_| ()).unwrap();
    let counts =
        |found: &Differences| (found.same, found.different, found.only_in_first, found.only_in_second);
    assert_eq!(counts(&found.predictions), (4, 0, 1, 1));
    assert_eq!(counts(&found.commands), (4, 1, 0, 1));
    assert_eq!(found.differences(), 4);
    assert_eq!(found.commands.first[0].first_sample, 40);
    assert!(found.commands.first[0].what.starts_with("twist [0.0, -0.0,"), "{:?}", found.commands.first[0]);
    assert_eq!(found.predictions.first[0].what, "only in the first recording");
    assert!(found.is_fair() && found.lacks_beginning == [false, false]);
    assert_eq!((found.damaged_pieces, found.is_whole), ([0, 0], [true, true]));

    // Cut, and damaged in its first chunk.
    let bytes = std::fs::read(&first_path).unwrap();
    let cut = first_path.with_file_name("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let damaged = first_path.with_file_name("damaged.mcap");
    let mut flipped = bytes.clone();
    let place = bytes.windows(12).position(|part| part == b"\"probabiliti").unwrap();
    flipped[place] ^= 1;
    std::fs::write(&damaged, flipped).unwrap();
    let found = compare(&cut, &damaged, |_| ()).unwrap();
    assert_eq!((found.damaged_pieces, found.is_whole), ([0, 1], [false, true]));

    // Begun by key, in a running session.
    let first_block = first.messages.iter().position(|message| matches!(message, Message::Block(_))).unwrap();
    let mut late = first.clone();
    late.messages.remove(first_block);
    let (_late_folder, late_path) = file_of(&late);
    let found = compare(&first_path, &late_path, |_| ()).unwrap();
    assert!(!found.is_fair() && found.lacks_beginning == [false, true]);
    assert!(compare(&late_path, &late_path, |_| ()).unwrap().is_fair());
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        cut: prop::sample::Index,
    ) {
        let mut bytes = undisturbed(8).file(3);
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        bytes.truncate(cut.index(bytes.len()) + 1);
        read(&bytes);
    }
}
