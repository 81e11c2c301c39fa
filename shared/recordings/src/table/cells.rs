//! Lines and cells of a text, and the numbers in them.

use std::borrow::Cow;

/// What ends a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Byte(u8),
    Blanks,
}

impl Separator {
    pub(super) fn of_line(line: &[u8]) -> Separator {
        [b'\t', b';', b',']
            .into_iter()
            .find(|byte| line.contains(byte))
            .map_or(Separator::Blanks, Separator::Byte)
    }
}

/// The cells of one line, without the blanks around them.
pub(super) struct Cells<'line> {
    rest: Option<&'line [u8]>,
    separator: Separator,
}

impl<'line> Cells<'line> {
    pub(super) fn of(line: &'line [u8], separator: Separator) -> Cells<'line> {
        let line = match separator {
            Separator::Byte(_) => line,
            Separator::Blanks => line.trim_ascii(),
        };
        Cells { rest: Some(line), separator }
    }
}

impl<'line> Iterator for Cells<'line> {
    type Item = &'line [u8];

    #[inline]
    fn next(&mut self) -> Option<&'line [u8]> {
        let rest = self.rest?;
        let end = match self.separator {
            Separator::Byte(separator) => rest.iter().position(|&byte| byte == separator),
            Separator::Blanks => rest.iter().position(u8::is_ascii_whitespace),
        };
        let Some(end) = end else {
            self.rest = None;
            return Some(rest.trim_ascii());
        };
        let after = &rest[end + 1..];
        self.rest = Some(match self.separator {
            Separator::Byte(_) => after,
            Separator::Blanks => after.trim_ascii_start(),
        });
        Some(rest[..end].trim_ascii())
    }
}

/// The sample in a cell, `None` where there is no finite number.
#[inline]
pub(super) fn sample(cell: &[u8]) -> Option<f32> {
    // Counts need no general parser here either: up to seven digits are exact in an f32 (below 2^24).
    let (negative, digits) = match cell {
        [b'-', digits @ ..] => (true, digits),
        digits => (false, digits),
    };
    if (1..=7).contains(&digits.len()) && digits.iter().all(u8::is_ascii_digit) {
        let magnitude = digits.iter().fold(0_u32, |sum, digit| sum * 10 + u32::from(digit - b'0')) as f32;
        return Some(if negative { -magnitude } else { magnitude });
    }
    fast_float2::parse::<f32, _>(cell).ok().filter(|value| value.is_finite())
}

/// The number in a cell, with a decimal comma if `has_comma` allows it. Not for every sample: [`sample`] is faster.
pub(super) fn number(cell: &[u8], has_comma: bool) -> Option<f64> {
    let cell = without_quotes(cell);
    if let Ok(number) = fast_float2::parse::<f64, _>(cell) {
        return Some(number);
    }
    with_point(cell, &mut [0; LONGEST_NUMBER])
        .filter(|_| has_comma)
        .and_then(|cell| fast_float2::parse(cell).ok())
}

/// The sample in a cell that has quotes or, if `has_comma` allows it, a decimal comma.
#[cold]
pub(super) fn unusual_sample(cell: &[u8], has_comma: bool) -> Option<f32> {
    number(cell, has_comma).map(|number| number as f32).filter(|value| value.is_finite())
}

/// Bytes of the longest number with a decimal comma.
const LONGEST_NUMBER: usize = 40;

/// A number with a decimal comma, with a point instead; `None` if it has none.
fn with_point<'buffer>(cell: &[u8], buffer: &'buffer mut [u8; LONGEST_NUMBER]) -> Option<&'buffer [u8]> {
    let comma = cell.iter().position(|byte| *byte == b',')?;
    if cell.contains(&b'.') {
        return None;
    }
    let written = buffer.get_mut(..cell.len())?;
    written.copy_from_slice(cell);
    written[comma] = b'.';
    Some(written)
}

/// A cell without the quotes around it.
pub(super) fn without_quotes(cell: &[u8]) -> &[u8] {
    cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).unwrap_or(cell)
}

/// Whether a cell holds no sample: nothing, a word for a missing one, or NaN.
pub(super) fn is_missing(cell: &[u8]) -> bool {
    let cell = without_quotes(cell);
    cell.is_empty() || is_missing_sample(cell) || fast_float2::parse::<f32, _>(cell).is_ok_and(f32::is_nan)
}

/// Whether a cell is a word by which tools write a missing sample.
pub(super) fn is_missing_sample(cell: &[u8]) -> bool {
    ["null", "na", "n/a", "#n/a", "none", "-"].iter().any(|word| cell.eq_ignore_ascii_case(word.as_bytes()))
}

/// Whether bytes are UTF-8 without control characters.
pub(super) fn is_text(line: &[u8]) -> bool {
    std::str::from_utf8(line)
        .is_ok_and(|text| !text.chars().any(|character| character.is_control() && character != '\t'))
}

/// Text in UTF-8, or else in Latin-1, as German and French programs write names and units.
pub(crate) fn text_of(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|byte| char::from(*byte)).collect()),
    }
}

/// A cell as an error message shows it: the first 24 characters.
pub(super) fn excerpt(cell: &[u8]) -> String {
    text_of(cell).chars().take(24).collect()
}

/// One line of a text, without its newline.
pub(super) struct Line<'text> {
    pub(super) content: &'text [u8],
    /// Where the next line starts.
    pub(super) next: usize,
    /// Whether a newline ends it.
    pub(super) terminated: bool,
}

/// The line starting at `start`, `None` at the end of the text.
#[inline]
pub(super) fn line_at(text: &[u8], start: usize) -> Option<Line<'_>> {
    let rest = text.get(start..).filter(|rest| !rest.is_empty())?;
    let (content, next, terminated) = match rest.iter().position(|&byte| byte == b'\n') {
        Some(end) => (&rest[..end], start + end + 1, true),
        None => (rest, text.len(), false),
    };
    Some(Line { content: content.strip_suffix(b"\r").unwrap_or(content), next, terminated })
}

/// Spreadsheet programs write this mark before UTF-8 text.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

pub(super) fn text_start(text: &[u8]) -> usize {
    if text.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 }
}
