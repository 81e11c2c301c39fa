//! Units of samples: an amplifier says one of many spellings, a session wants one.

/// Spellings of the units that are known, in small letters, with the canonical one first, and how many volts each is.
const UNITS: [(&[&str], f64); 4] = [
    (&["V", "v", "volt", "volts"], 1.0),
    (&["mV", "mv", "millivolt", "millivolts"], 1e-3),
    // With the micro sign, the Greek letter, and without either.
    (&["uV", "uv", "\u{b5}v", "\u{3bc}v", "microvolt", "microvolts"], 1e-6),
    (&["nV", "nv", "nanovolt", "nanovolts"], 1e-9),
];

/// Samples cannot be had in the unit of the session.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the samples are in \"{from}\", and the session wants \"{to}\" (acquisition.unit): of these units only V, mV, uV and nV can \
     be converted into one another"
)]
pub struct UnitError {
    /// Unit of the samples.
    pub from: String,
    /// Unit of the session.
    pub to: String,
}

/// The canonical spelling of a unit: `microvolts`, `µV` and `uv` are `uV`; what is not known stays as it is.
pub fn canonical_unit(unit: &str) -> &str {
    let unit = unit.trim();
    known(unit).map_or(unit, |(spellings, _)| spellings[0])
}

/// What samples in the unit `from` are multiplied by to be in the unit `to`.
///
/// # Errors
///
/// [`UnitError`] when they differ and one of them is no known unit of voltage.
pub fn unit_factor(from: &str, to: &str) -> Result<f64, UnitError> {
    if canonical_unit(from) == canonical_unit(to) {
        return Ok(1.0);
    }
    match (known(from), known(to)) {
        (Some((_, from_volts)), Some((_, to_volts))) => Ok(from_volts / to_volts),
        _ => Err(UnitError { from: from.to_owned(), to: to.to_owned() }),
    }
}

fn known(unit: &str) -> Option<(&'static [&'static str], f64)> {
    let unit = unit.trim().to_lowercase();
    UNITS.into_iter().find(|(spellings, _)| spellings[1..].contains(&unit.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_voltage_are_known_by_many_spellings_and_converted() {
        for spelling in ["uV", "\u{b5}V", "\u{3bc}V", "microvolts", "MicroVolt", " uv "] {
            assert_eq!(canonical_unit(spelling), "uV", "{spelling}");
        }
        assert_eq!(canonical_unit("ADC counts"), "ADC counts");
        let factor = |from, to| unit_factor(from, to).unwrap();
        assert!((factor("volts", "mV") - 1e3).abs() < 1e-9);
        assert!((factor("uV", "mV") - 1e-3).abs() < 1e-15);
        assert_eq!(factor("ADC counts", "ADC counts"), 1.0);
    }

    #[test]
    fn other_units_are_refused_by_name() {
        let refusal = unit_factor("ADC counts", "mV").unwrap_err().to_string();
        assert!(refusal.contains("\"ADC counts\"") && refusal.contains("acquisition.unit"), "{refusal}");
        assert!(unit_factor("", "mV").is_err());
    }
}
