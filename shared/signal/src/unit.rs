//! Units of samples: amplifiers, recordings and models spell the same unit in many ways.

/// Spellings of the units that are known: the canonical one, the others in small letters; and how many volts each is. How
/// many volts the numbers of an analogue-to-digital converter are is not known.
const UNITS: [(&str, &[&str], Option<f64>); 5] = [
    ("V", &["v", "volt", "volts"], Some(1.0)),
    ("mV", &["mv", "millivolt", "millivolts"], Some(1e-3)),
    // With the micro sign, the Greek letter, and without either.
    ("uV", &["uv", "\u{b5}v", "\u{3bc}v", "microvolt", "microvolts"], Some(1e-6)),
    ("nV", &["nv", "nanovolt", "nanovolts"], Some(1e-9)),
    ("adc_counts", &["adc_counts", "adc counts", "adc_count", "adc count", "counts"], None),
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

/// The canonical spellings of the units that are known.
pub fn known_units() -> impl Iterator<Item = &'static str> {
    UNITS.into_iter().map(|(canonical, ..)| canonical)
}

/// The canonical spelling of a unit: `microvolts`, `µV` and `uv` are `uV`, `ADC counts` is `adc_counts`; what is not known
/// stays as it is.
pub fn canonical_unit(unit: &str) -> &str {
    let unit = unit.trim();
    known(unit).map_or(unit, |(canonical, _)| canonical)
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
        (Some((_, Some(from_volts))), Some((_, Some(to_volts)))) => Ok(from_volts / to_volts),
        _ => Err(UnitError { from: from.to_owned(), to: to.to_owned() }),
    }
}

/// The name of a channel without the unit with which it ends: `EMG 1 (mV)`, `EMG 1 [mV]` and `EMG 1,mV` are `EMG 1`. One program
/// writes the unit of samples there, another does not.
pub fn without_unit(name: &str) -> &str {
    let name = name.trim();
    let in_brackets =
        |open: char, close: char| name.strip_suffix(close).and_then(|name| name.rsplit_once(open));
    let parts = in_brackets('(', ')').or_else(|| in_brackets('[', ']')).or_else(|| name.rsplit_once(','));
    let named = parts.filter(|(_, unit)| known(unit).is_some()).map(|(name, _)| name.trim_end());
    named.filter(|name| !name.is_empty()).unwrap_or(name)
}

/// Whether these are the names of the same channels in the same order, whatever units stand in them.
pub fn are_same_channels(names: &[String], others: &[String]) -> bool {
    let of = |names: &[String]| names.iter().map(|name| without_unit(name).to_owned()).collect::<Vec<_>>();
    of(names) == of(others)
}

/// The canonical spelling of a unit and how many volts it is, if it is known.
fn known(unit: &str) -> Option<(&'static str, Option<f64>)> {
    let unit = unit.trim().to_lowercase();
    let (canonical, _, volts) =
        UNITS.into_iter().find(|(_, spellings, _)| spellings.contains(&unit.as_str()))?;
    Some((canonical, volts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_known_by_many_spellings_and_voltages_converted() {
        for spelling in ["uV", "\u{b5}V", "\u{3bc}V", "microvolts", "MicroVolt", " uv "] {
            assert_eq!(canonical_unit(spelling), "uV", "{spelling}");
        }
        for spelling in ["ADC counts", "adc_counts", "ADC_Count", "counts"] {
            assert_eq!(canonical_unit(spelling), "adc_counts", "{spelling}");
        }
        assert_eq!(canonical_unit(" furlongs "), "furlongs");
        for unit in known_units() {
            assert_eq!(canonical_unit(unit), unit);
        }
        let factor = |from, to| unit_factor(from, to).unwrap();
        assert!((factor("volts", "mV") - 1e3).abs() < 1e-9);
        assert!((factor("uV", "mV") - 1e-3).abs() < 1e-15);
        assert_eq!(factor("ADC counts", "adc_counts"), 1.0);
    }

    #[test]
    fn the_unit_at_the_end_of_a_name_is_no_part_of_it() {
        for (name, without) in [
            ("EMG 1 (mV)", "EMG 1"),
            ("L Flexor: EMG 1 [\u{b5}V]", "L Flexor: EMG 1"),
            ("LT BICEPS,uV", "LT BICEPS"),
            ("EMG (raw)", "EMG (raw)"),
            ("EMG 1 (2000.0)", "EMG 1 (2000.0)"),
            ("ACC X (G)", "ACC X (G)"),
            ("(mV)", "(mV)"),
            ("mV", "mV"),
            ("flexor", "flexor"),
        ] {
            assert_eq!(without_unit(name), without, "{name}");
        }
        let names = |names: [&str; 2]| names.map(str::to_owned);
        assert!(are_same_channels(&names(["a (mV)", "b (mV)"]), &names(["a", "b (V)"])));
        assert!(!are_same_channels(&names(["a", "b"]), &names(["b", "a"])));
    }

    #[test]
    fn other_units_are_refused_by_name() {
        let refusal = unit_factor("ADC counts", "mV").unwrap_err().to_string();
        assert!(refusal.contains("\"ADC counts\"") && refusal.contains("acquisition.unit"), "{refusal}");
        assert!(unit_factor("", "mV").is_err());
    }
}
