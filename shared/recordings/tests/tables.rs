//! Tables as amplifiers' programs and people write them: each small input stands for a kind.
#![allow(clippy::unwrap_used, reason = "helpers of tests, as tests, may fail")]

use std::fmt::Write;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use tempfile::TempDir;
use tendon_gesture::Gesture;
use tendon_recordings::{
    Channel, ColumnKind, Notice, RecordingError, RecordingSettings, RecordingSource, ReplayStream, Summary,
    check, first_muscles, summed_up,
};

/// The same in every run, without a trend: EMG, as far as a table is concerned.
fn emg(row: usize, channel: usize) -> f64 {
    let noise = (row * 7919 + channel * 104_729 + row * row % 97 * 31) % 2001;
    (noise as f64 - 1000.0) / 1000.0
}

/// A row of samples of channels 0 to `channels`.
fn samples(row: usize, channels: usize, separator: &str) -> String {
    (0..channels).map(|channel| format!("{:.4}", emg(row, channel))).collect::<Vec<_>>().join(separator)
}

fn rows(count: usize, row: impl Fn(usize) -> String) -> String {
    (0..count).map(|index| row(index) + "\n").collect()
}

fn file(name: &str, text: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

/// What is read when nobody says which four channels, or at which rate.
fn read_unasked(text: &str) -> Result<Summary, RecordingError> {
    let (_folder, path) = file("emg.csv", text);
    let channels = first_muscles(&path, 4, None)?;
    check(&path, &RecordingSettings { channels, ..RecordingSettings::default() })
}

fn assert_read(text: &str, channels: [&str; 4], rate_hz: f64, samples: u64, unit: &str) -> Vec<Notice> {
    let summary = read_unasked(text).unwrap();
    assert_eq!(summary.channels, channels);
    assert!((summary.sample_rate_hz / rate_hz - 1.0).abs() < 1e-5, "{} Hz", summary.sample_rate_hz);
    assert_eq!((summary.samples, summary.unit.as_str()), (samples, unit));
    summary.notices
}

const ABCD: [&str; 4] = ["EMG_a", "EMG_b", "EMG_c", "EMG_d"];

#[test]
fn time_is_no_muscle_and_gives_the_rate_whatever_its_unit() {
    for (name, step, digits, rate_hz) in [
        ("Time", 0.001, 4, 1000.0),
        ("t", 0.0005, 4, 2000.0),
        ("t_s", 0.004, 3, 250.0),
        ("time_ms", 0.5, 1, 2000.0),
        ("Timestamp", 1000.0, 0, 1000.0),
        ("X[s]", 1.0 / 1925.926, 6, 1925.926),
        ("", 0.001, 3, 1000.0),
        ("a", 4.0, 0, 250.0),
        // Read out coarser than it is sampled.
        ("Time", 1.0 / 1925.926, 3, 1925.926),
    ] {
        for start in [0.0, 1.6e9] {
            let header = format!("{name},{}\n", ABCD.join(","));
            let text = header
                + &rows(3000, |row| {
                    format!("{:.digits$},{}", start + step * row as f64, samples(row, 4, ","))
                });
            let summary = read_unasked(&text).unwrap();
            assert_eq!(summary.channels, ABCD, "{name} from {start}");
            let error = (summary.sample_rate_hz / rate_hz - 1.0).abs();
            assert!(error < 1e-3, "{name} from {start}: {} Hz", summary.sample_rate_hz);
            assert_eq!((summary.samples, &summary.notices[..]), (3000, &[][..]), "{name} from {start}");
        }
    }
}

#[test]
fn a_rate_that_is_given_must_be_that_of_the_column_of_time() {
    let text = "Time,a,b,c,d\n".to_owned()
        + &rows(100, |row| format!("{:.3},{}", row as f64 / 1000.0, samples(row, 4, ",")));
    let (_folder, path) = file("emg.csv", &text);
    let settings = |hz| RecordingSettings {
        channels: first_muscles(&path, 4, None).unwrap(),
        sample_rate_hz: Some(hz),
        ..RecordingSettings::default()
    };
    let refused = check(&path, &settings(2000.0)).unwrap_err().to_string();
    assert!(refused.contains("sampled at 1000 Hz") && refused.contains("= 2000"), "{refused}");
    assert_eq!(check(&path, &settings(1001.0)).unwrap().sample_rate_hz, 1001.0);
    // A column that rises by 1 may be ms, or count rows: what is given decides.
    let text = "Time,a,b,c,d\n".to_owned() + &rows(100, |row| format!("{row},{}", samples(row, 4, ",")));
    std::fs::write(&path, text).unwrap();
    let given = check(&path, &settings(2000.0)).unwrap();
    assert_eq!((given.sample_rate_hz, given.notices.len()), (2000.0, 0));
    let own = check(&path, &RecordingSettings { sample_rate_hz: None, ..settings(0.0) }).unwrap();
    assert_eq!(own.sample_rate_hz, 1000.0);
    assert!(own.notices[0].to_string().contains("taken as ms"), "{}", own.notices[0]);
}

#[test]
fn what_the_programs_of_amplifiers_export_is_read() {
    let trigno = (1..=4).fold(String::new(), |mut text, channel| {
        writeln!(text, "Label: EMG{channel}  Sampling frequency: 1925.926 Unit: V  Domain: Time").unwrap();
        text
    });
    let pairs = |row: usize, time: f64, separator: &str| {
        let cells = (0..4).map(|channel| format!("{time:.6}{separator}{:.9}", emg(row, channel) * 1e-6));
        cells.collect::<Vec<_>>().join(separator)
    };
    let trigno = trigno
        + "\nX[s],EMG1,X[s],EMG2,X[s],EMG3,X[s],EMG4\n"
        + &rows(3000, |row| pairs(row, row as f64 / 1925.926, ","));
    let notices = assert_read(&trigno, ["EMG1", "EMG2", "EMG3", "EMG4"], 1925.926, 3000, "V");
    assert_eq!(notices, []);

    let head = "%OpenBCI Raw EXG Data\n%Number of channels = 4\n%Sample Rate = 250 Hz\n%Board = OpenBCI_GUI$BoardGanglion\n\
                Sample Index, EXG Channel 0, EXG Channel 1, EXG Channel 2, EXG Channel 3, Accel Channel 0, Other, Timestamp, \
                Timestamp (Formatted)\n";
    let names = ["EXG Channel 0", "EXG Channel 1", "EXG Channel 2", "EXG Channel 3"];
    let row = |index: usize, row: usize, time: f64| {
        let samples = samples(row, 4, ", ");
        format!(
            "{:.1}, {samples}, 0.008, 0.0, {time:.6}, 2023-01-01 12:00:{:02}.5",
            index % 256,
            row / 250 % 60
        )
    };
    let steady = head.to_owned() + &rows(2000, |index| row(index, index, 1.6e9 + index as f64 / 250.0));
    assert_eq!(assert_read(&steady, names, 250.0, 2000, ""), []);
    // In bursts of 25, and 3 packets lost at the beginning of the sixth run of the counter.
    let bursts = head.to_owned()
        + &rows(2000, |index| {
            row(index + if index < 1283 { 0 } else { 3 }, index, 1.6e9 + (index / 25) as f64 / 10.0)
        });
    let notices = assert_read(&bursts, names, 250.0, 2000, "");
    assert!(matches!(&notices[0], Notice::Time { .. }), "{notices:?}");
    assert!(matches!(notices[1], Notice::Gaps { gaps: 1, samples: 3, line: 1289, .. }), "{notices:?}");

    let units = "EMG1,EMG2,EMG3,EMG4\nmV,mV,mV,mV\n".to_owned() + &rows(50, |row| samples(row, 4, ","));
    let (_folder, path) = file("emg.csv", &units);
    let channels = first_muscles(&path, 4, None).unwrap();
    let summary = check(
        &path,
        &RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() },
    );
    assert_eq!(summary.unwrap().unit, "mV");
}

#[test]
fn heads_of_trigno_discover_and_emgworks_are_read() {
    // The accelerometer is slower: its columns end early.
    let discover = "Application:,Trigno Discover (1.6.0),,,,,,,,\nDate/Time:,1/2/2024 10:00:00 AM,,,,,,,,\n\
                    Collection Length (seconds):,1.2,,,,,,,,\n\
                    Avanti Sensor 1 (75923),,,,Avanti Sensor 2 (75924),,Avanti Sensor 3 (75925),,Avanti Sensor 4 (75926),\n\
                    sensor mode: 40,,,,sensor mode: 40,,sensor mode: 40,,sensor mode: 40,\n\
                    EMG 1 Time Series (s),EMG 1 (mV),ACC X Time Series (s),ACC X (G),EMG 2 Time Series (s),EMG 2 (mV),\
                    EMG 3 Time Series (s),EMG 3 (mV),EMG 4 Time Series (s),EMG 4 (mV)\n\
                    1259.2593 Hz,,148.1481 Hz,,1259.2593 Hz,,1259.2593 Hz,,1259.2593 Hz,\n"
        .to_owned()
        + &rows(1500, |row| {
            let time = row as f64 / 1259.2593;
            let pair = |channel: usize| format!("{time:.8},{:.6}", emg(row, channel));
            let acc = row < 176;
            let acc = if acc { format!("{:.8},{:.4}", row as f64 / 148.1481, emg(row, 9)) } else { ",".to_owned() };
            format!("{},{acc},{},{},{}", pair(0), pair(1), pair(2), pair(3))
        });
    let names = ["EMG 1", "EMG 2", "EMG 3", "EMG 4"];
    assert_eq!(assert_read(&discover, names, 1259.2593, 1500, "mV"), []);

    let works = "Trial;Sensors 4\nLength;1,5\nX[s];L Flexor: EMG 1 [V];Extensor: EMG 2 [V];a: EMG 3 [V];b: EMG 4 [V]\n"
        .to_owned()
        + &rows(1500, |row| {
            format!("{:.6};{}", row as f64 / 2000.0, samples(row, 4, ";")).replace('.', ",")
        });
    let names = ["L Flexor: EMG 1", "Extensor: EMG 2", "a: EMG 3", "b: EMG 4"];
    assert_eq!(assert_read(&works, names, 2000.0, 1500, "V"), []);

    let demo = "(1)Avanti,(1)Avanti,(2)Avanti,(2)Avanti\nEMG 1 (1925.926),EMG 2 (1925.926),EMG 3 (1925.926),EMG 4 (1925.926)\n"
        .to_owned()
        + &rows(50, |row| samples(row, 4, ","));
    let names = ["EMG 1 (1925.926)", "EMG 2 (1925.926)", "EMG 3 (1925.926)", "EMG 4 (1925.926)"];
    assert_read(&demo, names, 1925.926, 50, "");
}

#[test]
fn heads_as_people_write_them_are_read() {
    let table = rows(200, |row| format!("{:.3},{}", row as f64 / 1000.0, samples(row, 4, ",")));
    for head in [
        "sep=,\ntime,EMG_a,EMG_b,EMG_c,EMG_d\n",
        "# recorded by hand\n# t,EMG_a,EMG_b,EMG_c,EMG_d\n",
        "Subject,3\nSampling rate (Hz),1000\n\ntime,EMG_a,EMG_b,EMG_c,EMG_d\ns,mV,mV,mV,mV\n",
        "\"time,EMG_a,EMG_b,EMG_c,EMG_d\"\n",
        "\"time\",\"EMG_a\",\"EMG_b\",\"EMG_c\",\"EMG_d\"\n",
        "8\ntime\tEMG_a\tEMG_b\tEMG_c\tEMG_d\n",
        "\u{feff}time,EMG_a,EMG_b,EMG_c,EMG_d,,\n",
    ] {
        let summary =
            read_unasked(&(head.to_owned() + &table)).unwrap_or_else(|error| panic!("{head:?}: {error}"));
        assert_eq!((summary.channels, summary.samples), (ABCD.map(String::from).to_vec(), 200), "{head:?}");
        assert_eq!(summary.sample_rate_hz, 1000.0, "{head:?}");
    }
    // The column of the rows' numbers has no name.
    let indexed =
        "EMG_a EMG_b EMG_c EMG_d\n".to_owned() + &rows(200, |row| format!("{row} {}", samples(row, 4, " ")));
    let (_folder, path) = file("emg.txt", &indexed);
    assert_eq!(first_muscles(&path, 4, None).unwrap(), ABCD.map(Channel::from));
}

#[test]
fn heads_of_opensignals_acqknowledge_labchart_and_noraxon_are_read() {
    let open_signals = "# OpenSignals Text File Format. Version 1\n# {\"20:17\": {\"sensor\": [\"EMG\", \"EMG\", \"EMG\", \"EMG\"], \
        \"column\": [\"nSeq\", \"I1\", \"I2\", \"O1\", \"O2\", \"A1\", \"A2\", \"A3\", \"A4\"], \"sync interval\": 2, \
        \"sampling rate\": 1000, \"resolution\": [4, 1, 1, 1, 1, 10, 10, 10, 10]}}\n# EndOfHeader\n"
        .to_owned()
        + &rows(500, |row| format!("{}\t1\t1\t0\t0\t{}\t", row % 16, samples(row, 4, "\t")));
    assert_eq!(assert_read(&open_signals, ["A1", "A2", "A3", "A4"], 1000.0, 500, ""), []);

    // Below the names: how many samples each channel has.
    let biopac = "emg.acq\n0.5 msec/sample\n4 channels\nmsec,CH1,CH2,CH3,CH4\n,500,500,500,500\n".to_owned()
        + &rows(500, |row| format!("{},{},", row as f64 / 2.0, samples(row, 4, ",")));
    assert_eq!(assert_read(&biopac, ["CH1", "CH2", "CH3", "CH4"], 2000.0, 500, ""), []);

    let lab_chart = "Interval=\t0.0005 s\nTimeFormat=\tStartOfBlock\nChannelTitle=\tEMG1\tEMG2\tEMG3\tEMG4\n\
        Range=\t10.000 mV\t10.000 mV\t10.000 mV\t10.000 mV\n"
        .to_owned()
        + &rows(500, |row| format!("{:.4}\t{}", row as f64 / 2000.0, samples(row, 4, "\t")));
    assert_eq!(assert_read(&lab_chart, ["EMG1", "EMG2", "EMG3", "EMG4"], 2000.0, 500, "mV"), []);

    let muscles = ["LT BICEPS BR.,uV", "RT BICEPS BR.,uV", "LT TRICEPS,uV", "RT TRICEPS,uV"];
    let noraxon = format!("\"time,s\",Activity,\"{}\"\n", muscles.join("\",\""))
        + &rows(500, |row| format!("{:.4},,{}", row as f64 / 2000.0, samples(row, 4, ",")));
    let named = muscles.map(|muscle| muscle.trim_end_matches(",uV"));
    assert_eq!(assert_read(&noraxon, named, 2000.0, 500, "uV"), []);

    // pandas numbers columns without names.
    let pandas =
        "time,0,1,2,3\n".replace("time", "") + &rows(500, |row| format!("{row},{}", samples(row, 4, ",")));
    let (_folder, path) = file("emg.csv", &pandas);
    assert_eq!(first_muscles(&path, 4, None).unwrap(), [1, 2, 3, 4].map(Channel::Index));
    let settings = RecordingSettings {
        channels: vec![Channel::Index(1)],
        sample_rate_hz: Some(1000.0),
        ..RecordingSettings::default()
    };
    assert_eq!(check(&path, &settings).unwrap().samples, 500);
}

#[test]
fn times_of_day_are_a_clock_and_one_that_cannot_be_read_hides_none() {
    let time = |row: usize| row as f64 / 2000.0;
    let header = format!("time,{}\n", ABCD.join(","));
    let day = header.clone()
        + &rows(500, |row| format!("2024-03-01T10:00:{:09.6},{}", time(row), samples(row, 4, ",")));
    assert_eq!(assert_read(&day, ABCD, 2000.0, 500, ""), []);
    let clock = header + &rows(500, |row| format!("00:00:{:09.6},{}", time(row), samples(row, 4, ",")));
    assert_eq!(assert_read(&clock, ABCD, 2000.0, 500, ""), []);
    let both = format!("timestamp,datetime,{}\n", ABCD.join(","))
        + &rows(500, |row| format!("{:.4},1 March,{}", time(row), samples(row, 4, ",")));
    assert_eq!(assert_read(&both, ABCD, 2000.0, 500, ""), []);
}

#[test]
fn rates_that_cannot_be_taken_are_named_where_nothing_else_tells() {
    let text =
        "Sampling rate: 2 Hz\nEMG_a,EMG_b,EMG_c,EMG_d\n".to_owned() + &rows(100, |row| samples(row, 4, ","));
    let refused = read_unasked(&text).unwrap_err().to_string();
    assert!(refused.contains("states 2 Hz") && refused.contains("give sample_rate_hz"), "{refused}");
}

#[test]
fn what_holds_no_number_is_said_with_what_stands_there() {
    let comments = "# a word\n".repeat(1100) + &rows(50, |row| samples(row, 4, ","));
    for (text, place, words) in [
        ("a,b,c,d\n".to_owned() + &"NaN,NaN,NaN,NaN\n".repeat(50), "line 51", "`NaN,NaN"),
        ("a,b,c,d\n".to_owned() + &"0x10,0x20,0x03,0x04\n".repeat(50), "line 51", "`0x10,0x20"),
        (comments, "line 1001", "`# a word`"),
    ] {
        let refused = read_unasked(&text).unwrap_err().to_string();
        assert!(refused.contains(place) && refused.contains(words), "{refused}");
    }
}

#[test]
fn names_in_latin_1_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("emg.csv");
    let text = "f\u{fc}r (\u{b5}V);b;c;d\n".to_owned() + &rows(50, |row| samples(row, 4, ";"));
    std::fs::write(&path, text.chars().map(|character| character as u8).collect::<Vec<u8>>()).unwrap();
    let channels = first_muscles(&path, 1, None).unwrap();
    let settings =
        RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() };
    let summary = check(&path, &settings).unwrap();
    assert_eq!((summary.channels, summary.unit.as_str()), (vec!["f\u{fc}r".to_owned()], "\u{b5}V"));
}

#[test]
fn columns_of_different_units_are_brought_to_that_of_the_first() {
    let text = "a (mV),b (uV),c [V],d (mV)\n".to_owned()
        + &rows(50, |row| {
            let value = emg(row, 0);
            format!("{value},{},{},{value}", value * 1e3, value * 1e-3)
        });
    let (_folder, path) = file("emg.csv", &text);
    let channels = first_muscles(&path, 4, None).unwrap();
    let settings =
        RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() };
    let summary = check(&path, &settings).unwrap();
    assert_eq!(summary.unit, "mV");
    assert!(summary.notices[0].to_string().contains("all are converted to mV"), "{}", summary.notices[0]);
    let mut stream = ReplayStream::open(&path, &settings, 1000.0, 10).unwrap();
    let mut block = [0.0; 40];
    stream.next_block(&mut block).unwrap().unwrap();
    // Channel by channel.
    for (at, sample) in block.iter().enumerate() {
        let expected = emg(at % 10, 0);
        assert!((f64::from(*sample) - expected).abs() < 1e-4, "{at}: {sample}, {expected}");
    }
}

#[test]
fn a_long_silence_is_named_with_its_place() {
    let jump_s = |row: usize| if row < 500 { 0.0 } else { 86_400.0 };
    let text = format!("time,{}\n", ABCD.join(","))
        + &rows(1000, |row| format!("{:.3},{}", row as f64 / 1000.0 + jump_s(row), samples(row, 4, ",")));
    let notices = read_unasked(&text).unwrap().notices;
    let [Notice::Gaps { .. }, silence @ Notice::Silence { .. }] = &notices[..] else { panic!("{notices:?}") };
    let said = silence.to_string();
    assert!(said.contains("after 0.5 s of samples, 86400 s are missing"), "{said}");
    assert!(said.contains("silent for 10 s of them"), "{said}");
}

#[test]
fn a_gap_in_time_and_missing_cells_are_gaps_that_no_block_spans() {
    let row = |row: usize| {
        let samples = samples(row, 4, ",");
        let samples =
            if row == 300 { format!("NaN{}", &samples[samples.find(',').unwrap()..]) } else { samples };
        format!("{:.4},{samples}\n", row as f64 / 1000.0)
    };
    let present = (0..1000).filter(|row| !(600..700).contains(row));
    let text = format!("Time,{}\n", ABCD.join(",")) + &present.map(row).collect::<String>();
    let (_folder, path) = file("emg.csv", &text);
    let channels = first_muscles(&path, 4, None).unwrap();
    let settings = RecordingSettings { channels, ..RecordingSettings::default() };
    let summary = check(&path, &settings).unwrap();
    assert_eq!(summary.samples, 899);
    assert_eq!(
        summary.notices,
        [
            Notice::Gaps { file: path.clone(), gaps: 1, samples: 100, line: 602 },
            Notice::MissingSamples { file: path.clone(), lines: 1, line: 302 },
        ]
    );
    let mut stream = ReplayStream::open(&path, &settings, 1000.0, 7).unwrap();
    let mut block = [0.0; 28];
    let mut starts = Vec::new();
    while let Some(read) = stream.next_block(&mut block).unwrap() {
        starts.push(read.first_sample as usize);
        for (at, sample) in (read.first_sample as usize..).zip(&block[..7]) {
            assert!((f64::from(*sample) - emg(at, 0)).abs() < 1e-4, "sample {at}");
        }
    }
    let begins_anew = |start: &usize| starts.contains(start);
    assert!([0, 301, 700].iter().all(begins_anew), "{starts:?}");
}

#[test]
fn a_column_that_is_no_muscle_is_taken_only_when_asked_for_and_then_with_a_word() {
    let text = "t_s,ch1,ch2,ch3,ch4,gesture\n".to_owned()
        + &rows(500, |row| {
            let gesture = if row < 300 { "rest" } else { "grip" };
            format!("{:.3},{},{gesture}", row as f64 / 1000.0, samples(row, 4, ","))
        });
    let notices = assert_read(&text, ["ch1", "ch2", "ch3", "ch4"], 1000.0, 500, "");
    assert!(matches!(&notices[..], [Notice::Labels { column, .. }] if column == "gesture"), "{notices:?}");
    let (_folder, path) = file("emg.csv", &text);
    let channels = [0, 1].map(Channel::Index).to_vec();
    let settings =
        RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() };
    let summary = check(&path, &settings).unwrap();
    assert_eq!(summary.channels, ["t_s", "ch1"]);
    let expected = Notice::NoMuscle { file: path.clone(), columns: vec![("t_s".into(), ColumnKind::Time)] };
    assert_eq!(summary.notices[0], expected);
    let cues: Vec<_> = summary.cues.iter().map(|span| (span.segment.cue, span.samples)).collect();
    assert_eq!(cues, [(Some(Gesture::REST), 300), (Some(Gesture::GRIP), 200)]);
    let refused = first_muscles(&path, 5, None).unwrap_err().to_string();
    assert!(refused.contains("4 columns look like them") && refused.contains("gesture: labels"), "{refused}");
}

#[test]
fn what_is_named_like_a_muscle_and_rises_like_time_is_refused() {
    let text = "EMG1,EMG2,EMG3,EMG4\n".to_owned()
        + &rows(500, |row| format!("{:.3},{}", row as f64 / 1000.0, samples(row, 3, ",")));
    let refused = read_unasked(&text).unwrap_err().to_string();
    assert!(refused.contains("`EMG1` is named like a muscle, but rises evenly"), "{refused}");
}

#[test]
fn any_column_says_what_was_done_if_asked_and_is_then_no_muscle() {
    let state = |row: usize| ["0", "3", "", "0"][row / 200];
    let text = "EMG_a,EMG_b,state,EMG_c,EMG_d\n".to_owned()
        + &rows(800, |row| format!("{},{},{}", samples(row, 2, ","), state(row), samples(row + 7, 2, ",")));
    let (folder, path) = file("emg.csv", &text);
    for column in [Channel::from("state"), Channel::from(2)] {
        let channels = first_muscles(&path, 4, Some(&column)).unwrap();
        assert_eq!(channels, ABCD.map(Channel::from));
        let settings = RecordingSettings {
            channels,
            sample_rate_hz: Some(1000.0),
            label_column: Some(column),
            ..RecordingSettings::default()
        };
        let source = RecordingSource::open(&path, &settings).unwrap();
        let trials = source.segments().iter().map(|part| (part.end_sample, part.repetition, part.cue));
        let gesture: Gesture = "gesture-3".parse().unwrap();
        let expected = [
            (Some(200), Some(0), Some(Gesture::REST)),
            (Some(400), Some(0), Some(gesture)),
            (Some(600), None, None),
            (None, Some(1), Some(Gesture::REST)),
        ];
        assert_eq!(trials.collect::<Vec<_>>(), expected);
    }
    let refused = |path: &Path, label_column: &str| {
        let settings = RecordingSettings {
            channels: vec![0.into()],
            sample_rate_hz: Some(1000.0),
            label_column: Some(label_column.into()),
            ..RecordingSettings::default()
        };
        RecordingSource::open(path, &settings).unwrap_err().to_string()
    };
    assert!(refused(&path, "States").contains("no channel named `States`: choose among EMG_a"));
    assert!(refused(&path, "EMG_b").contains("column `EMG_b` names no gesture"));
    let three_dc = folder.path().join("3dc_EMG_gesture_0_1.txt");
    std::fs::write(&three_dc, "1,2,3\n").unwrap();
    assert!(refused(&three_dc, "state").contains("has cues of its own: leave out label_column"));
    let edf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/delsys.bdf");
    assert!(refused(&edf, "state").contains("has cues of its own"));
}

#[test]
fn labels_that_are_no_gesture_are_counted_and_named() {
    let labels = ["rest", "😀", "Grip 50%", "-1", "😀", "rest"];
    let text = "EMG_a,EMG_b,EMG_c,EMG_d,gesture\n".to_owned()
        + &rows(600, |row| format!("{},{}", samples(row, 4, ","), labels[row / 100]));
    let (_folder, path) = file("emg.csv", &text);
    let settings = RecordingSettings {
        channels: ABCD.map(Channel::from).to_vec(),
        sample_rate_hz: Some(1000.0),
        ..RecordingSettings::default()
    };
    let summary = check(&path, &settings).unwrap();
    let cues: Vec<_> = summary.cues.iter().filter_map(|span| span.segment.cue).collect();
    assert_eq!(cues.iter().map(Gesture::name).collect::<Vec<_>>(), ["rest", "grip_50", "rest"]);
    let said = summary.notices.last().unwrap().to_string();
    assert!(said.contains("left out of column `gesture`: 1 trial of `-1`, 2 trials of `😀`: "), "{said}");
}

#[test]
fn lines_with_more_cells_than_there_are_names_are_refused() {
    let refused = |text: &str| {
        let (_folder, path) = file("emg.csv", text);
        first_muscles(&path, 2, None).unwrap_err().to_string()
    };
    let names = "EMG 1,EMG 2,EMG 3,EMG 4\n";
    let with_commas = rows(100, |row| samples(row, 4, ",").replace('.', ","));
    let said = refused(&format!("{names}{with_commas}"));
    assert!(
        said.contains("line 2, column 5: this line has 8 values, but the line above it names only 4 columns"),
        "{said}"
    );
    assert!(said.contains("between values with decimal commas take ; or tabs"), "{said}");
    let said = refused(&format!("a note\n{names}mV,mV,mV,mV\n{with_commas}"));
    assert!(said.contains("line 4, column 5: this line has 8 values"), "{said}");
    // As many words between blanks as there are cells are no names.
    let said = refused(
        &("Time (s),EMG 1 (mV)\n".to_owned() + &rows(100, |row| samples(row, 4, ",").replace('.', ""))),
    );
    assert!(said.contains("line 2, column 3: this line has 4 values"), "{said}");
    // An unnamed first column that numbers the rows, cells that are empty throughout, and lines that name no columns.
    let plain = |before: &str, index: bool, end: &str| {
        let row = |row: usize| {
            let index = if index { format!("{row},") } else { String::new() };
            format!("{index}{}{end}", samples(row, 4, ","))
        };
        let (_folder, path) = file("emg.csv", &(before.to_owned() + &rows(100, row)));
        first_muscles(&path, 4, None).unwrap()
    };
    let by_name = ["EMG 1", "EMG 2", "EMG 3", "EMG 4"].map(Channel::from);
    let by_number = [0, 1, 2, 3].map(Channel::Index);
    assert_eq!(plain(names, true, ""), by_name);
    assert_eq!(plain(names, false, ","), by_name);
    assert_eq!(plain(names, false, ",,"), by_number);
    for before in ["recorded\n", "# Anna, Monday\n", "Subject:,Anna\n"] {
        assert_eq!(plain(before, false, ""), by_number, "{before}");
    }
}

#[test]
fn line_ends_of_old_macs_are_named() {
    for rows_of_file in [100, 60_000] {
        let text = format!("{}\n{}", ABCD.join(","), rows(rows_of_file, |row| samples(row, 4, ",")));
        let (_folder, path) = file("emg.csv", &text.replace('\n', "\r"));
        let said = first_muscles(&path, 4, None).unwrap_err().to_string();
        assert!(said.contains("line 1, column 1: its lines end with a carriage return (CR) alone"), "{said}");
    }
}

#[test]
fn columns_of_different_rates_are_not_read_together() {
    let text = "EMG 1 (2148.148),EMG 2 (1925.926)\n".to_owned() + &rows(50, |row| samples(row, 2, ","));
    let (_folder, path) = file("emg.csv", &text);
    let channels = [0, 1].map(Channel::Index).to_vec();
    let settings = RecordingSettings { channels, ..RecordingSettings::default() };
    let refused = check(&path, &settings).unwrap_err().to_string();
    assert!(refused.contains("2148.148 Hz") && refused.contains("1925.926 Hz"), "{refused}");
}

#[test]
fn a_channel_that_never_changes_is_named_at_any_value() {
    for value in ["0", "2000", "-8192.5"] {
        let text =
            rows(500, |row| format!("{},{value},{},{value}", samples(row, 2, ","), samples(row, 1, ",")));
        let (_folder, path) = file("emg.csv", &text);
        let notice_of = |channels: std::ops::Range<usize>| {
            let channels = channels.map(Channel::Index).collect();
            let settings =
                RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() };
            let notices = check(&path, &settings).unwrap().notices;
            notices.last().unwrap().to_string()
        };
        let (one, two) = (notice_of(0..4), notice_of(0..5));
        assert!(
            one.ends_with(&format!("channel 2 was constant ({value}): is its electrode connected?")),
            "{one}"
        );
        assert!(two.contains(&format!("channels 2 ({value}), 4 ({value}) were constant: are")), "{two}");
    }
}

#[test]
fn notices_are_summed_up_by_their_kind() {
    let missing = |name: &str| Notice::MissingFile { file: name.into() };
    let labels = Notice::Labels { file: "emg.csv".into(), column: "gesture".into() };
    assert_eq!(
        summed_up(&[missing("a"), labels, missing("b"), missing("c")]),
        [
            "a is missing: the recording jumps there (and 2 more notices of this kind)",
            "emg.csv: column `gesture` says which gestures were made",
        ]
    );
    assert!(summed_up(&[]).is_empty());
}

#[test]
fn a_column_without_any_sample_is_refused() {
    let text = rows(50, |row| format!("{},", samples(row, 1, ",")));
    let (_folder, path) = file("emg.csv", &text);
    let settings = RecordingSettings {
        channels: [0, 1].map(Channel::Index).to_vec(),
        sample_rate_hz: Some(1000.0),
        ..RecordingSettings::default()
    };
    let refused = check(&path, &settings).unwrap_err();
    assert!(matches!(refused, RecordingError::NoSamples { .. }), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn a_column_of_time_is_never_taken_whatever_its_name_unit_and_rate(
        name in prop::sample::select(vec!["", "Time", "timestamp", "t", "x", "a", "column 1", "EMG time"]),
        place in 0_usize..5,
        rate_hz in 100.0_f64..5000.0,
        (unit_s, digits) in prop::sample::select(vec![(1.0, 6_usize), (1e-3, 3), (1e-6, 0), (1e-9, 0)]),
        start in prop::sample::select(vec![0.0, 12.0, 1.6e9]),
        separator in prop::sample::select(vec![",", ";", "\t"]),
        has_header: bool,
    ) {
        let line = |time: String, others: Vec<String>| {
            let mut cells = others;
            cells.insert(place, time);
            cells.join(separator) + "\n"
        };
        let mut text = String::new();
        if has_header {
            text += &line(name.to_owned(), ABCD.map(String::from).to_vec());
        }
        for row in 0..400 {
            let time = (start + row as f64 / rate_hz) / unit_s;
            let others = (0..4).map(|channel| format!("{:.4}", emg(row, channel))).collect();
            text += &line(format!("{time:.digits$}"), others);
        }
        let (_folder, path) = file("emg.csv", &text);
        let chosen = first_muscles(&path, 4, None).unwrap();
        let expected: Vec<Channel> = if has_header {
            ABCD.map(Channel::from).to_vec()
        } else {
            (0..5).filter(|column| *column != place).map(Channel::Index).collect()
        };
        prop_assert_eq!(&chosen, &expected);
        let summary = check(&path, &RecordingSettings { channels: chosen, ..RecordingSettings::default() }).unwrap();
        prop_assert!((summary.sample_rate_hz / rate_hz - 1.0).abs() < 0.01, "{} Hz", summary.sample_rate_hz);
        prop_assert_eq!(summary.samples, 400);
    }
}
