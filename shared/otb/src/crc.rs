//! The checksum of the Quattrocento's control word.

/// CRC-8/MAXIM: reflected polynomial 0x8C, begins with 0, no final exclusive or.
pub fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| if crc & 1 == 1 { crc >> 1 ^ 0x8C } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_value_of_crc_8_maxim_is_found() {
        assert_eq!(crc8(b"123456789"), 0xA1);
        assert_eq!(crc8(&[0]), 0);
    }
}
