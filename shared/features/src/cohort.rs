//! What is known of other people's windows and gestures, person by person, so that a prior can leave anybody out.
//!
//! ```text
//! {"format":"tendon-prior","version":2,"layout":{…},"members":[{"data_set":"3DC","number":1,…},…],"crc32":…}\n
//! f32, little-endian, of each member: scatter within gestures (lower triangle row by row), means of the gestures, and
//! how each repetition differs from them, one after the other
//! ```

use std::fmt;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use tendon_identity::PersonId;

use crate::covariance::LaggedLogCovariance;
use crate::error::{FeatureError, FitError, PriorError};
use crate::population::{GestureMeans, Population};
use crate::prior::{FeatureLayout, Prior, WithinClassScatter};
use crate::settings::MethodSettings;
use crate::training::Training;

const FORMAT: &str = "tendon-prior";
const VERSION: u32 = 2;

/// Somebody of a data set. A number alone names nobody: every data set counts its people from 1.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemberId {
    /// The data set; empty for recordings of your own.
    pub data_set: String,
    /// Who it is there.
    #[serde(rename = "number")]
    pub person: PersonId,
}

impl fmt::Display for MemberId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.data_set.as_str() {
            "" => write!(out, "{}", self.person),
            data_set => write!(out, "{data_set} {}", self.person),
        }
    }
}

/// People whose windows make priors for others.
#[derive(Clone, Debug)]
pub struct Cohort {
    layout: FeatureLayout,
    members: Vec<Member>,
}

#[derive(Clone, Debug)]
struct Member {
    id: MemberId,
    scatter: WithinClassScatter,
    /// `None` of somebody who made a gesture only once.
    means: Option<GestureMeans>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: String,
    version: u32,
    layout: FeatureLayout,
    members: Vec<MemberHeader>,
    crc32: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MemberHeader {
    #[serde(flatten)]
    id: MemberId,
    /// Windows of the scatter.
    windows: usize,
    /// Those of the means; empty without them.
    classes: Vec<String>,
    /// Repetitions of all gestures together.
    repetitions: usize,
}

/// Read before the rest of the header, which may differ between versions.
#[derive(Deserialize)]
struct Version {
    format: String,
    version: u32,
}

impl Cohort {
    /// Whether its priors fit the features of windows of `channels` at `rate_hz`.
    ///
    /// # Errors
    ///
    /// No windows have such features.
    pub fn serves(
        &self,
        method: &MethodSettings,
        channels: usize,
        rate_hz: f64,
    ) -> Result<bool, FeatureError> {
        // Which feature is which does not depend on the floor.
        let features = LaggedLogCovariance::new(method, channels, rate_hz, 1.0)?;
        Ok(self.layout.fits(&features).is_ok())
    }

    /// Nobody yet.
    pub fn new(layout: FeatureLayout) -> Cohort {
        Cohort { layout, members: Vec::new() }
    }

    /// The same people, for features at these rates.
    pub fn with_rates(mut self, lowest_rate_hz: f64, highest_rate_hz: f64) -> Cohort {
        (self.layout.lowest_rate_hz, self.layout.highest_rate_hz) = (lowest_rate_hz, highest_rate_hz);
        self
    }

    /// The features it is for.
    pub fn layout(&self) -> &FeatureLayout {
        &self.layout
    }

    /// Who is in it.
    pub fn members(&self) -> impl ExactSizeIterator<Item = &MemberId> {
        self.members.iter().map(|member| &member.id)
    }

    /// Adds a person with all their windows: session by session, and all together with a block for each repetition.
    ///
    /// # Errors
    ///
    /// What is wrong with the windows, or features of another length.
    pub fn add(&mut self, id: MemberId, sessions: &[Training], all: &Training) -> Result<(), FitError> {
        let length = self.layout.feature_count();
        let mut scatter = WithinClassScatter::zeros(length);
        for session in sessions {
            scatter.add(&WithinClassScatter::new(session)?)?;
        }
        let means = match GestureMeans::new(all) {
            Ok(means) => Some(means),
            Err(FitError::TooFewRepetitions { .. }) => None,
            Err(error) => return Err(error),
        };
        self.members.push(Member { id, scatter, means });
        Ok(())
    }

    /// The prior of those for whom `is_included` says so; `None` if they are too few.
    ///
    /// # Errors
    ///
    /// The gestures that all of them made are too few.
    pub fn prior(&self, is_included: impl Fn(&MemberId) -> bool) -> Result<Option<Prior>, PriorError> {
        let included: Vec<(String, &Member)> = self
            .members
            .iter()
            .filter(|member| is_included(&member.id))
            .map(|member| (member.id.to_string(), member))
            .collect();
        let scatters = included.iter().map(|(name, member)| (name.as_str(), &member.scatter));
        let prior = match Prior::pool(self.layout.clone(), scatters) {
            Err(PriorError::TooFewWindows { .. }) => return Ok(None),
            pooled => pooled?,
        };
        match Population::pool(included.iter().filter_map(|(_, member)| member.means.as_ref())) {
            Err(PriorError::TooFewPeople(_)) => Ok(Some(prior)),
            population => Ok(Some(prior.with_population(population?)?)),
        }
    }

    /// The cohort as the bytes of a file: a line of JSON, then numbers as `f32`.
    ///
    /// # Errors
    ///
    /// The header cannot be written as JSON.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PriorError> {
        let mut numbers = Vec::new();
        for Member { scatter, means, .. } in &self.members {
            let sum = scatter.sum();
            let places = (0..sum.nrows()).flat_map(|row| (0..=row).map(move |column| (row, column)));
            write(places.map(|at| sum[at]), &mut numbers);
            if let Some(means) = means {
                write(means.means().iter().copied(), &mut numbers);
                write(means.deviations().iter().copied(), &mut numbers);
            }
        }
        let header = Header {
            format: FORMAT.to_owned(),
            version: VERSION,
            layout: self.layout.clone(),
            members: self.members.iter().map(MemberHeader::of).collect(),
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
    pub fn from_bytes(bytes: &[u8]) -> Result<Cohort, PriorError> {
        let line = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
        let (line, numbers) = (&bytes[..line], bytes.get(line + 1..).unwrap_or(&[]));
        let Version { format, version } = serde_json::from_slice(line).map_err(PriorError::Header)?;
        if format != FORMAT {
            return Err(PriorError::Format(format));
        }
        if version != VERSION {
            return Err(PriorError::Version { found: version, expected: VERSION });
        }
        let Header { layout, members, crc32, .. } =
            serde_json::from_slice(line).map_err(PriorError::Header)?;
        layout.check()?;
        let length = layout.feature_count();
        let values = members.iter().map(|member| member.values(length)).fold(0, usize::saturating_add);
        let expected = values.saturating_mul(size_of::<f32>());
        if numbers.len() != expected {
            return Err(PriorError::Size { found: numbers.len(), expected });
        }
        if crc32fast::hash(numbers) != crc32 {
            return Err(PriorError::Checksum);
        }
        let mut values = numbers.as_chunks::<4>().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
        let members = members.into_iter().map(|member| member.read(length, &mut values));
        Ok(Cohort { layout, members: members.collect::<Result<_, _>>()? })
    }
}

impl MemberHeader {
    fn of(member: &Member) -> MemberHeader {
        let Member { id, scatter, means } = member;
        MemberHeader {
            id: id.clone(),
            windows: scatter.windows(),
            classes: means.as_ref().map_or_else(Vec::new, |means| means.classes().to_vec()),
            repetitions: means.as_ref().map_or(0, |means| means.deviations().ncols()),
        }
    }

    /// Numbers in the file.
    fn values(&self, length: usize) -> usize {
        let columns = self.classes.len().saturating_add(self.repetitions);
        (length * (length + 1) / 2).saturating_add(columns.saturating_mul(length))
    }

    fn read(self, length: usize, values: &mut impl Iterator<Item = f64>) -> Result<Member, PriorError> {
        let mut sum = DMatrix::zeros(length, length);
        for row in 0..length {
            for column in 0..=row {
                let value = values.next().ok_or(PriorError::NotPositive)?;
                sum[(row, column)] = value;
                sum[(column, row)] = value;
            }
        }
        let finite = sum.iter().all(|value| value.is_finite());
        if !finite || !sum.diagonal().iter().all(|variance| *variance > 0.0) {
            return Err(PriorError::NotPositive);
        }
        let mut matrix =
            |columns: usize| DMatrix::from_iterator(length, columns, values.by_ref().take(length * columns));
        let means = if self.classes.is_empty() {
            None
        } else {
            let (means, deviations) = (matrix(self.classes.len()), matrix(self.repetitions));
            if !means.iter().chain(deviations.iter()).all(|value| value.is_finite()) {
                return Err(PriorError::NotPositive);
            }
            Some(GestureMeans::from_parts(self.classes, means, deviations))
        };
        Ok(Member { id: self.id, scatter: WithinClassScatter::from_parts(sum, self.windows), means })
    }
}

fn write(values: impl Iterator<Item = f64>, bytes: &mut Vec<u8>) {
    bytes.extend(values.flat_map(|value| (value as f32).to_le_bytes()));
}
