//! What the columns of a table are: muscles, or something that must not be taken for one.
//!
//! ```text
//! name         t_s     EMG 1    flexor    ACC X       gesture
//! by name      time    muscle   ?         auxiliary   label
//! by shape     rises            wiggles
//! kind         time    muscle   muscle    auxiliary   label
//! ```
//! The name decides where it says something, and the shape of the values where it does not. Names that may mean anything,
//! such as `t` or `index`, count only with a shape that fits.

use std::fmt;

use super::cells::number;
use super::quantity::in_brackets;

/// Rows from which a shape says something.
const ROWS_OF_A_SHAPE: usize = 64;

/// What a column of a table is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColumnKind {
    /// A channel of EMG, as far as can be told.
    Muscle,
    /// Its name is that of a muscle, but its values rise evenly, as time does.
    RisingMuscle,
    /// Time, in any unit.
    Time,
    /// A number that counts rows or packets.
    Counter,
    /// What the person did, or other words and marks.
    Label,
    /// Another sensor, or a slower one, whose column ends before the others.
    Auxiliary,
}

impl fmt::Display for ColumnKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            ColumnKind::Muscle => "a muscle",
            ColumnKind::RisingMuscle => "a muscle by its name, but rises evenly, as time does",
            ColumnKind::Time => "time",
            ColumnKind::Counter => "a counter",
            ColumnKind::Label => "labels",
            ColumnKind::Auxiliary => "another sensor",
        })
    }
}

/// A column of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Its name; empty where it has none.
    pub name: String,
    /// The unit that the table states, in its spelling there; empty where it states none.
    pub unit: String,
    /// The sampling rate that the table states in words, Hz.
    pub rate_hz: Option<f64>,
    /// What it is.
    pub kind: ColumnKind,
}

/// How the values of a column go, by some of its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    rows: usize,
    words: usize,
    missing: usize,
    /// Whether the newest row, the last one in the end, had a value.
    ends_missing: bool,
    last: Option<f64>,
    /// Steps from row to row: all, and those that go up, those that go down, and those that go up by 1.
    steps: usize,
    rises: usize,
    falls: usize,
    ones: usize,
    is_whole: bool,
}

impl Default for Shape {
    fn default() -> Shape {
        Shape {
            rows: 0,
            words: 0,
            missing: 0,
            ends_missing: false,
            last: None,
            steps: 0,
            rises: 0,
            falls: 0,
            ones: 0,
            is_whole: true,
        }
    }
}

impl Shape {
    /// Takes the column's cell in the next row. `is_next` says whether the row follows directly on the one before.
    pub(super) fn push(&mut self, cell: &[u8], is_missing: bool, has_comma: bool, is_next: bool) {
        self.rows += 1;
        self.ends_missing = is_missing;
        if is_missing {
            self.missing += 1;
            return;
        }
        let Some(value) = number(cell, has_comma) else {
            self.words += 1;
            return;
        };
        self.is_whole &= value.fract() == 0.0;
        if let Some(last) = self.last.replace(value) {
            let step = value - last;
            self.falls += usize::from(step < 0.0);
            if is_next {
                self.steps += 1;
                self.rises += usize::from(step > 0.0);
                self.ones += usize::from(step == 1.0);
            }
        }
    }

    fn is_words(&self) -> bool {
        2 * self.words > self.rows - self.missing
    }

    /// Rising all along, more than now and then: no muscle does that.
    fn rises(&self) -> bool {
        self.steps >= ROWS_OF_A_SHAPE && self.falls == 0 && 20 * self.rises >= self.steps
    }

    /// Rising by one, and now and then beginning anew.
    fn counts(&self) -> bool {
        self.steps >= ROWS_OF_A_SHAPE && self.is_whole && 10 * self.ones >= 9 * self.steps
    }

    /// Whole numbers that seldom change.
    fn is_of_steps(&self) -> bool {
        let changes = self.rises + self.falls;
        self.steps >= ROWS_OF_A_SHAPE && self.is_whole && changes > 0 && 50 * changes <= self.steps
    }

    /// Nothing but 0, or nothing but 1: an input that nothing is connected to.
    fn is_idle_input(&self) -> bool {
        let is_digital = self.last.is_some_and(|value| value == 0.0 || value == 1.0);
        self.steps >= ROWS_OF_A_SHAPE && self.rises + self.falls == 0 && is_digital
    }

    fn is_empty(&self) -> bool {
        self.rows > 0 && self.missing == self.rows
    }

    /// Whether it ended while the table went on.
    fn ended_early(&self) -> bool {
        self.ends_missing && self.missing < self.rows
    }
}

/// What a column is by its name, its unit and its shape.
pub(super) fn kind_of(name: &str, unit: &str, shape: &Shape) -> ColumnKind {
    let rises = shape.rises() || shape.counts();
    let by_name = kind_by_name(name, unit, rises);
    match by_name {
        _ if shape.is_words() => match by_name {
            Some(ColumnKind::Time) => ColumnKind::Time,
            _ => ColumnKind::Label,
        },
        Some(ColumnKind::Muscle) if rises => ColumnKind::RisingMuscle,
        Some(ColumnKind::Muscle) | None if shape.is_empty() => ColumnKind::Auxiliary,
        Some(ColumnKind::Muscle) | None if shape.ended_early() => ColumnKind::Auxiliary,
        Some(kind) => kind,
        None if shape.is_idle_input() => ColumnKind::Auxiliary,
        None if shape.counts() => ColumnKind::Counter,
        None if shape.rises() => ColumnKind::Time,
        None if shape.is_of_steps() => ColumnKind::Label,
        None => ColumnKind::Muscle,
    }
}

const TIME: [&str; 15] = [
    "time",
    "timestamp",
    "timestamps",
    "timestep",
    "datetime",
    "date",
    "clock",
    "seconds",
    "secs",
    "sec",
    "msec",
    "zeit",
    "tiempo",
    "temps",
    "elapsed",
];
/// Units of time.
const TIME_UNITS: [&str; 10] = ["s", "sec", "seconds", "ms", "msec", "us", "µs", "μs", "ns", "hh:mm:ss"];
/// Beginnings of words for other sensors.
const AUXILIARY: [&str; 28] = [
    "acc",
    "gyr",
    "magnet",
    "imu",
    "quat",
    "euler",
    "pitch",
    "yaw",
    "roll",
    "orientation",
    "analog",
    "digital",
    "batt",
    "temperature",
    "aux",
    "other",
    "force",
    "torque",
    "fsr",
    "angle",
    "pressure",
    "ecg",
    "ekg",
    "eeg",
    "eog",
    "ppg",
    "rssi",
    "glove",
];
/// Whole words that muscles' names begin with, too: temporalis, magnus.
const AUXILIARY_WORDS: [&str; 2] = ["temp", "mag"];
/// Units of other sensors.
const AUXILIARY_UNITS: [&str; 15] =
    ["g", "m/s^2", "m/s²", "deg/s", "dps", "°/s", "rad/s", "deg", "°", "rad", "ut", "µt", "n", "nm", "°c"];
const LABELS: [&str; 26] = [
    "gesture",
    "gestures",
    "label",
    "labels",
    "stimulus",
    "restimulus",
    "class",
    "classes",
    "marker",
    "markers",
    "event",
    "events",
    "trigger",
    "triggers",
    "trial",
    "repetition",
    "rerepetition",
    "cue",
    "target",
    "movement",
    "annotation",
    "condition",
    "subject",
    "person",
    "session",
    "exercise",
];
/// Names that count only where the values count.
const COUNTERS: [&str; 16] = [
    "index", "idx", "sample", "samples", "counter", "count", "frame", "frames", "packet", "packets", "row",
    "id", "no", "nr", "n", "seq",
];
/// Names that are time only where the values rise.
const MAYBE_TIME: [&str; 5] = ["t", "ts", "x", "unix", "epoch"];

/// Names of columns that say what was done, the better ones first.
const TRUTH: [&str; 9] =
    ["gesture", "label", "restimulus", "stimulus", "class", "movement", "cue", "target", "exercise"];

/// How good a name is for the column that says what was done, 0 the best; `None` for any other name.
pub(super) fn truth_rank(name: &str) -> Option<usize> {
    let words = words_of(name);
    let is_truth =
        |truth: &&str| words.iter().any(|word| word == truth || word.strip_suffix('s') == Some(truth));
    TRUTH.iter().position(is_truth)
}

fn kind_by_name(name: &str, unit: &str, rises: bool) -> Option<ColumnKind> {
    let words = words_of(name);
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    let unit = unit.to_lowercase();
    if has(&TIME) || TIME_UNITS.contains(&unit.as_str()) || (rises && has(&MAYBE_TIME)) {
        return Some(ColumnKind::Time);
    }
    let is_auxiliary = words.iter().any(|word| AUXILIARY.iter().any(|beginning| word.starts_with(beginning)));
    if is_auxiliary || has(&AUXILIARY_WORDS) || AUXILIARY_UNITS.contains(&unit.as_str()) {
        return Some(ColumnKind::Auxiliary);
    }
    if has(&LABELS) {
        return Some(ColumnKind::Label);
    }
    if rises && has(&COUNTERS) {
        return Some(ColumnKind::Counter);
    }
    let is_muscle =
        words.iter().any(|word| word.ends_with("emg") || word == "exg" || word.starts_with("emg"));
    let is_voltage = tendon_signal::unit_factor(&unit, "V").is_ok();
    (is_muscle || is_voltage).then_some(ColumnKind::Muscle)
}

/// The unit with which the name of a column of time ends (`t_s`, `time_ms`); empty if it is none.
pub(super) fn unit_of_time(name: &str) -> String {
    words_of(name).pop().filter(|word| TIME_UNITS.contains(&word.as_str())).unwrap_or_default()
}

/// The words of a name in lower case, without what stands in brackets at its end: `SampleIndex`, `sample_index` and
/// `Sample Index [1]` are two words each.
fn words_of(name: &str) -> Vec<String> {
    let name = in_brackets(name).map_or(name, |bracketed| name.trim_end().trim_end_matches(bracketed));
    let mut words = vec![String::new()];
    let mut was_lower = false;
    for character in name.chars() {
        if !character.is_alphabetic() || (character.is_uppercase() && was_lower) {
            words.push(String::new());
        }
        was_lower = character.is_lowercase();
        if character.is_alphabetic() {
            words.last_mut().expect("one word at least").extend(character.to_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(values: impl Iterator<Item = f64>) -> Shape {
        let mut shape = Shape::default();
        for value in values {
            shape.push(value.to_string().as_bytes(), false, false, true);
        }
        shape
    }

    #[test]
    fn what_a_column_is_follows_from_its_name() {
        let wiggles = shape((0..1000).map(|row| f64::from(row * 7919 % 101 - 50)));
        for (name, unit, kind) in [
            ("Time", "", ColumnKind::Time),
            ("timestamp", "", ColumnKind::Time),
            ("X[s]", "s", ColumnKind::Time),
            ("EMG 1 Time Series (s)", "s", ColumnKind::Time),
            ("Timestamp (Formatted)", "", ColumnKind::Time),
            ("EMG 1 (mV)", "mV", ColumnKind::Muscle),
            ("L Trapezius: EMG 1 [V]", "V", ColumnKind::Muscle),
            ("EXG Channel 0", "", ColumnKind::Muscle),
            ("sEMG3", "", ColumnKind::Muscle),
            ("flexor", "", ColumnKind::Muscle),
            ("ch1", "", ColumnKind::Muscle),
            ("index", "", ColumnKind::Muscle),
            ("ACC X (G)", "G", ColumnKind::Auxiliary),
            ("AccX", "", ColumnKind::Auxiliary),
            ("gyro_z", "", ColumnKind::Auxiliary),
            ("Accel Channel 0", "", ColumnKind::Auxiliary),
            ("Analog Channel 1", "", ColumnKind::Auxiliary),
            ("Battery", "", ColumnKind::Auxiliary),
            ("Avanti Sensor 1: Acc 1.X [g]", "g", ColumnKind::Auxiliary),
            ("gesture", "", ColumnKind::Label),
            ("restimulus", "", ColumnKind::Label),
            ("trialNumber", "", ColumnKind::Label),
            ("Marker", "", ColumnKind::Label),
        ] {
            assert_eq!(kind_of(name, unit, &wiggles), kind, "{name}");
        }
    }

    #[test]
    fn what_a_column_is_follows_from_its_shape_where_the_name_says_nothing() {
        let rising = shape((0..1000).map(|row| 12.0 + 0.0005 * f64::from(row)));
        let counting = shape((0..1000).map(|row| f64::from(row % 256)));
        let steps = shape((0..1000).map(|row| f64::from(row / 300 % 2)));
        let constant = shape((0..1000).map(|_| 2000.0));
        for name in ["", "a", "t", "n", "index", "x"] {
            assert_eq!(kind_of(name, "", &constant), ColumnKind::Muscle, "{name}: it is noticed as stuck");
            assert_ne!(kind_of(name, "", &rising), ColumnKind::Muscle, "{name}");
            assert_ne!(kind_of(name, "", &counting), ColumnKind::Muscle, "{name}");
            assert_eq!(kind_of(name, "", &steps), ColumnKind::Label, "{name}");
        }
        assert_eq!(kind_of("t", "", &rising), ColumnKind::Time);
        assert_eq!(kind_of("", "", &counting), ColumnKind::Counter);
        assert_eq!(kind_of("EMG1", "mV", &rising), ColumnKind::RisingMuscle);
        let mut words = Shape::default();
        (0..10).for_each(|_| words.push(b"rest", false, false, true));
        assert_eq!(kind_of("a", "", &words), ColumnKind::Label);
    }
}
