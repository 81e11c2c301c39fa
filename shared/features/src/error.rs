//! What can go wrong with features, with a fit and with a prior.

/// Why there are no features.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FeatureError {
    /// The delays do not ascend from 0, or there are none.
    #[error("delays_ms = {0:?}: give delays in ms, ascending from 0 to at most 1000, e.g. [0, 1, 2, 3]")]
    Delays(Vec<f64>),
    /// A constant of the method is out of its range.
    #[error("{setting} = {value}: give {range}")]
    Setting {
        /// The field of [`MethodSettings`](crate::MethodSettings).
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// The number of channels is 0 or beyond what the features are made for.
    #[error("{0} channels: features need 1 to 256 channels")]
    Channels(usize),
    /// The sampling rate is not a positive number.
    #[error("a sampling rate of {0} Hz: give the positive rate at which the source samples")]
    Rate(f64),
    /// The floor is not a positive variance.
    #[error(
        "a floor of {0}: give a positive variance in the square of the unit, taken from the person's rest"
    )]
    Floor(f64),
    /// The rest has no variance to take a floor from.
    #[error(
        "the rest is flat or not finite in most windows: check that the electrodes are connected, and record \
         rest again"
    )]
    FlatRest,
    /// The window is not channels x samples.
    #[error("a window of {values} values does not divide into {channels} channels")]
    Window {
        /// Values in the window.
        values: usize,
        /// Channels that are expected.
        channels: usize,
    },
    /// The window is too short for the delays.
    #[error("a window of {samples} samples is too short for the delays, which need {needed}")]
    TooShort {
        /// Samples per channel.
        samples: usize,
        /// Samples that are needed per channel.
        needed: usize,
    },
    /// The output does not have the length of the features.
    #[error("room for {given} features, but there are {needed}")]
    Length {
        /// Length of the output.
        given: usize,
        /// Length of the features.
        needed: usize,
    },
    /// A sample of the window is infinite or not a number.
    #[error("the window has samples that are not finite numbers")]
    NotFinite,
    /// The eigenvalues were not found. No finite window is known for which this happens.
    #[error("the eigenvalues of the window's covariance did not converge")]
    NoConvergence,
}

/// Why a discriminant cannot be fitted or used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// A constant of the method is out of its range.
    #[error(transparent)]
    Settings(#[from] FeatureError),
    /// Fewer than two classes.
    #[error("{0} classes: a recogniser tells at least two gestures apart")]
    TooFewClasses(usize),
    /// A class has a weight that is not a positive number.
    #[error("the weight of {class} is {weight}: give a positive number")]
    Weight {
        /// Name of the class.
        class: String,
        /// Its weight.
        weight: f64,
    },
    /// A number of a fitted discriminant that no fit gives.
    #[error("{what}: {value} is no number that a calibration can give")]
    Value {
        /// Which numbers.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// A class has too few windows.
    #[error(
        "{class} has {windows} windows for calibration, and at least {needed} are needed: record this gesture again"
    )]
    TooFewWindows {
        /// Name of the class.
        class: String,
        /// Windows that it has.
        windows: usize,
        /// Windows that it needs.
        needed: usize,
    },
    /// A class lies in one block only, so no other block of it can be held out.
    #[error(
        "{class} has too few windows outside block {block} to be held out: give every gesture at least two repetitions \
         or blocks"
    )]
    CannotHoldOut {
        /// Name of the class.
        class: String,
        /// The block that was to be held out.
        block: usize,
    },
    /// Features, labels and blocks do not have matching lengths.
    #[error(
        "{values} values of features, {labels} labels and {blocks} blocks do not fit windows of {length} features"
    )]
    Shape {
        /// Values in the features.
        values: usize,
        /// Number of labels.
        labels: usize,
        /// Number of block numbers.
        blocks: usize,
        /// Features of a window.
        length: usize,
    },
    /// A label names no class.
    #[error("window {window} has label {label}, but there are only {classes} classes, counted from 0")]
    Label {
        /// The window.
        window: usize,
        /// Its label.
        label: usize,
        /// Number of classes.
        classes: usize,
    },
    /// A feature is infinite or not a number.
    #[error("window {window} has features that are not finite numbers")]
    NotFinite {
        /// The window, 0 for the one that is classified.
        window: usize,
    },
    /// A slice has another length than the fit.
    #[error("{what}: {given} values were given, {needed} are needed")]
    Length {
        /// Which slice.
        what: &'static str,
        /// Its length.
        given: usize,
        /// The length that is needed.
        needed: usize,
    },
    /// The temperature is not a positive number.
    #[error("a temperature of {0}: give a positive number, 1 for the scores as they are")]
    Temperature(f64),
    /// The time between windows is no time.
    #[error("the time from one window to the next is {0} s: give a finite number above 0")]
    Increment(f64),
    /// A class of which there is only one repetition.
    #[error("{class} was made in one repetition only: two or more are needed to tell how they differ")]
    TooFewRepetitions {
        /// Name of the class.
        class: String,
    },
    /// The covariance has no inverse: all windows of each class are alike.
    #[error("the windows of each class do not differ from each other: check that the signal is not flat")]
    Singular,
}

/// Why a prior cannot be made, read or used.
#[derive(Debug, thiserror::Error)]
pub enum PriorError {
    /// The bytes do not begin as a prior does.
    #[error("this is no prior of Tendon: its first line is not the expected header")]
    Header(#[source] serde_json::Error),
    /// The file is of another kind.
    #[error("this is a file of format {0:?} and no prior of Tendon")]
    Format(String),
    /// The prior has another version.
    #[error("the prior has version {found}, and this program reads version {expected}: make it anew")]
    Version {
        /// Version of the prior.
        found: u32,
        /// Version that is read.
        expected: u32,
    },
    /// The prior is cut short or has bytes left over.
    #[error("the prior holds {found} bytes of numbers where {expected} belong: it was cut short or changed")]
    Size {
        /// Bytes that are there.
        found: usize,
        /// Bytes that belong there.
        expected: usize,
    },
    /// The bytes are not those that were written.
    #[error("the prior is damaged: its checksum is wrong")]
    Checksum,
    /// The covariance has elements that no covariance has.
    #[error(
        "the prior's covariance has variances that are not positive, or elements that are not finite: make it anew"
    )]
    NotPositive,
    /// The header describes no layout.
    #[error("the prior's {field} is not valid")]
    Layout {
        /// The field of the layout.
        field: &'static str,
    },
    /// The prior was made for other channels.
    #[error("the prior is for {prior} channels, and there are {features}")]
    Channels {
        /// Channels of the prior.
        prior: usize,
        /// Channels of the features.
        features: usize,
    },
    /// The prior was made for other delays.
    #[error("the prior is for delays of {prior:?} ms, and the features have {features:?}")]
    Delays {
        /// Delays of the prior.
        prior: Vec<f64>,
        /// Delays of the features.
        features: Vec<f64>,
    },
    /// The prior was made for other pieces.
    #[error("the prior is for pieces of {prior} ms, and the features have pieces of {features} ms")]
    Pieces {
        /// Length of the prior's pieces, ms.
        prior: f64,
        /// Length of the features' pieces, ms.
        features: f64,
    },
    /// The prior was made at other rates.
    #[error("the prior is for {lowest} to {highest} Hz, and the source samples at {rate_hz} Hz")]
    Rate {
        /// Lowest rate of the prior.
        lowest: f64,
        /// Highest rate of the prior.
        highest: f64,
        /// Rate of the features.
        rate_hz: f64,
    },
    /// Nobody's windows to make a prior of, or fewer than the covariance needs.
    #[error("{windows} windows of other people are too few for a prior of {length} features")]
    TooFewWindows {
        /// Windows that were given.
        windows: usize,
        /// Features of a window.
        length: usize,
    },
    /// Too few people to say how people differ.
    #[error("{0} people are too few for a prior: two or more are needed")]
    TooFewPeople(usize),
    /// What was recorded of other people does not fit.
    #[error(transparent)]
    Training(#[from] FitError),
}

/// Why nothing can be recognised without labels.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnlabelledError {
    /// Too few people to say how people differ.
    #[error(
        "{0} other people are too few to recognise a person without labels: give recordings of two or more whom you do not \
         score"
    )]
    TooFewPeople(usize),
    /// There is no gesture that all made.
    #[error("the other people have no gesture in common beside rest: leave out who made others")]
    NothingInCommon,
    /// Not everybody recorded the arm at rest.
    #[error("not all other people recorded rest, by which a person without labels is recognised")]
    NoRest,
    /// All orders of the gestures would be too many.
    #[error("{gestures} gestures are too many to be told apart without labels: at most {most}, with rest")]
    TooManyGestures {
        /// Gestures of the other people.
        gestures: usize,
        /// The most that are supported.
        most: usize,
    },
    /// Fewer windows of other people than the covariance needs.
    #[error("{windows} windows of other people are too few for windows of {length} features")]
    TooFewWindows {
        /// Windows that were given.
        windows: usize,
        /// Features of a window.
        length: usize,
    },
    /// The stream is too short to hold all gestures.
    #[error("{windows} windows are too few to find {gestures} gestures in: record for longer")]
    StreamTooShort {
        /// Windows of the stream.
        windows: usize,
        /// Gestures to be found.
        gestures: usize,
    },
    /// The windows do not fit.
    #[error(transparent)]
    Windows(#[from] FitError),
}
