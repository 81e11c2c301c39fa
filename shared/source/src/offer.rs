//! What an amplifier offers, and what of it the session takes.
//!
//! ```text
//! instants as delivered    c0 c1 c2 c3 aux │ c0 c1 c2 c3 aux │ …       in its units
//!        Choice::take      c2 c0           │ c2 c0           │ …       in the session's, acquisition.unit
//! ```

use tendon_config::AcquisitionSettings;
use tendon_process::SignalDescription;
use tendon_recordings::Channel;
use tendon_signal::{UnitError, canonical_unit, unit_factor, without_unit};

/// Largest difference between the rate of an amplifier and that of the session, as a share: windows and filters are the same then.
const RATE_TOLERANCE: f64 = 1e-3;

/// How many channels a message names.
const NAMES_LISTED: usize = 16;

/// What an amplifier offers.
#[derive(Clone, Debug, PartialEq)]
pub struct Offer {
    /// Its sampling rate, as it says itself, Hz.
    pub sample_rate_hz: f64,
    /// Its channels, in the order in which it delivers them.
    pub channels: Vec<OfferedChannel>,
}

/// A channel of an amplifier.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OfferedChannel {
    /// Its name.
    pub name: String,
    /// Unit of its samples as the amplifier spells it; empty if nobody knows.
    pub unit: String,
    /// Whether it is a muscle's, and not a counter, trigger or another sensor.
    pub is_emg: bool,
}

/// What a session takes of an [`Offer`].
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Channels that the amplifier delivers.
    offered: usize,
    /// Place in the offer of each channel of the session, and what its samples are multiplied by.
    taken: Vec<(usize, f32)>,
    /// The channels by name and their unit, for the line that says ready.
    pub signal: SignalDescription,
}

/// An amplifier does not offer what the session wants.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OfferError {
    /// Another sampling rate.
    #[error(
        "the amplifier samples at {offered_hz} Hz, and acquisition.sample_rate_hz is {wanted_hz}: set the amplifier to it, or \
         add --set acquisition.sample_rate_hz={offered_hz}"
    )]
    Rate {
        /// Of the amplifier, Hz.
        offered_hz: f64,
        /// Of the session, Hz.
        wanted_hz: f64,
    },
    /// Fewer EMG channels than the session has.
    #[error(
        "the amplifier has {}, and acquisition.channels is {wanted}: {}name channels in acquisition.channel_selection",
        emg_channels(*offered, names),
        if *offered > 0 { "set it to what there is, or " } else { "" }
    )]
    TooFew {
        /// EMG channels of the amplifier.
        offered: usize,
        /// Their names.
        names: String,
        /// Channels of the session.
        wanted: usize,
    },
    /// A channel that was asked for is not there.
    #[error("acquisition.channel_selection: the amplifier has no channel {channel}, only {names}")]
    Missing {
        /// The channel.
        channel: String,
        /// Those there are, with their numbers.
        names: String,
    },
    /// A name that several channels have.
    #[error(
        "acquisition.channel_selection: several channels of the amplifier are called {name}: choose by number ({names})"
    )]
    Ambiguous {
        /// The name.
        name: String,
        /// The channels there are, with their numbers.
        names: String,
    },
    /// A channel that was asked for twice.
    #[error("acquisition.channel_selection: {name} is chosen twice")]
    Twice {
        /// The channel.
        name: String,
    },
    /// Channels of several units.
    #[error(
        "{first} is in \"{first_unit}\" and {other} in \"{other_unit}\": say in acquisition.unit to which both are converted"
    )]
    MixedUnits {
        /// A channel.
        first: String,
        /// Its unit.
        first_unit: String,
        /// Another one.
        other: String,
        /// Its unit.
        other_unit: String,
    },
    /// Nobody knows the unit that is to be converted.
    #[error(
        "the amplifier does not say in which unit {channel} is, so it cannot be converted to {wanted} (acquisition.unit): make \
         it say its unit, or leave acquisition.unit out"
    )]
    UnknownUnit {
        /// The channel.
        channel: String,
        /// The unit of the session.
        wanted: String,
    },
    /// A unit that cannot be converted.
    #[error("{channel}: {error}")]
    Unit {
        /// The channel.
        channel: String,
        /// Why not.
        error: UnitError,
    },
}

impl Offer {
    /// What a session with these settings takes.
    ///
    /// # Errors
    ///
    /// [`OfferError`] when the amplifier does not have it.
    pub fn choose(&self, settings: &AcquisitionSettings) -> Result<Choice, OfferError> {
        self.check_rate(settings.sample_rate_hz)?;
        let places = match &settings.channel_selection {
            Some(selection) => self.selected(selection)?,
            None => self.first_of_muscles(settings.channels)?,
        };
        let unit = match &settings.unit {
            Some(unit) => canonical_unit(unit),
            None => self.common_unit(&places)?,
        };
        let taken = places.iter().map(|&place| Ok((place, self.factor(place, unit)?)));
        let taken = taken.collect::<Result<_, OfferError>>()?;
        let channels = places.iter().map(|&place| plain(&self.channels[place].name)).collect();
        let signal = SignalDescription { channels, unit: unit.to_owned() };
        Ok(Choice { offered: self.channels.len(), taken, signal })
    }

    fn check_rate(&self, wanted_hz: f64) -> Result<(), OfferError> {
        let offered_hz = self.sample_rate_hz;
        // Not a number is no rate either.
        if (offered_hz - wanted_hz).abs() <= RATE_TOLERANCE * wanted_hz {
            return Ok(());
        }
        Err(OfferError::Rate { offered_hz, wanted_hz })
    }

    fn first_of_muscles(&self, wanted: usize) -> Result<Vec<usize>, OfferError> {
        let muscles: Vec<usize> =
            (0..self.channels.len()).filter(|&place| self.channels[place].is_emg).collect();
        if muscles.len() >= wanted {
            return Ok(muscles[..wanted].to_vec());
        }
        let names = listed(muscles.iter().map(|&place| self.channels[place].name.clone()));
        Err(OfferError::TooFew { offered: muscles.len(), names, wanted })
    }

    fn selected(&self, selection: &[Channel]) -> Result<Vec<usize>, OfferError> {
        let mut places = Vec::with_capacity(selection.len());
        for channel in selection {
            let place = self.place_of(channel)?;
            if places.contains(&place) {
                return Err(OfferError::Twice { name: self.channels[place].name.clone() });
            }
            places.push(place);
        }
        Ok(places)
    }

    fn place_of(&self, channel: &Channel) -> Result<usize, OfferError> {
        let missing = || OfferError::Missing { channel: channel.to_string(), names: self.numbered_names() };
        match channel {
            Channel::Index(place) if *place < self.channels.len() => Ok(*place),
            Channel::Index(_) => Err(missing()),
            Channel::Name(name) => {
                let mut places = (0..self.channels.len())
                    .filter(|&place| plain(&self.channels[place].name) == plain(name));
                let place = places.next().ok_or_else(missing)?;
                if places.next().is_some() {
                    return Err(OfferError::Ambiguous { name: name.clone(), names: self.numbered_names() });
                }
                Ok(place)
            }
        }
    }

    fn numbered_names(&self) -> String {
        listed(self.channels.iter().enumerate().map(|(place, channel)| format!("{place}: {}", channel.name)))
    }

    /// The one unit of these channels.
    fn common_unit(&self, places: &[usize]) -> Result<&str, OfferError> {
        let unit = |place: usize| canonical_unit(&self.channels[place].unit);
        let Some(&first) = places.first() else { return Ok("") };
        match places.iter().find(|&&place| unit(place) != unit(first)) {
            None => Ok(unit(first)),
            Some(&other) => Err(OfferError::MixedUnits {
                first: self.channels[first].name.clone(),
                first_unit: unit(first).to_owned(),
                other: self.channels[other].name.clone(),
                other_unit: unit(other).to_owned(),
            }),
        }
    }

    fn factor(&self, place: usize, wanted: &str) -> Result<f32, OfferError> {
        let OfferedChannel { name, unit, .. } = &self.channels[place];
        if unit.trim().is_empty() && !wanted.is_empty() {
            return Err(OfferError::UnknownUnit { channel: name.clone(), wanted: wanted.to_owned() });
        }
        let factor = unit_factor(unit, wanted);
        let factor = factor.map_err(|error| OfferError::Unit { channel: name.clone(), error })?;
        Ok(factor as f32)
    }
}

/// The name of a channel as recordings and people have it: without its unit, no number, which would be a place, and nothing that separates the
/// columns of a table.
fn plain(name: &str) -> String {
    let name = without_unit(name).replace([',', ';', '\t', '\n', '\r', '"'], "_");
    if name.parse::<f64>().is_ok() { format!("channel_{name}") } else { name }
}

impl Choice {
    /// Appends what the session takes of `instants` (`[samples × channels of the offer]`) to `into`
    /// (`[samples × channels of the session]`), in the session's unit.
    pub fn take(&self, instants: &[f32], into: &mut Vec<f32>) {
        for instant in instants.chunks_exact(self.offered) {
            into.extend(self.taken.iter().map(|&(place, factor)| instant[place] * factor));
        }
    }
}

/// So many EMG channels, with their names.
fn emg_channels(count: usize, names: &str) -> String {
    match count {
        0 => "no channel that it calls EMG".to_owned(),
        1 => format!("1 EMG channel ({names})"),
        count => format!("{count} EMG channels ({names})"),
    }
}

/// The first of some names, and how many more there are: a Quattrocento has 384 channels.
fn listed(mut names: impl ExactSizeIterator<Item = String>) -> String {
    let first = names.by_ref().take(NAMES_LISTED).collect::<Vec<_>>().join(", ");
    match names.len() {
        0 => first,
        more => format!("{first} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer() -> Offer {
        let channel = |name: &str, unit: &str, is_emg| OfferedChannel {
            name: name.to_owned(),
            unit: unit.to_owned(),
            is_emg,
        };
        let channels = vec![
            channel("counter", "", false),
            channel("flexor", "microvolts", true),
            channel("extensor", "mV", true),
            channel("thumb", "uV", true),
        ];
        Offer { sample_rate_hz: 1259.259, channels }
    }

    fn settings(channels: usize, selection: Option<&[Channel]>, unit: Option<&str>) -> AcquisitionSettings {
        AcquisitionSettings {
            channels,
            sample_rate_hz: 1259.0,
            channel_selection: selection.map(<[Channel]>::to_vec),
            unit: unit.map(str::to_owned),
            ..AcquisitionSettings::default()
        }
    }

    fn refusal(settings: &AcquisitionSettings) -> String {
        offer().choose(settings).unwrap_err().to_string()
    }

    #[test]
    fn the_first_emg_channels_are_taken_and_converted() {
        let choice = offer().choose(&settings(2, None, Some("mV"))).unwrap();
        assert_eq!(choice.signal.channels, ["flexor", "extensor"]);
        assert_eq!(choice.signal.unit, "mV");
        let mut taken = Vec::new();
        choice.take(&[7.0, 500.0, 2.0, 9.0, 8.0, -1000.0, 3.0, 9.0], &mut taken);
        assert_eq!(taken, [0.5, 2.0, -1.0, 3.0]);
    }

    #[test]
    fn channels_are_chosen_by_name_and_number_in_the_order_asked_for() {
        let choice = offer().choose(&settings(2, Some(&["thumb".into(), 1.into()]), None)).unwrap();
        assert_eq!(choice.signal.channels, ["thumb", "flexor"]);
        assert_eq!(choice.signal.unit, "uV");
        let mut taken = Vec::new();
        choice.take(&[7.0, 500.0, 2.0, 9.0], &mut taken);
        assert_eq!(taken, [9.0, 500.0]);
    }

    #[test]
    fn of_many_channels_a_refusal_names_the_first() {
        let mut many = offer();
        many.channels = (1..=384)
            .map(|number| OfferedChannel { name: format!("EMG {number}"), unit: "mV".into(), is_emg: true })
            .collect();
        let refused = many.choose(&settings(1, Some(&["thumb".into()]), None)).unwrap_err().to_string();
        assert!(refused.ends_with("only 0: EMG 1, 1: EMG 2, 2: EMG 3, 3: EMG 4, 4: EMG 5, 5: EMG 6, 6: EMG 7, 7: EMG 8, \
                                   8: EMG 9, 9: EMG 10, 10: EMG 11, 11: EMG 12, 12: EMG 13, 13: EMG 14, 14: EMG 15, \
                                   15: EMG 16 and 368 more"), "{refused}");
    }

    #[test]
    fn names_that_are_numbers_or_separate_columns_are_found_again_by_what_they_became() {
        let mut numbered = offer();
        numbered.channels[1].name = "2".to_owned();
        numbered.channels[2].name = "ext, left".to_owned();
        let choice = numbered.choose(&settings(2, None, Some("mV"))).unwrap();
        assert_eq!(choice.signal.channels, ["channel_2", "ext_ left"]);
        let names = choice.signal.channels.iter().map(|name| Channel::Name(name.clone())).collect::<Vec<_>>();
        let again = numbered.choose(&settings(2, Some(&names), Some("mV"))).unwrap();
        assert_eq!(again.signal, choice.signal);
    }

    #[test]
    fn what_the_amplifier_does_not_offer_is_refused_by_name_with_the_way_on() {
        let mut other_rate = settings(2, None, Some("mV"));
        other_rate.sample_rate_hz = 2000.0;
        assert!(refusal(&other_rate).contains("--set acquisition.sample_rate_hz=1259.259"));
        let nowhere = refusal(&settings(1, Some(&["palm".into()]), None));
        assert!(nowhere.contains("no channel `palm`, only 0: counter, 1: flexor"), "{nowhere}");
        assert!(refusal(&settings(1, Some(&[4.into()]), None)).contains("no channel 4"));
        assert!(
            refusal(&settings(2, Some(&[1.into(), "flexor".into()]), None))
                .contains("flexor is chosen twice")
        );
        let few = refusal(&settings(4, None, None));
        assert!(few.contains("3 EMG channels (flexor, extensor, thumb)"), "{few}");
        let mixed = refusal(&settings(2, None, None));
        assert!(mixed.contains("\"uV\"") && mixed.contains("acquisition.unit"), "{mixed}");
        assert!(
            refusal(&settings(1, Some(&[0.into()]), Some("mV")))
                .contains("does not say in which unit counter is")
        );
        assert!(refusal(&settings(1, None, Some("ADC counts"))).contains("flexor: the samples are in"));
        let mut twins = offer();
        twins.channels[3].name = "flexor".to_owned();
        let twin = twins.choose(&settings(1, Some(&["flexor".into()]), None)).unwrap_err().to_string();
        assert!(twin.contains("choose by number"), "{twin}");
    }

    #[test]
    fn a_rate_that_is_no_number_is_refused() {
        let mut senseless = offer();
        senseless.sample_rate_hz = f64::NAN;
        senseless.choose(&settings(1, None, None)).unwrap_err();
    }
}
