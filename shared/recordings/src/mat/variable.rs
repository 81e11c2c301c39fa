//! A variable of a MAT-file, and its values one by one.

use super::hdf5::Dataset;
use super::problem::MatError;

/// A variable, its values not yet read.
#[derive(Clone, Debug)]
pub(super) struct Variable {
    pub(super) name: String,
    /// What it is, if no full matrix of real numbers.
    pub(super) other: Option<String>,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) place: Place,
}

/// Where the values of a variable are.
#[derive(Clone, Debug)]
pub(super) enum Place {
    /// In the element whose tag begins there in the file.
    Element(u64),
    Hdf5(Box<Dataset>),
    /// There are none that can be read.
    Nowhere,
}

/// Takes the values of chosen columns: the column, and a value of it. Those of a column come in order.
pub(super) type Visit<'a> = dyn FnMut(usize, f64) -> Result<(), MatError> + 'a;
