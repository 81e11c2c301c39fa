//! What ships from other people: how features scatter within a gesture, whoever makes it.
//!
//! ```text
//! {"format":"tendon-prior","version":1,"layout":{…},"people":["1",…],"windows":60000,"classes":[…],"crc32":…}\n
//! f32, little-endian: covariance (lower triangle row by row), and with classes: their offsets, one after the other,
//! the covariance between people and that between repetitions
//! ```

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::covariance::LaggedLogCovariance;
use crate::error::{FitError, PriorError};
use crate::population::Population;
use crate::training::Training;

const FORMAT: &str = "tendon-prior";
const VERSION: u32 = 1;
/// Beyond this many channels x delays a layout is no layout but a damaged file.
const LARGEST_ROWS: usize = 256;

/// What decides which feature is which.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureLayout {
    /// Number of channels.
    pub channels: usize,
    /// Delays that are used, in ms.
    pub delays_ms: Vec<f64>,
    /// Lowest sampling rate.
    pub lowest_rate_hz: f64,
    /// Highest sampling rate.
    pub highest_rate_hz: f64,
}

impl FeatureLayout {
    /// Number of features.
    pub fn feature_count(&self) -> usize {
        let rows = self.channels * self.delays_ms.len();
        rows * (rows + 1) / 2
    }

    fn check(&self) -> Result<(), PriorError> {
        let rows = self.channels.checked_mul(self.delays_ms.len());
        let fields = [
            ("channels", rows.is_some_and(|rows| (1..=LARGEST_ROWS).contains(&rows))),
            ("delays_ms", self.delays_ms.iter().all(|delay| delay.is_finite())),
            ("lowest_rate_hz", self.lowest_rate_hz > 0.0 && self.lowest_rate_hz <= self.highest_rate_hz),
            ("highest_rate_hz", self.highest_rate_hz.is_finite()),
        ];
        match fields.into_iter().find(|(_, fits)| !fits) {
            Some((field, _)) => Err(PriorError::Layout { field }),
            None => Ok(()),
        }
    }
}

/// How the windows of one person scatter about the mean of their gesture. Kept per person, so that a prior
/// can leave people out.
#[derive(Clone, Debug)]
pub struct WithinClassScatter {
    sum: DMatrix<f64>,
    windows: usize,
}

impl WithinClassScatter {
    /// The scatter of one session of a person; [`add`](Self::add) joins further ones.
    ///
    /// # Errors
    ///
    /// What is wrong with the windows.
    pub fn new(session: &Training) -> Result<WithinClassScatter, FitError> {
        session.check()?;
        let centred = session.centred(&session.means());
        Ok(WithinClassScatter { sum: &centred * centred.transpose(), windows: session.len() })
    }

    /// Adds another session of the same person, centred on its own means.
    ///
    /// # Errors
    ///
    /// It has another number of features.
    pub fn add(&mut self, other: &WithinClassScatter) -> Result<(), FitError> {
        let (given, needed) = (other.sum.nrows(), self.sum.nrows());
        if given != needed {
            return Err(FitError::Length { what: "features of the scatter", given, needed });
        }
        self.sum += &other.sum;
        self.windows += other.windows;
        Ok(())
    }
}

/// The pooled within-class covariance of other people, for one layout of features.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    layout: FeatureLayout,
    people: Vec<String>,
    windows: usize,
    covariance: DMatrix<f64>,
    population: Option<Population>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    version: u32,
    layout: FeatureLayout,
    people: Vec<String>,
    windows: usize,
    /// Those of the population; empty without one.
    classes: Vec<String>,
    crc32: u32,
}

/// Read before the rest of the header, which may differ between versions.
#[derive(Deserialize)]
struct Version {
    format: String,
    version: u32,
}

impl Prior {
    /// Pools the scatter of people; each window counts the same.
    ///
    /// # Errors
    ///
    /// A scatter of another layout, or fewer windows than features.
    pub fn pool<'a>(
        layout: FeatureLayout,
        people: impl IntoIterator<Item = (&'a str, &'a WithinClassScatter)>,
    ) -> Result<Prior, PriorError> {
        layout.check()?;
        let length = layout.feature_count();
        let mut total = WithinClassScatter { sum: DMatrix::zeros(length, length), windows: 0 };
        let mut names = Vec::new();
        for (name, scatter) in people {
            total.add(scatter)?;
            names.push(name.to_owned());
        }
        let WithinClassScatter { sum, windows } = total;
        if windows <= length {
            return Err(PriorError::TooFewWindows { windows, length });
        }
        Ok(Prior { layout, people: names, windows, covariance: sum / windows as f64, population: None })
    }

    /// The same prior with what the same people's gestures have in common.
    ///
    /// # Errors
    ///
    /// A population of other features.
    pub fn with_population(self, population: Population) -> Result<Prior, PriorError> {
        let (given, needed) = (population.offsets.nrows(), self.layout.feature_count());
        if given != needed {
            return Err(FitError::Length { what: "features of the population", given, needed }.into());
        }
        Ok(Prior { population: Some(population), ..self })
    }

    /// What the people's gestures have in common, if it is known.
    pub fn population(&self) -> Option<&Population> {
        self.population.as_ref()
    }

    /// Refuses features that the prior was not made for.
    ///
    /// # Errors
    ///
    /// What differs: channels, delays or rate.
    pub fn check(&self, features: &LaggedLogCovariance) -> Result<(), PriorError> {
        let FeatureLayout { channels, delays_ms, lowest_rate_hz, highest_rate_hz } = &self.layout;
        let theirs = features.layout();
        if *channels != theirs.channels {
            return Err(PriorError::Channels { prior: *channels, features: theirs.channels });
        }
        if *delays_ms != theirs.delays_ms {
            return Err(PriorError::Delays { prior: delays_ms.clone(), features: theirs.delays_ms });
        }
        let rate_hz = features.rate_hz();
        if !(*lowest_rate_hz..=*highest_rate_hz).contains(&rate_hz) {
            return Err(PriorError::Rate { lowest: *lowest_rate_hz, highest: *highest_rate_hz, rate_hz });
        }
        Ok(())
    }

    /// The features it is for.
    pub fn layout(&self) -> &FeatureLayout {
        &self.layout
    }

    /// Who it was made from. Nobody of them may be scored with it.
    pub fn people(&self) -> &[String] {
        &self.people
    }

    /// Number of windows it was made from.
    pub fn windows(&self) -> usize {
        self.windows
    }

    /// The covariance, features x features.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// The prior as the bytes of a file: a line of JSON, then numbers as `f32`.
    ///
    /// # Errors
    ///
    /// The header cannot be written as JSON.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PriorError> {
        let mut numbers = Vec::new();
        write_triangle(&self.covariance, &mut numbers);
        if let Some(population) = &self.population {
            numbers.extend(population.offsets.iter().flat_map(|value| (*value as f32).to_le_bytes()));
            write_triangle(&population.between_people, &mut numbers);
            write_triangle(&population.between_repetitions, &mut numbers);
        }
        let classes = self.population.as_ref().map(|population| population.classes.clone());
        let header = Header {
            format: FORMAT.to_owned(),
            version: VERSION,
            layout: self.layout.clone(),
            people: self.people.clone(),
            windows: self.windows,
            classes: classes.unwrap_or_default(),
            crc32: crc32fast::hash(&numbers),
        };
        let mut bytes = serde_json::to_vec(&header).map_err(PriorError::Header)?;
        bytes.push(b'\n');
        bytes.extend_from_slice(&numbers);
        Ok(bytes)
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote.
    ///
    /// # Errors
    ///
    /// The bytes are no prior, are of another version, were cut short, or are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Prior, PriorError> {
        let line = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
        let (line, numbers) = (&bytes[..line], bytes.get(line + 1..).unwrap_or(&[]));
        let Version { format, version } = serde_json::from_slice(line).map_err(PriorError::Header)?;
        if format != FORMAT {
            return Err(PriorError::Format(format));
        }
        if version != VERSION {
            return Err(PriorError::Version { found: version, expected: VERSION });
        }
        let header: Header = serde_json::from_slice(line).map_err(PriorError::Header)?;
        let Header { layout, people, windows, classes: names, crc32, .. } = header;
        layout.check()?;
        let length = layout.feature_count();
        let triangle = length * (length + 1) / 2;
        let classes = names.len();
        // No file is so long that this wraps around: its length is compared next.
        let of_population = if classes == 0 { 0 } else { classes.saturating_mul(length) + 2 * triangle };
        let expected = (triangle.saturating_add(of_population)).saturating_mul(size_of::<f32>());
        if numbers.len() != expected {
            return Err(PriorError::Size { found: numbers.len(), expected });
        }
        if crc32fast::hash(numbers) != crc32 {
            return Err(PriorError::Checksum);
        }
        let mut values = numbers.as_chunks::<4>().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
        let covariance = read_triangle(length, &mut values)?;
        let population = if classes == 0 {
            None
        } else {
            let offsets = DMatrix::from_iterator(length, classes, values.by_ref().take(classes * length));
            if !offsets.iter().all(|value| value.is_finite()) {
                return Err(PriorError::NotPositive);
            }
            Some(Population {
                classes: names,
                offsets,
                between_people: read_triangle(length, &mut values)?,
                between_repetitions: read_triangle(length, &mut values)?,
            })
        };
        Ok(Prior { layout, people, windows, covariance, population })
    }
}

/// Appends the lower triangle, row by row.
fn write_triangle(matrix: &DMatrix<f64>, bytes: &mut Vec<u8>) {
    let places = (0..matrix.nrows()).flat_map(|row| (0..=row).map(move |column| (row, column)));
    bytes.extend(places.flat_map(|at| (matrix[at] as f32).to_le_bytes()));
}

fn read_triangle(length: usize, values: &mut impl Iterator<Item = f64>) -> Result<DMatrix<f64>, PriorError> {
    let mut covariance = DMatrix::zeros(length, length);
    let places = (0..length).flat_map(|row| (0..=row).map(move |column| (row, column)));
    for ((row, column), value) in places.zip(values) {
        covariance[(row, column)] = value;
        covariance[(column, row)] = value;
    }
    let finite = covariance.iter().all(|value| value.is_finite());
    if !finite || !covariance.diagonal().iter().all(|variance| *variance > 0.0) {
        return Err(PriorError::NotPositive);
    }
    Ok(covariance)
}
