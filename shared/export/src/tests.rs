//! Exports of made-up sessions, read again.

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tendon_recordings::{Channel, RecordingSettings, RecordingSource, Signals};
use tendon_session_file::Message;

use crate::*;

mod session;

pub(crate) use session::{BEGUN_NS, RATE_HZ, Session, eventful};

fn survey(path: &Path) -> Survey {
    Survey::read(path, |_| Ok(())).unwrap()
}

fn exported(session: &Session) -> (TempDir, PathBuf) {
    let (folder, path) = session.file();
    let tables = folder.path().join("tables");
    write_tables(&survey(&path), &tables, false, |_| Ok(())).unwrap();
    (folder, tables)
}

/// The rows of a table, without the line of names.
fn rows(folder: &Path, file: &str) -> Vec<Vec<String>> {
    let rows = csv::Reader::from_path(folder.join(file)).unwrap().into_records();
    rows.map(|row| row.unwrap().iter().map(str::to_owned).collect()).collect()
}

fn names(folder: &Path, file: &str) -> Vec<String> {
    csv::Reader::from_path(folder.join(file)).unwrap().headers().unwrap().iter().map(str::to_owned).collect()
}

#[test]
fn the_signal_reads_back_bit_for_bit_with_its_gaps_in_time() {
    let session = eventful();
    let (_folder, tables) = exported(&session);
    let channels = ["flexor", "channel_2", "a_ _b_"].map(|name| Channel::Name(name.to_owned())).to_vec();
    let settings = RecordingSettings { channels, ..RecordingSettings::default() };
    let mut source = RecordingSource::open(&tables.join("signal.csv"), &settings).unwrap();
    assert!((source.sample_rate_hz() / RATE_HZ - 1.0).abs() < 1e-6, "{} Hz", source.sample_rate_hz());
    let mut values = [0.0_f32; 3];
    let mut read = Vec::new();
    while let Some(frame) = source.next_frame(&mut values).unwrap() {
        read.push((values, frame.samples_lost_before));
    }
    let samples: Vec<u64> = (0..40).chain(70..90).chain(0..30).collect();
    assert_eq!(read.len(), samples.len());
    for (row, ((values, lost), sample)) in read.iter().zip(&samples).enumerate() {
        for (channel, value) in values.iter().enumerate() {
            let expected = Session::value(channel, *sample);
            assert_eq!(value.to_bits(), expected.to_bits(), "row {row}, channel {channel}");
        }
        assert_eq!(
            *lost,
            match row {
                40 => 30,
                60 => 2000,
                _ => 0,
            },
            "row {row}"
        );
    }
    // 0.5 ms from sample to sample, 30 samples lost, and a second until the source began anew.
    let times: Vec<f64> = rows(&tables, "signal.csv").iter().map(|row| row[0].parse().unwrap()).collect();
    for (row, time_s) in [(0, 0.0), (39, 0.0195), (40, 0.035), (59, 0.0445), (60, 1.045), (89, 1.0595)] {
        assert!((times[row] - time_s).abs() < 2e-7, "row {row}: {} s", times[row]);
    }
    assert_eq!(names(&tables, "signal.csv"), ["time_s", "flexor", "channel_2", "a_ _b_"]);
}

#[test]
fn a_cue_that_is_known_before_it_comes_waits_for_its_block() {
    let mut session = Session::new(3);
    session.cue(1, "extension");
    session.blocks(2);
    session.cue_ahead(15, 0, "rest");
    session.blocks(2);
    let (_folder, tables) = exported(&session);
    assert_eq!(
        rows(&tables, "trials.csv"),
        [["0.0000000", "0.0175000", "extension", "0", "35"], ["0.0175000", "0.0200000", "rest", "35", "40"]]
    );
}

#[test]
fn trials_events_and_windows_lie_on_the_same_axis_as_the_samples() {
    let (_folder, tables) = exported(&eventful());
    assert_eq!(
        rows(&tables, "trials.csv"),
        [
            ["0.0000000", "0.0100000", "rest", "0", "20"],
            // It ended with the last sample before the source began anew.
            ["0.0100000", "0.0450000", "extension", "20", "60"],
            ["1.0450000", "1.0600000", "rest", "60", "90"],
        ]
    );
    let events = rows(&tables, "events.csv");
    let said: Vec<[&str; 2]> = events.iter().map(|row| [row[1].as_str(), row[2].as_str()]).collect();
    assert_eq!(
        said,
        [
            ["arm", "arm waits for rest"],
            ["cue", "rest"],
            ["cue", "extension"],
            ["note", "electrode 3, \"loose\""],
            ["arm", "arm follows"],
            ["cue", "rest"],
            ["arm", "arm is stopped: stopped by order"],
        ]
    );
    assert_eq!(events[3][0], "0.0200000");
    let windows = rows(&tables, "predictions.csv");
    assert_eq!((windows[0][0].as_str(), windows[1][0].as_str()), ("0.0095000", "1.0545000"));
    let columns = names(&tables, "predictions.csv");
    let cell = |name: &str| windows[0][columns.iter().position(|column| column == name).unwrap()].as_str();
    assert_eq!((cell("truth"), cell("activity"), cell("gesture")), ("extension", "move", "extension"));
    assert_eq!((cell("novelty"), cell("probability_flexion"), cell("effort_extension")), ("", "0.3", "inf"));
    assert_eq!((cell("acquisition_to_dsp_us"), cell("inference_us")), ("10", "30"));
    assert_eq!(cell("newest_sample_to_prediction_us"), "580");
    assert_eq!(rows(&tables, "decisions.csv")[0][2..5], ["extension", "0.6", "rest"]);
    assert_eq!(rows(&tables, "commands.csv")[0][2..], ["tool", "0", "-1.5", "0", "0", "0.25", "0", "3"]);
    assert_eq!(rows(&tables, "arm.csv").len(), 4);
    assert_eq!(rows(&tables, "zones.csv")[1][6..10], ["0", "", "", ""]);
}

#[test]
fn a_source_with_impossible_time_stamps_moves_nothing() {
    let times_s = |stamp: Option<u64>| -> Vec<f64> {
        let mut session = eventful();
        for message in &mut session.messages {
            if let (Message::Block(block), Some(stamp)) = (message, stamp) {
                block.captured_ns = stamp;
            }
        }
        let (_folder, tables) = exported(&session);
        ["events.csv", "arm.csv"]
            .into_iter()
            .flat_map(|table| rows(&tables, table))
            .map(|row| row[0].parse().unwrap())
            .collect()
    };
    let sane_s = times_s(None);
    for stamp in [0, u64::MAX] {
        let moved_s =
            times_s(Some(stamp)).into_iter().zip(&sane_s).map(|(time_s, sane_s)| (time_s - sane_s).abs());
        assert!(moved_s.fold(0.0, f64::max) < 0.001, "{stamp}");
    }
}

#[test]
fn every_column_is_described_and_the_session_says_what_it_is() {
    use std::os::unix::fs::PermissionsExt;

    let (_folder, tables) = exported(&eventful());
    let json = |file: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(tables.join(file)).unwrap()).unwrap()
    };
    let described = json("columns.json");
    for (table, columns) in described.as_object().unwrap() {
        let columns = columns.as_array().unwrap().iter().map(|column| column["name"].as_str().unwrap());
        assert_eq!(columns.collect::<Vec<_>>(), names(&tables, &format!("{table}.csv")), "{table}");
    }
    assert_eq!(described["signal"][1]["unit"], "uV");
    let session = json("session.json");
    assert_eq!((&session["person"], &session["provenance"]["version"]), (&"anna".into(), &"1.2.3".into()));
    assert_eq!((&session["samples"], &session["recording"]["is_whole"]), (&90.into(), &true.into()));
    assert_eq!(session["gaps"].as_array().unwrap().len(), 2);
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&tables), 0o700);
    let files: Vec<PathBuf> =
        std::fs::read_dir(&tables).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), TABLES.len(), "{files:?}");
    assert!(files.iter().all(|file| mode(file) == 0o600), "{files:?}");
}

#[test]
fn a_file_that_was_cut_is_exported_up_to_there_and_one_without_samples_is_refused() {
    let mut session = eventful();
    session.blocks(200);
    let (folder, path) = session.file();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let cut = survey(&path);
    assert!(!cut.is_whole && cut.samples > 0, "{cut:?}");
    let tables = folder.path().join("tables");
    write_tables(&cut, &tables, false, |_| Ok(())).unwrap();
    assert_eq!(rows(&tables, "signal.csv").len() as u64, cut.samples);
    let (_folder, path) = Session::new(1).file();
    assert!(matches!(Survey::read(&path, |_| Ok(())), Err(ExportError::NoSamples { .. })));
}

#[test]
fn a_session_whose_person_or_beginning_is_damaged_says_so() {
    let (folder, path) = eventful().file();
    let bytes = std::fs::read(&path).unwrap();
    let whole = survey(&path);
    assert!(whole.person.is_some() && !whole.lacks_person && !whole.is_damaged_elsewhere);
    let damaged = |text: &str| {
        let mut bytes = bytes.clone();
        let place = bytes.windows(text.len()).position(|part| part == text.as_bytes()).unwrap();
        bytes[place + text.len() - 1] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        survey(&path)
    };
    let person = damaged("name = \"anna");
    assert!(person.person.is_none() && person.lacks_person && person.damaged_pieces == 1);
    let channels = damaged("flexor");
    assert_eq!(channels.channels[0], "flexos");
    assert!(channels.is_damaged_elsewhere && !channels.lacks_person && channels.damaged_pieces == 0);
    let tables = folder.path().join("tables");
    write_tables(&channels, &tables, false, |_| Ok(())).unwrap();
    let session = std::fs::read_to_string(tables.join("session.json")).unwrap();
    assert!(session.contains("\"is_damaged_elsewhere\": true"), "{session}");
}

#[test]
fn an_export_that_fails_leaves_nothing() {
    let (folder, path) = eventful().file();
    let surveyed = survey(&path);
    std::fs::remove_file(&path).unwrap();
    let tables = folder.path().join("tables");
    assert!(write_tables(&surveyed, &tables, false, |_| Ok(())).is_err());
    assert!(!tables.exists());
    // A folder that was there before stays.
    std::fs::create_dir(&tables).unwrap();
    assert!(write_tables(&surveyed, &tables, false, |_| Ok(())).is_err());
    assert_eq!(std::fs::read_dir(&tables).unwrap().count(), 0);
}

#[test]
fn an_export_that_is_interrupted_leaves_nothing_and_one_that_is_killed_hinders_no_other() {
    let (folder, path) = eventful().file();
    let surveyed = survey(&path);
    let [tables, data_set] = ["tables", "study"].map(|name| folder.path().join(name));
    let interrupted = write_tables(&surveyed, &tables, false, |_| Err(ExportError::Interrupted));
    assert!(matches!(interrupted, Err(ExportError::Interrupted)), "{interrupted:?}");
    let facts = BidsFacts::default();
    let interrupted = write_bids(&surveyed, &facts, &data_set, false, |_| Err(ExportError::Interrupted));
    assert!(matches!(interrupted, Err(ExportError::Interrupted)), "{interrupted:?}");
    assert!(!tables.exists() && !data_set.exists());

    for place in [&tables, &data_set] {
        std::fs::create_dir_all(place.join(".tendon-a1b2c3")).unwrap();
        std::fs::write(place.join(".tendon-a1b2c3/signal.csv"), "").unwrap();
    }
    write_tables(&surveyed, &tables, false, |_| Ok(())).unwrap();
    write_bids(&surveyed, &facts, &data_set, false, |_| Ok(())).unwrap();
    assert!([tables, data_set].iter().all(|place| !place.join(".tendon-a1b2c3").exists()));
}

#[test]
fn one_export_at_a_time_writes_to_a_folder() {
    let (folder, path) = eventful().file();
    let surveyed = survey(&path);
    let tables = folder.path().join("tables");
    let mut refused = 0;
    write_tables(&surveyed, &tables, false, |_| {
        let other = write_tables(&surveyed, &tables, false, |_| Ok(()));
        assert!(matches!(other, Err(ExportError::Busy { .. })), "{other:?}");
        let other = write_bids(&surveyed, &BidsFacts::default(), &tables, false, |_| Ok(()));
        assert!(matches!(other, Err(ExportError::Busy { .. })), "{other:?}");
        refused += 1;
        Ok(())
    })
    .unwrap();
    assert!(refused > 0);
    // One that looked before the other was done sees now that it is not wanted.
    let late = write_tables(&surveyed, &tables, false, |_| Ok(()));
    assert!(matches!(late, Err(ExportError::NotEmpty { .. })), "{late:?}");
    write_tables(&surveyed, &tables, true, |_| Ok(())).unwrap();
}

#[test]
fn only_what_an_export_wrote_is_replaced() {
    let (_session, tables) = exported(&eventful());
    let write = |file: &str, text: &str| std::fs::write(tables.join(file), text).unwrap();
    let refused = || match crate::tables::check_replaceable(&tables) {
        Err(ExportError::NoExport { path }) => Some(path),
        checked => checked.map(|()| None).unwrap(),
    };
    assert_eq!(refused(), None);
    // Of a session without a task, after which there are no zones.
    let (_other_folder, other) = eventful().file();
    let without_task = Survey { task: None, ..survey(&other) };
    write_tables(&without_task, &tables, true, |_| Ok(())).unwrap();
    assert!(!tables.join("zones.csv").exists());
    assert_eq!(refused(), None);
    for file in ["zones.csv", "signal.csv"] {
        write(file, "zone,mine\n1,2\n");
        assert_eq!(refused(), Some(tables.join(file)));
        let kept = write_tables(&survey(&other), &tables, true, |_| Ok(()));
        assert!(matches!(kept, Err(ExportError::NoExport { .. })), "{kept:?}");
        std::fs::remove_dir_all(&tables).unwrap();
        write_tables(&survey(&other), &tables, false, |_| Ok(())).unwrap();
        assert_eq!(refused(), None);
    }
    std::fs::remove_file(tables.join("arm.csv")).unwrap();
    assert_eq!(refused(), Some(tables.clone()));
    write("columns.json", "{}");
    assert!(refused().is_some());
    assert_eq!(
        std::fs::read_dir(&tables).unwrap().count(),
        TABLES.len() - 1,
        "a look at a folder changes nothing"
    );
}

/// A file in the only folder of recordings of a data set, by its ending.
fn bids_file(data_set: &Path, session: usize, ending: &str) -> PathBuf {
    let mut sessions: Vec<PathBuf> =
        std::fs::read_dir(data_set.join("sub-anna")).unwrap().map(|entry| entry.unwrap().path()).collect();
    sessions.sort();
    let files = std::fs::read_dir(sessions[session].join("emg")).unwrap().map(|entry| entry.unwrap().path());
    files.into_iter().find(|file| file.to_str().unwrap().ends_with(ending)).unwrap()
}

#[test]
fn a_data_set_has_each_session_with_its_gaps() {
    let (folder, path) = eventful().file();
    let data_set = folder.path().join("study");
    let facts = BidsFacts { reference: Some("Bipolar".to_owned()), ..BidsFacts::default() };
    let written = write_bids(&survey(&path), &facts, &data_set, false, |_| Ok(())).unwrap();
    assert_eq!(written, bids_file(&data_set, 0, "task-zones_emg.bdf"));
    let bytes = std::fs::read(&written).unwrap();
    let text = |at: usize, width: usize| std::str::from_utf8(&bytes[at..at + width]).unwrap().trim_end();
    let number = |at: usize, width: usize| text(at, width).parse::<f64>().unwrap();
    assert_eq!((text(192, 44), text(8, 80)), ("BDF+D", "anna X X X"));
    let (head, records) = (number(184, 8) as usize, number(236, 8) as usize);
    assert_eq!(head, 256 * 5);
    let samples = number(256 + 4 * 216, 8) as usize;
    assert!((number(244, 8) * RATE_HZ - samples as f64).abs() < 1e-9);
    assert_eq!(text(256, 64), "flexor          2               a, \"b\"          BDF Annotations");
    let record_length = (bytes.len() - head) / records;
    assert_eq!(bytes.len(), head + records * record_length);
    // Each record says when it begins; what the records hold is what was recorded, to one digit of 24 bits.
    let expected: Vec<(f64, u64)> = [(0.0, 0, 40), (0.035, 70, 90), (1.045, 0, 30)]
        .into_iter()
        .flat_map(|(start_s, from, to)| {
            (from..to).map(move |sample| (start_s + (sample - from) as f64 / RATE_HZ, sample))
        })
        .collect();
    let mut read = 0;
    let subsecond_s = survey(&path).begun_at.duration_since(std::time::UNIX_EPOCH).unwrap().subsec_nanos();
    for record in bytes[head..].chunks(record_length) {
        let said = String::from_utf8_lossy(&record[3 * samples * 3..]).into_owned();
        let start_s: f64 = said.split('\u{14}').next().unwrap().parse().unwrap();
        let start_s = start_s - f64::from(subsecond_s) * 1e-9;
        for sample in 0..samples {
            let at_s = start_s + sample as f64 / RATE_HZ;
            let Some((_, number_of_sample)) =
                expected.iter().find(|(time_s, _)| (time_s - at_s).abs() < 1e-5)
            else {
                continue;
            };
            read += 1;
            for channel in 0..3 {
                let at = 3 * (channel * samples + sample);
                let digital = i32::from_le_bytes([0, record[at], record[at + 1], record[at + 2]]) >> 8;
                let [low, high] = [104, 112].map(|place| number(256 + 4 * place + 8 * channel, 8));
                let value = (f64::from(digital) + 8_388_608.0) / 16_777_215.0 * (high - low) + low;
                let expected = f64::from(Session::value(channel, *number_of_sample));
                assert!((value - expected).abs() <= (high - low) / 16_777_215.0, "{value} {expected}");
            }
        }
    }
    assert_eq!(read, 90);
    let json =
        |file: &Path| -> serde_json::Value { serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap() };
    let recording = json(&bids_file(&data_set, 0, "_emg.json"));
    assert_eq!(
        (&recording["RecordingType"], &recording["EMGReference"]),
        (&"discontinuous".into(), &"Bipolar".into())
    );
    assert_eq!((&recording["EMGChannelCount"], &recording["PowerLineFrequency"]), (&3.into(), &"n/a".into()));
    let events = std::fs::read_to_string(bids_file(&data_set, 0, "_events.tsv")).unwrap();
    assert!(events.contains("0.010000\t0.035000\tgesture\textension\n"), "{events}");
    let channels = std::fs::read_to_string(bids_file(&data_set, 0, "_channels.tsv")).unwrap();
    assert_eq!(channels.lines().nth(1), Some("flexor\tEMG\tuV\tflexor"));

    // The same again is refused, replaced if wanted; another session joins it, and what a person wrote stays.
    let again = write_bids(&survey(&path), &facts, &data_set, false, |_| Ok(()));
    assert!(matches!(again, Err(ExportError::Exists { .. })), "{again:?}");
    write_bids(&survey(&path), &facts, &data_set, true, |_| Ok(())).unwrap();
    let written = std::fs::read(&written).unwrap();
    // A sidecar alone, and a recording of something else, are none of an export.
    let recording = bids_file(&data_set, 0, "_emg.bdf");
    for other in [None, Some(b"\xFFBIOSEMI anna".as_slice())] {
        std::fs::remove_file(&recording).unwrap();
        if let Some(bytes) = other {
            std::fs::write(&recording, bytes).unwrap();
        }
        for (replace, is_told_apart) in [(false, false), (true, true)] {
            let refused = write_bids(&survey(&path), &facts, &data_set, replace, |_| Ok(())).unwrap_err();
            assert_eq!(matches!(refused, ExportError::NoExport { .. }), is_told_apart, "{refused}");
        }
        std::fs::write(&recording, &written).unwrap();
    }
    std::fs::write(data_set.join("README"), "mine").unwrap();
    let mut other = Session::beginning_at(2, BEGUN_NS + 3_600_000_000_000);
    other.blocks(3);
    let (_other_folder, other) = other.file();
    write_bids(&survey(&other), &BidsFacts::default(), &data_set, false, |_| Ok(())).unwrap();
    assert_eq!(json(&bids_file(&data_set, 1, "_emg.json"))["RecordingType"], "continuous");
    assert_eq!(std::fs::read_to_string(data_set.join("README")).unwrap(), "mine");
    let participants = std::fs::read_to_string(data_set.join("participants.tsv")).unwrap();
    assert_eq!(participants, "participant_id\tpseudonym\nsub-anna\tanna\n");
}

#[test]
fn streams_are_on_one_clock() {
    let (_folder, path) = eventful().file();
    let mut bytes = Vec::new();
    write_xdf(&survey(&path), &mut bytes, |_| Ok(())).unwrap();
    let contains = |part: &[u8]| bytes.windows(part.len()).any(|window| window == part);
    assert!(contains(b"<sample_count>90</sample_count>") && contains(b"<unit>uV</unit>"));
    let stamped = |at_s: f64, value: &[u8]| contains(&[&[8], &at_s.to_le_bytes()[..], value].concat());
    // The first sample, and those behind the gaps.
    for (time_s, sample) in [(0.0, 0), (0.035, 70)] {
        assert!(stamped(5.0 + time_s, &Session::value(0, sample).to_le_bytes()), "sample {sample}");
    }
    assert!(
        contains(b"\x04rest") && contains(b"cue extension") && contains(b"arm is stopped: stopped by order")
    );
}

#[test]
fn what_is_exported_is_read_again_with_its_gaps_and_cues() {
    let (folder, path) = eventful().file();
    let survey = survey(&path);
    let bdf =
        write_bids(&survey, &BidsFacts::default(), &folder.path().join("study"), false, |_| Ok(())).unwrap();
    let xdf = folder.path().join("session.xdf");
    write_xdf(&survey, &mut std::fs::File::create(&xdf).unwrap(), |_| Ok(())).unwrap();
    let read = |file: &Path| Signals::read(file, &["a, \"b\"".into(), "flexor".into()]).unwrap();
    let [bdf, xdf] = [read(&bdf), read(&xdf)];
    // Rows 0 to 39, 40 to 59 behind 30 lost ones, and 30 more of a source that began anew a second later.
    let numbers: Vec<u64> = (0..40).chain(70..90).chain(0..30).collect();
    for (column, channel) in xdf.columns.iter().zip([2, 0]) {
        assert!(column.iter().copied().eq(numbers.iter().map(|number| Session::value(channel, *number))));
    }
    let gaps: Vec<(u64, u64)> = xdf.gaps.iter().map(|gap| (gap.before_sample, gap.lost_samples)).collect();
    assert_eq!(gaps, [(40, 30), (60, 2000)]);
    let cues: Vec<(&str, u64)> = xdf.cues.iter().map(|cue| (cue.gesture.name(), cue.start_sample)).collect();
    assert_eq!(cues, [("rest", 0), ("extension", 20), ("rest", 60)]);
    assert_eq!((xdf.unit.as_str(), xdf.sample_rate_hz, xdf.notices.len()), ("uV", RATE_HZ, 0));
    // Records are filled up, but what fills them is not read again, nor is anything lost or moved.
    let step = 3000.0 / 16_777_215.0;
    let is_near = |(read, written): (&f32, &f32)| (read - written).abs() <= step;
    assert_eq!(bdf.columns[0].len(), 90);
    assert!(bdf.columns[0].iter().zip(&xdf.columns[0]).all(is_near));
    assert_eq!((bdf.gaps, bdf.unit.as_str(), bdf.sample_rate_hz), (xdf.gaps, "uV", RATE_HZ));
    assert!(bdf.cues.iter().map(|cue| cue.gesture.name()).eq(["rest", "extension", "rest"]));
}

#[test]
fn a_cue_after_which_nothing_is_asked_for_ends_in_every_format() {
    let mut session = Session::new(2);
    session.cue_is_over();
    session.blocks(2);
    session.cue(1, "extension");
    session.blocks(3);
    session.cue_is_over();
    session.blocks(4);
    let (folder, tables) = exported(&session);
    let said: Vec<Vec<String>> = rows(&tables, "events.csv").iter().map(|row| row[1..].to_vec()).collect();
    assert_eq!(said, [["cue", "extension"], ["cue", "is over"]]);
    let survey = survey(&folder.path().join("session.mcap"));
    let facts = BidsFacts::default();
    let bdf = write_bids(&survey, &facts, &folder.path().join("study"), false, |_| Ok(())).unwrap();
    let xdf = folder.path().join("session.xdf");
    write_xdf(&survey, &mut std::fs::File::create(&xdf).unwrap(), |_| Ok(())).unwrap();
    for file in [bdf, xdf] {
        let cues = Signals::read(&file, &["flexor".into()]).unwrap().cues;
        let cues: Vec<(&str, u64, Option<u64>)> =
            cues.iter().map(|cue| (cue.gesture.name(), cue.start_sample, cue.end_sample)).collect();
        assert_eq!(cues, [("extension", 20, Some(50))], "{}", file.display());
    }
}
