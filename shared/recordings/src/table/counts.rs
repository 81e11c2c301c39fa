//! Lines of whole numbers as a converter writes them, without a branch that depends on how long the numbers are.
//!
//! ```text
//! -27,58,70\n34,…    64 bytes
//! 0001001001001…    a bit for each separator or newline: where cells end
//! └─┘               8 bytes as one u64, those behind the cell shifted out: up to seven digits at once
//! ```
//! Lengths of numbers are practically random: a loop over their bytes costs a wrongly predicted branch for nearly every
//! number.

/// Bytes that are searched for ends of cells at once: a bit for each.
const SEARCHED: usize = u64::BITS as usize;

/// Every byte 1: times a byte, that byte in every place.
const ONES: u64 = 0x0101_0101_0101_0101;

/// Reads the line of `text` that begins at `start` into `frame` if every chosen cell is a `-` or nothing and then one
/// to seven digits, and the line has one cell for each of `places` and a newline at its end. Gives where the next
/// line begins; `None` for anything else, whatever it is, and near the end of the text, `frame` then being half
/// written.
#[inline]
pub(super) fn read_line(
    text: &[u8],
    start: usize,
    separator: u8,
    places: &[Option<usize>],
    frame: &mut [f32],
) -> Option<usize> {
    let mut base = start;
    let mut ends = ends_of_cells(text, base, separator)?;
    let mut cell_start = start;
    for (column, place) in places.iter().enumerate() {
        while ends == 0 {
            base += SEARCHED;
            ends = ends_of_cells(text, base, separator)?;
        }
        let cell_end = base + ends.trailing_zeros() as usize;
        ends &= ends - 1;
        let is_last = column + 1 == places.len();
        if text[cell_end] != if is_last { b'\n' } else { separator } {
            return None;
        }
        if let Some(place) = *place {
            let ends_in_return = is_last && text[cell_end - 1] == b'\r';
            frame[place] = count(text, cell_start, cell_end - usize::from(ends_in_return))?;
        }
        cell_start = cell_end + 1;
    }
    Some(cell_start)
}

/// Which of the bytes from `at` on are separators or newlines; the lowest bit is for the first.
#[inline]
fn ends_of_cells(text: &[u8], at: usize, separator: u8) -> Option<u64> {
    let bytes = text.get(at..)?.first_chunk::<SEARCHED>()?;
    let is_end = bytes.map(|byte| u8::from(byte == separator) | u8::from(byte == b'\n'));
    let (eights, _) = is_end.as_chunks::<8>();
    let ends = eights.iter().enumerate().map(|(index, eight)| {
        // Every byte, 0 or 1, moves to a bit of the highest byte.
        u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56 << (8 * index)
    });
    Some(ends.fold(0, |all, ends| all | ends))
}

/// The number that the cell from `start` to `end` writes.
#[inline]
fn count(text: &[u8], start: usize, end: usize) -> Option<f32> {
    let negative = *text.get(start)? == b'-';
    let start = start + usize::from(negative);
    let digits = end.wrapping_sub(start);
    if !(1..=7).contains(&digits) {
        return None;
    }
    // 0 to 9 where a digit is, behind as many zeros as make eight digits.
    let bytes = u64::from_le_bytes(*text.get(start..)?.first_chunk()?);
    let values = (bytes ^ (u64::from(b'0') * ONES)) << (8 * (8 - digits));
    // Adding 0x76 carries into the highest bit from 10 on.
    if (values.wrapping_add(0x76 * ONES) | values) & (0x80 * ONES) != 0 {
        return None;
    }
    // Neighbours joined: to four numbers of two digits, two of four, one of eight.
    let twos = (values.wrapping_mul(10).wrapping_add(values >> 8)) & 0x00ff_00ff_00ff_00ff;
    let fours = (twos.wrapping_mul(100).wrapping_add(twos >> 16)) & 0x0000_ffff_0000_ffff;
    let eights = (fours.wrapping_mul(10_000).wrapping_add(fours >> 32)) & 0xffff_ffff;
    // The sign bit, where an `if` would be one of those branches.
    Some(f32::from_bits((eights as f32).to_bits() | u32::from(negative) << 31))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(text: &[u8], places: &[Option<usize>]) -> Option<(usize, Vec<f32>)> {
        let mut frame = vec![0.0; places.iter().flatten().count()];
        read_line(text, 0, b',', places, &mut frame).map(|next| (next, frame))
    }

    #[test]
    fn lines_of_counts_are_read_and_no_others() {
        let both = [Some(1), Some(0)];
        for (line, expected) in [
            ("-27,58\n", Some((7, vec![58.0, -27.0]))),
            ("0,1234567\r\n", Some((11, vec![1_234_567.0, 0.0]))),
            ("0001234,-0\n", Some((11, vec![-0.0, 1234.0]))),
            ("1,12345678\n", None),
            ("1,2,3\n", None),
            ("1\n2,3\n", None),
            ("1,\n", None),
            ("1,\r\n", None),
            ("1,-\n", None),
            (",1\n", None),
            ("\n", None),
            ("--1,2\n", None),
            ("+1,2\n", None),
            ("1, 2\n", None),
            ("1,2 \n", None),
            ("1,2.5\n", None),
            ("1,2e3\n", None),
            ("1\r,2\n", None),
            ("1,2\r3\n", None),
            ("1,2\u{b2}\n", None),
            ("1,2", None),
            ("", None),
        ] {
            let text = format!("{line}{}", "3,4,5,6\n".repeat(10));
            assert_eq!(read(text.as_bytes(), &both), expected, "{line:?}");
            assert_eq!(read(line.as_bytes(), &both), None, "{line:?} at the end of the text");
        }
        let second = [None, Some(0), None];
        let long = format!(",1,a cell with {} words\n", "many ".repeat(30));
        for line in ["a,1,\n", "NULL,1,c\r\n", &long, "\u{e9}\0,1, \n"] {
            let text = format!("{line}{}", " ".repeat(SEARCHED));
            assert_eq!(read(text.as_bytes(), &second), Some((line.len(), vec![1.0])), "{line:?}");
        }
        assert_eq!(read(&[b"1\n2,3,4\n".as_slice(), &[b' '; 80]].concat(), &second), None);
    }

    proptest! {
        #[test]
        fn a_number_is_what_it_is_in_general(cell in "-?[0-9]{0,8}|[-0-9:/ \u{0}-\u{ff}]{0,8}") {
            let text = format!("{cell}0123456789");
            let is_count = cell.strip_prefix('-').unwrap_or(&cell).bytes().all(|byte| byte.is_ascii_digit());
            let digits = cell.trim_start_matches('-').len();
            let expected = (is_count && digits <= 7).then(|| cell.parse::<f32>().ok()).flatten();
            let read = count(text.as_bytes(), 0, cell.len());
            prop_assert_eq!(read.map(f32::to_bits), expected.map(f32::to_bits));
        }

        #[test]
        fn cells_end_at_separators_and_newlines(text: [u8; SEARCHED], commas: u64) {
            let mut text = text;
            for (place, byte) in text.iter_mut().enumerate() {
                if commas >> place & 1 == 1 {
                    *byte = if place % 3 == 0 { b'\n' } else { b',' };
                }
            }
            let ends = ends_of_cells(&text, 0, b',').unwrap();
            for (place, byte) in text.iter().enumerate() {
                prop_assert_eq!(ends >> place & 1 == 1, b",\n".contains(byte));
            }
        }
    }
}
