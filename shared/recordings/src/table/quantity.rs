//! Units and sampling rates as the lines before a table write them.

use super::cells::number;

/// Rates that a line before the table may state for all its columns, Hz.
pub(super) const RATES_OF_EMG_HZ: std::ops::RangeInclusive<f64> = 50.0..=100_000.0;

/// `(mV)` and `[mV]` without brackets.
pub(super) fn unbracketed(cell: &str) -> &str {
    let cell = cell.trim();
    let inner = |open: char, close: char| cell.strip_prefix(open).and_then(|cell| cell.strip_suffix(close));
    inner('(', ')').or_else(|| inner('[', ']')).unwrap_or(cell).trim()
}

/// What stands in brackets at the end of a name, the brackets included.
pub(super) fn in_brackets(name: &str) -> Option<&str> {
    let name = name.trim_end();
    let open = match name.chars().last()? {
        ')' => '(',
        ']' => '[',
        _ => return None,
    };
    name.rfind(open).map(|start| &name[start..])
}

/// Units of what sensors measure, in lower case.
const UNITS: [&str; 37] = [
    "v",
    "mv",
    "uv",
    "µv",
    "μv",
    "nv",
    "volt",
    "volts",
    "millivolts",
    "microvolts",
    "s",
    "sec",
    "seconds",
    "ms",
    "us",
    "µs",
    "μs",
    "ns",
    "hz",
    "g",
    "m/s^2",
    "m/s²",
    "deg/s",
    "dps",
    "°/s",
    "rad/s",
    "deg",
    "°",
    "rad",
    "ut",
    "µt",
    "n",
    "nm",
    "°c",
    "counts",
    "adc_counts",
    "a.u.",
];

pub(super) fn is_unit(cell: &str) -> bool {
    let unit = unbracketed(cell).to_lowercase();
    UNITS.contains(&unit.as_str())
}

pub(super) fn is_unit_or_rate(cell: &str) -> bool {
    is_unit(cell)
        || rate_of_cell(cell).is_some()
        || unbracketed(cell) == "-"
        || unit_of_quantity(cell).is_some()
}

/// The unit of a number, which is a period or a range: `0.000794 s`, `10.000 mV`.
pub(super) fn unit_of_quantity(cell: &str) -> Option<&str> {
    let cell = unbracketed(cell);
    let digits = cell.trim_end_matches(|character: char| character.is_alphabetic() || character == ' ');
    let unit = cell[digits.len()..].trim();
    (number(digits.as_bytes(), true).is_some() && is_unit(unit)).then_some(unit)
}

/// The rate in a cell that holds nothing else: `1259.2593 Hz`, or `(1925.926)` behind a name.
pub(super) fn rate_of_cell(cell: &str) -> Option<f64> {
    let text = unbracketed(cell);
    let is_bracketed = text.len() < cell.trim().len();
    let lower = text.to_ascii_lowercase();
    let digits = match lower.strip_suffix("hz") {
        Some(digits) => digits.trim_end(),
        None if is_bracketed && lower.contains('.') => lower.as_str(),
        None => return None,
    };
    number(digits.as_bytes(), true).filter(|hz| is_rate(*hz))
}

pub(super) fn is_rate(hz: f64) -> bool {
    hz.is_finite() && hz > 0.0 && hz < 1e7
}

/// The sampling rate that a line states in words: `Sample Rate = 250 Hz`, `Sampling frequency [1/s]: 2000 Unit: V`. It is the
/// first number with a unit of rates, or else the first one behind the word and its separator.
pub(super) fn stated_rate(line: &str, has_decimal_comma: bool) -> Option<f64> {
    let lower = line.to_ascii_lowercase();
    let sampling = lower.find("sampl")?;
    let text = &lower[sampling..];
    let word = ["rate", "freq"].iter().filter_map(|word| text.find(word).map(|at| at + word.len())).min();
    let separator = word.map(|word| text[word..].find([':', '=']).map_or(word, |at| word + at));
    let mut start = 0;
    let mut brackets = 0;
    while let Some(character) = text[start..].chars().next() {
        match character {
            '[' | '(' => brackets += 1,
            ']' | ')' => brackets -= 1,
            _ => {}
        }
        if !character.is_alphanumeric() {
            start += character.len_utf8();
            continue;
        }
        // A word with digits, such as CH1, is no number.
        let run = &text[start..];
        let is_part = |(at, character): (usize, char)| {
            let is_within = run[at + character.len_utf8()..].starts_with(|next: char| next.is_ascii_digit());
            character.is_ascii_digit() || (matches!(character, '.' | ',') && is_within)
        };
        let digits = run.char_indices().find(|part| !is_part(*part)).map_or(run.len(), |(at, _)| at);
        if digits == 0 {
            start += run.find(|character: char| !character.is_alphanumeric()).unwrap_or(run.len());
            continue;
        }
        let unit = unit_of_rate_hz(run[digits..].trim_start());
        let is_behind = brackets == 0 && separator.is_some_and(|separator| start >= separator);
        if unit.is_some() || is_behind {
            let hz = rate_of_digits(&run[..digits], has_decimal_comma)? * unit.unwrap_or(1.0);
            return Some(hz).filter(|hz| is_rate(*hz));
        }
        start += digits;
    }
    None
}

/// The unit of rates with which a text begins, in Hz.
fn unit_of_rate_hz(text: &str) -> Option<f64> {
    let (factor, text) = match text.strip_prefix('k') {
        Some(rest) => (1000.0, rest),
        None => (1.0, text),
    };
    ["hz", "sps", "s/s", "samples/s", "samples per s"]
        .iter()
        .any(|unit| text.starts_with(unit))
        .then_some(factor)
}

/// The number that digits write, with a decimal comma or with commas between thousands.
fn rate_of_digits(digits: &str, has_decimal_comma: bool) -> Option<f64> {
    let decimal = number(digits.as_bytes(), has_decimal_comma);
    if decimal.is_some_and(|hz| RATES_OF_EMG_HZ.contains(&hz)) {
        return decimal;
    }
    let mut groups = digits.split(',');
    let first = groups.next()?;
    let mut others = groups.clone().peekable();
    let has_thousands = first.len() <= 3 && others.peek().is_some() && others.all(|group| group.len() == 3);
    if has_thousands { digits.replace(',', "").parse().ok() } else { decimal.or_else(|| first.parse().ok()) }
}

/// The unit that a line states in words: `Unit: V`.
pub(super) fn stated_unit(line: &str) -> Option<String> {
    let at = line.to_ascii_lowercase().find("unit")?;
    let after = line[at..].trim_start_matches(|character: char| character.is_ascii_alphabetic());
    let after = after.trim_start_matches([':', '=', ',', ';', ' ', '\t']);
    let unit = after.split([' ', '\t', ',', ';']).next()?;
    is_unit(unit).then(|| unbracketed(unit).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_in_words_is_the_number_that_belongs_to_it() {
        for (line, comma, rate_hz) in [
            ("Sample Rate = 250 Hz", false, Some(250.0)),
            ("%Sample Rate = 250.0 Hz", false, Some(250.0)),
            ("Sampling frequency: 1925.926 Unit: V  Domain: Time", false, Some(1925.926)),
            ("Sampling frequency [1/s]: 2000", false, Some(2000.0)),
            ("Sampling rate CH1 = 2000", false, Some(2000.0)),
            ("Sampling rate: 2,000 Hz", false, Some(2000.0)),
            ("Sampling rate: 2,000 Hz", true, Some(2000.0)),
            ("Samplerate;1259,2593 Hz", true, Some(1259.2593)),
            ("Sampling rate: 2 kSps", false, Some(2000.0)),
            ("Sample rate: 2.5 kHz", false, Some(2500.0)),
            ("Sampling 2000 Hz; low-pass cutoff frequency: 450 Hz", false, Some(2000.0)),
            ("Sampling rate = 2000, filter 20-450 Hz", false, Some(2000.0)),
            ("Sampled 2024-03-01, rate 2000 Hz", false, Some(2000.0)),
            ("Sampling rate (Hz),1000", false, Some(1000.0)),
            ("Sampling rate (1000 Hz)", false, Some(1000.0)),
            ("Sampling rate,1000,500", false, Some(1000.0)),
            ("{\"sync interval\": 2, \"sampling rate\": 1000, \"resolution\": [4, 1]}", false, Some(1000.0)),
            ("Number of samples: 20000", false, None),
            ("Frequency: 2000 Hz", false, None),
            ("Sampling rate CH1", false, None),
        ] {
            assert_eq!(stated_rate(line, comma), rate_hz, "{line}");
        }
    }
}
