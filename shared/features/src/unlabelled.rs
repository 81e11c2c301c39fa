//! Recognises a person's gestures in a stream of windows of which nobody says what was made.
//!
//! ```text
//! other people, the armband turned by -2 … 2 electrodes ─▶ PlacedGestures ─▶ GestureMap
//!                                                                               │ whitened, 40 directions
//! a stream of held gestures ─▶ features ─▶ clusters ─▶ which is which, all at once ─▶ Recognised: a gesture a window
//!                                             └─ the quietest is rest
//! ```
//!
//! A person's gestures are clean clusters in time; what is hard is to say which cluster is which gesture. People's gestures lie
//! alike relative to each other, but the armband does not always sit alike. So the map holds where gestures lie for several
//! places of the armband (M), with one covariance of how people differ (B), and all assignments are weighed by
//! exp(-½ τ Σ (C - M)ᵀ B⁻¹ (C - M)), summed over the places, where C are the means of the clusters less their mean.
//!
//! The constants are those that did best of the few that were tried: docs/decisions/personal-recogniser.md, "Without labels".

use nalgebra::{Cholesky, DMatrix, SymmetricEigen};

use crate::assignment::{Assigned, assign};
use crate::clustering::{cluster_stream, means};
use crate::error::{FitError, UnlabelledError};
use crate::prior::WithinClassScatter;
use crate::shrinkage::ledoit_wolf;
use crate::training::Training;

/// Directions in which the means of gestures are compared.
const DIRECTIONS: usize = 40;
/// The first of them, in which windows are clustered.
const CLUSTER_DIRECTIONS: usize = 20;
/// A direction counts if gestures scatter at least so much of what they do in the first.
const SMALLEST_SCATTER: f64 = 1e-9;
/// Share of B's mean diagonal that is added to its diagonal.
const RIDGE: f64 = 0.1;
/// How far the armband may be turned for its windows to count towards the scatter within gestures, in electrodes.
const SCATTER_TURN: i8 = 1;
/// Gestures at most, rest among them: all orders of the others are weighed.
const MOST_GESTURES: usize = 9;

/// One person's gestures as the electrodes see them when the armband is turned.
#[derive(Clone, Debug)]
pub struct PlacedGestures {
    turn: i8,
    classes: Vec<String>,
    /// Features x classes.
    means: DMatrix<f64>,
    scatter: WithinClassScatter,
}

impl PlacedGestures {
    /// All windows of a person. `turn` is by how many electrodes the armband is turned.
    ///
    /// # Errors
    ///
    /// What is wrong with the windows, or a class without any.
    pub fn new(turn: i8, training: &Training) -> Result<PlacedGestures, FitError> {
        training.check()?;
        training.check_counts(1)?;
        Ok(PlacedGestures {
            turn,
            classes: training.classes.iter().map(|class| class.name.clone()).collect(),
            means: training.means(),
            scatter: WithinClassScatter::new(training)?,
        })
    }
}

/// Where people's gestures lie, for every place of the armband.
#[derive(Clone, Debug)]
pub struct GestureMap {
    classes: Vec<String>,
    /// Directions x features: whitens windows and keeps the directions in which gestures scatter most.
    projection: DMatrix<f64>,
    /// Directions x classes, of every place of the armband.
    offsets: Vec<DMatrix<f64>>,
    /// B.
    between_people: Cholesky<f64, nalgebra::Dyn>,
}

/// What was recognised in a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognised {
    /// Of each window, its class: a place in [`GestureMap::classes`]. Every class has windows.
    pub labels: Vec<usize>,
    /// Of each window, the probability that this is its class.
    pub probabilities: Vec<f64>,
    /// The share of the gestures that are expected to have their right names, from 0 to 1.
    pub sureness: f64,
}

impl GestureMap {
    /// The map of the gestures that all of these people made, of which `rest` is the arm at rest.
    ///
    /// # Errors
    ///
    /// Fewer than two people in a place, other features among them, fewer than two gestures or no rest in common, too few
    /// windows or too many gestures.
    pub fn new(people: &[PlacedGestures], rest: &str) -> Result<GestureMap, UnlabelledError> {
        let first = people.first().ok_or(UnlabelledError::TooFewPeople(0))?;
        let classes = common_classes(people, first, rest)?;
        let length = first.means.nrows();
        if let Some(other) = people.iter().find(|person| person.means.nrows() != length) {
            let (what, given) = ("features of a person's gestures", other.means.nrows());
            return Err(FitError::Length { what, given, needed: length }.into());
        }
        let mut scatter = WithinClassScatter::zeros(length);
        for person in people.iter().filter(|person| person.turn.abs() <= SCATTER_TURN) {
            scatter.add(&person.scatter)?;
        }
        let windows = scatter.windows();
        if windows <= length {
            return Err(UnlabelledError::TooFewWindows { windows, length });
        }
        let within = Cholesky::new(scatter.sum() / windows as f64).ok_or(FitError::Singular)?;
        let of_people: Vec<DMatrix<f64>> = people.iter().map(|person| offsets(person, &classes)).collect();
        let columns: Vec<_> = of_people.iter().flat_map(|offsets| offsets.column_iter()).collect();
        let whitened = within.l().solve_lower_triangular(&DMatrix::from_columns(&columns));
        let directions = directions(&whitened.ok_or(FitError::Singular)?);
        // (L⁻¹)ᵀ of the directions, transposed: what whitens and projects at once.
        let projection = within.l().tr_solve_lower_triangular(&directions).ok_or(FitError::Singular)?;
        let projection = projection.transpose();

        let mut turns: Vec<i8> = people.iter().map(|person| person.turn).collect();
        turns.sort_unstable();
        turns.dedup();
        let mut offsets = Vec::new();
        let mut apart = Vec::new();
        for turn in turns {
            let of_turn = people.iter().zip(&of_people).filter(|(person, _)| person.turn == turn);
            let projected: Vec<DMatrix<f64>> = of_turn.map(|(_, offsets)| &projection * offsets).collect();
            let count = projected.len() as f64;
            if projected.len() < 2 {
                return Err(UnlabelledError::TooFewPeople(projected.len()));
            }
            let mean = projected.iter().sum::<DMatrix<f64>>() / count;
            // What the mean over people has taken of the deviations.
            let scale = (count / (count - 1.0)).sqrt();
            for person in &projected {
                let person = (person - &mean) * scale;
                apart.extend(person.column_iter().map(|gesture| gesture.into_owned()));
            }
            offsets.push(mean);
        }
        let mut between = ledoit_wolf(&DMatrix::from_columns(&apart)).covariance;
        let ridge = RIDGE * between.trace() / between.nrows() as f64;
        between.iter_mut().step_by(projection.nrows() + 1).for_each(|variance| *variance += ridge);
        let between_people = Cholesky::new(between).ok_or(FitError::Singular)?;
        Ok(GestureMap { classes, projection, offsets, between_people })
    }

    /// The gestures, rest first.
    pub fn classes(&self) -> &[String] {
        &self.classes
    }

    /// Finds the gestures in a stream: the features of its windows one after the other, and of each window its
    /// [`mean_log_variance`](crate::LaggedLogCovariance::mean_log_variance), by which rest is known.
    ///
    /// # Errors
    ///
    /// Features of another length, or a stream that is too short.
    pub fn recognise(
        &self,
        features: &[f64],
        mean_log_variances: &[f64],
    ) -> Result<Recognised, UnlabelledError> {
        let (length, count) = (self.projection.ncols(), mean_log_variances.len());
        if features.len() != length * count {
            let what = "features of the stream";
            return Err(FitError::Length { what, given: features.len(), needed: length * count }.into());
        }
        if let Some(window) =
            features.chunks(length).position(|window| !window.iter().all(|value| value.is_finite()))
        {
            return Err(FitError::NotFinite { window }.into());
        }
        let gestures = self.classes.len();
        let windows = &self.projection * DMatrix::from_column_slice(length, count, features);
        let first = windows.rows(0, CLUSTER_DIRECTIONS.min(windows.nrows())).into_owned();
        let shares = cluster_stream(&first, gestures)
            .ok_or(UnlabelledError::StreamTooShort { windows: count, gestures })?;
        let levels = means(&DMatrix::from_row_slice(1, count, mean_log_variances), &shares);
        let Assigned { cluster_of, probabilities } =
            assign(&self.costs(means(&windows, &shares)), levels.row(0).transpose().argmin().0);

        let gesture_of =
            |cluster: usize| cluster_of.iter().position(|own| *own == cluster).unwrap_or_default();
        let labels: Vec<usize> =
            shares.row_iter().map(|shares| gesture_of(shares.transpose().argmax().0)).collect();
        let of_window = labels.iter().zip(shares.row_iter());
        let of_window = of_window.map(|(&gesture, shares)| shares.dot(&probabilities.row(gesture)));
        let right =
            cluster_of.iter().enumerate().map(|(gesture, &cluster)| probabilities[(gesture, cluster)]);
        Ok(Recognised {
            probabilities: of_window.collect(),
            sureness: right.sum::<f64>() / gestures as f64,
            labels,
        })
    }

    /// Squared distances of every gesture (row) from every cluster (column), in every place of the armband.
    fn costs(&self, mut clusters: DMatrix<f64>) -> Vec<DMatrix<f64>> {
        let middle = clusters.column_mean();
        clusters.column_iter_mut().for_each(|mut mean| mean -= &middle);
        let cost = |offsets: &DMatrix<f64>, gesture: usize, cluster: usize| {
            let apart = clusters.column(cluster) - offsets.column(gesture);
            apart.dot(&self.between_people.solve(&apart))
        };
        let gestures = self.classes.len();
        let of_place = |offsets| {
            DMatrix::from_fn(gestures, gestures, |gesture, cluster| cost(offsets, gesture, cluster))
        };
        self.offsets.iter().map(of_place).collect()
    }
}

/// The classes that all people have, rest first.
fn common_classes(
    people: &[PlacedGestures],
    first: &PlacedGestures,
    rest: &str,
) -> Result<Vec<String>, UnlabelledError> {
    let is_common = |class: &&String| people.iter().all(|person| person.classes.contains(class));
    let mut classes: Vec<String> = first.classes.iter().filter(is_common).cloned().collect();
    let place = classes.iter().position(|class| class == rest).ok_or(UnlabelledError::NoRest)?;
    let rest = classes.remove(place);
    classes.insert(0, rest);
    match classes.len() {
        0..2 => Err(UnlabelledError::NothingInCommon),
        2..=MOST_GESTURES => Ok(classes),
        gestures => Err(UnlabelledError::TooManyGestures { gestures, most: MOST_GESTURES }),
    }
}

/// A person's means of `classes`, which are among theirs, less the mean of these means.
fn offsets(person: &PlacedGestures, classes: &[String]) -> DMatrix<f64> {
    let column = |class: &String| {
        let place = person.classes.iter().position(|own| own == class).unwrap_or_default();
        person.means.column(place)
    };
    let mut offsets = DMatrix::from_columns(&classes.iter().map(column).collect::<Vec<_>>());
    let middle = offsets.column_mean();
    offsets.column_iter_mut().for_each(|mut mean| mean -= &middle);
    offsets
}

/// The directions (features x directions) in which whitened offsets (features x any number) scatter most.
fn directions(whitened: &DMatrix<f64>) -> DMatrix<f64> {
    let SymmetricEigen { eigenvectors, eigenvalues } =
        SymmetricEigen::new(whitened * whitened.transpose() / whitened.ncols() as f64);
    let mut order: Vec<usize> = (0..eigenvalues.len()).collect();
    order.sort_by(|one, other| eigenvalues[*other].total_cmp(&eigenvalues[*one]));
    let smallest = SMALLEST_SCATTER * eigenvalues.max();
    let kept = order.into_iter().take(DIRECTIONS).filter(|direction| eigenvalues[*direction] > smallest);
    eigenvectors.select_columns(&kept.collect::<Vec<_>>())
}
