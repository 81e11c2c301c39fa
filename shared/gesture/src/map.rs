//! What gestures do.
//!
//! ```text
//! [[decision.modes]]
//! name = "y-z"
//! extension = "+z"                                                     along an axis of the base
//! ulnar = { motion = "+yaw", frame = "tool", speed_deg_per_s = 10.0 }  about an axis of the tool
//! grip = "gripper"
//! fist = "next_mode"                                                   what gestures do then, the next table says
//! ```
//!
//! A gesture that a mode does not name does nothing in it, and rest never does anything.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::{Gesture, GestureSet};

/// Most modes.
pub const MAXIMUM_MODES: usize = 8;

/// An axis of a frame: along x, y, z, or about them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
    /// About x.
    Roll,
    /// About y.
    Pitch,
    /// About z.
    Yaw,
}

impl Axis {
    const ALL: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::Roll, Axis::Pitch, Axis::Yaw];

    /// The component of a twist: 0 to 2 along x, y, z, 3 to 5 about them.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Whether it is a rotation.
    pub const fn is_rotation(self) -> bool {
        matches!(self, Axis::Roll | Axis::Pitch | Axis::Yaw)
    }

    const fn name(self) -> &'static str {
        match self {
            Axis::X => "x",
            Axis::Y => "y",
            Axis::Z => "z",
            Axis::Roll => "roll",
            Axis::Pitch => "pitch",
            Axis::Yaw => "yaw",
        }
    }
}

/// Whose axes are meant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Frame {
    /// Those of the arm's base, which stand still.
    #[default]
    Base,
    /// Those of the flange, which turn with it.
    Tool,
}

impl Frame {
    const fn name(self) -> &'static str {
        match self {
            Frame::Base => "base",
            Frame::Tool => "tool",
        }
    }
}

/// An axis and the way along or about it: `+z`, `-roll`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Direction {
    /// The axis.
    pub axis: Axis,
    /// Against the axis.
    pub is_negative: bool,
}

/// What is no direction.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no motion: take one of +x, -x, +y, -y, +z, -z, +roll, -roll, +pitch, -pitch, +yaw, -yaw")]
pub struct NoDirection(String);

impl FromStr for Direction {
    type Err = NoDirection;

    fn from_str(text: &str) -> Result<Direction, NoDirection> {
        let (is_negative, name) = match text.split_at_checked(1) {
            Some(("+", name)) => (false, name),
            Some(("-", name)) => (true, name),
            _ => return Err(NoDirection(text.to_owned())),
        };
        let axis = Axis::ALL.into_iter().find(|axis| axis.name() == name);
        axis.map(|axis| Direction { axis, is_negative }).ok_or_else(|| NoDirection(text.to_owned()))
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}{}", if self.is_negative { '-' } else { '+' }, self.axis.name())
    }
}

/// A motion of the arm while a gesture is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The way.
    pub direction: Direction,
    /// Whose axis.
    pub frame: Frame,
    /// Its own speed in mm/s, or degrees/s of a rotation; `None` for the one that all motions have.
    pub speed: Option<f64>,
}

/// What a gesture does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ActionInFile", into = "ActionInFile")]
pub enum Action {
    /// Nothing.
    Nothing,
    /// Moves the arm.
    Move(Motion),
    /// Opens or closes the gripper.
    Gripper,
    /// Goes to the next mode.
    NextMode,
}

/// An action as it stands in a configuration.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
enum ActionInFile {
    Name(String),
    Motion(MotionInFile),
}

/// By hand, because serde says of a value that fits no variant neither what is wrong with it nor where it stands.
impl<'de> Deserialize<'de> for ActionInFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ActionInFile, D::Error> {
        struct WordOrTable;

        impl<'de> Visitor<'de> for WordOrTable {
            type Value = ActionInFile;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(
                    "an action, such as \"+z\", \"gripper\" or { motion = \"+z\", frame = \"tool\" }",
                )
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<ActionInFile, E> {
                Ok(ActionInFile::Name(name.to_owned()))
            }

            fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<ActionInFile, A::Error> {
                Ok(ActionInFile::Motion(MotionInFile::deserialize(MapAccessDeserializer::new(table))?))
            }
        }

        deserializer.deserialize_any(WordOrTable)
    }
}

/// The frame where none is named.
fn base() -> String {
    Frame::Base.name().to_owned()
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MotionInFile {
    motion: String,
    #[serde(default = "base")]
    frame: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    speed_mm_per_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    speed_deg_per_s: Option<f64>,
}

/// What cannot be the action of a gesture.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoAction {
    /// A word that means nothing.
    #[error(
        "`{0}` is no action: take a motion (+x, -x, +y, -y, +z, -z, +roll, -roll, +pitch, -pitch, +yaw, -yaw), \
         gripper, next_mode or nothing"
    )]
    Name(String),
    /// A motion that means nothing.
    #[error(transparent)]
    Motion(#[from] NoDirection),
    /// A frame that there is not.
    #[error("`{0}` is no frame: take base or tool")]
    Frame(String),
    /// A speed in the wrong unit.
    #[error("{direction} has its speed in {right}, not in {wrong}")]
    Unit {
        /// The motion.
        direction: String,
        /// The key that fits it.
        right: &'static str,
        /// The key that does not.
        wrong: &'static str,
    },
}

impl TryFrom<ActionInFile> for Action {
    type Error = NoAction;

    fn try_from(action: ActionInFile) -> Result<Action, NoAction> {
        match action {
            ActionInFile::Name(name) => match name.as_str() {
                "nothing" => Ok(Action::Nothing),
                "gripper" => Ok(Action::Gripper),
                "next_mode" => Ok(Action::NextMode),
                _ => match name.parse() {
                    Ok(direction) => {
                        Ok(Action::Move(Motion { direction, frame: Frame::default(), speed: None }))
                    }
                    Err(_) => Err(NoAction::Name(name)),
                },
            },
            ActionInFile::Motion(MotionInFile { motion, frame, speed_mm_per_s, speed_deg_per_s }) => {
                let direction: Direction = motion.parse()?;
                let (right, wrong) = ("speed_mm_per_s", "speed_deg_per_s");
                let (right, wrong, speed, other) = if direction.axis.is_rotation() {
                    (wrong, right, speed_deg_per_s, speed_mm_per_s)
                } else {
                    (right, wrong, speed_mm_per_s, speed_deg_per_s)
                };
                if other.is_some() {
                    return Err(NoAction::Unit { direction: direction.to_string(), right, wrong });
                }
                let frame = [Frame::Base, Frame::Tool]
                    .into_iter()
                    .find(|known| known.name() == frame)
                    .ok_or(NoAction::Frame(frame))?;
                Ok(Action::Move(Motion { direction, frame, speed }))
            }
        }
    }
}

impl From<Action> for ActionInFile {
    fn from(action: Action) -> ActionInFile {
        match action {
            Action::Nothing => ActionInFile::Name("nothing".to_owned()),
            Action::Gripper => ActionInFile::Name("gripper".to_owned()),
            Action::NextMode => ActionInFile::Name("next_mode".to_owned()),
            Action::Move(Motion { direction, frame: Frame::Base, speed: None }) => {
                ActionInFile::Name(direction.to_string())
            }
            Action::Move(Motion { direction, frame, speed }) => {
                let of = |is_rotation| speed.filter(|_| direction.axis.is_rotation() == is_rotation);
                ActionInFile::Motion(MotionInFile {
                    motion: direction.to_string(),
                    frame: frame.name().to_owned(),
                    speed_mm_per_s: of(false),
                    speed_deg_per_s: of(true),
                })
            }
        }
    }
}

/// What each gesture does, until the mode changes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mode {
    /// Shown while it is on: `y-z`, `wrist`.
    pub name: String,
    /// By gesture.
    #[serde(flatten)]
    pub actions: BTreeMap<Gesture, Action>,
}

impl Mode {
    /// Leaves out what gestures do that are not among these.
    pub fn keep(&mut self, gestures: &GestureSet) {
        self.actions.retain(|gesture, _| gestures.number(*gesture).is_some());
    }
}

/// A key of a mode's table.
#[derive(Deserialize)]
#[serde(try_from = "String")]
enum ModeKey {
    Name,
    Gesture(Gesture),
}

impl TryFrom<String> for ModeKey {
    type Error = <Gesture as TryFrom<String>>::Error;

    fn try_from(key: String) -> Result<ModeKey, Self::Error> {
        if key == "name" { Ok(ModeKey::Name) } else { Gesture::try_from(key).map(ModeKey::Gesture) }
    }
}

/// By hand, because serde forgets the lines of what it flattens: an error in the second mode would be shown in the first.
impl<'de> Deserialize<'de> for Mode {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Mode, D::Error> {
        struct Table;

        impl<'de> Visitor<'de> for Table {
            type Value = Mode;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a table with a name and what gestures do")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut table: A) -> Result<Mode, A::Error> {
                let (mut name, mut actions) = (None, BTreeMap::new());
                while let Some(key) = table.next_key()? {
                    match key {
                        ModeKey::Name => name = Some(table.next_value()?),
                        ModeKey::Gesture(gesture) => drop(actions.insert(gesture, table.next_value()?)),
                    }
                }
                Ok(Mode { name: name.ok_or_else(|| de::Error::missing_field("name"))?, actions })
            }
        }

        deserializer.deserialize_map(Table)
    }
}

/// The paper's table of gestures.
impl Default for Mode {
    fn default() -> Mode {
        let along = |axis, is_negative| {
            let direction = Direction { axis, is_negative };
            Action::Move(Motion { direction, frame: Frame::Base, speed: None })
        };
        Mode {
            name: "y-z".to_owned(),
            actions: BTreeMap::from([
                (Gesture::EXTENSION, along(Axis::Z, false)),
                (Gesture::FLEXION, along(Axis::Z, true)),
                (Gesture::ULNAR, along(Axis::Y, false)),
                (Gesture::RADIAL, along(Axis::Y, true)),
                (Gesture::GRIP, Action::Gripper),
            ]),
        }
    }
}

/// What is wrong with the modes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidModes {
    /// None, or too many.
    #[error("modes: {0} of them; take 1 to 8")]
    Count(usize),
    /// A mode without a name, with a long one, or with one that would disturb a terminal.
    #[error("modes: the name `{}`; take 1 to 16 characters that can be shown", .0.escape_debug())]
    Name(String),
    /// Two of one name.
    #[error("modes: two have the name `{0}`; give each its own")]
    Twice(String),
    /// A gesture that nobody makes.
    #[error(
        "mode `{mode}`: the session has no gesture `{gesture}`; its gestures are {}",
        .known.iter().map(Gesture::name).collect::<Vec<_>>().join(", ")
    )]
    Gesture {
        /// The mode.
        mode: String,
        /// The gesture.
        gesture: Gesture,
        /// Those of the session.
        known: Vec<Gesture>,
    },
    /// Something for rest to do.
    #[error("mode `{0}`: rest does nothing; give the action to another gesture")]
    Rest(String),
    /// A mode that nothing leads out of, or a change where there is nothing to change to.
    #[error("mode `{mode}`: {problem}")]
    Change {
        /// The mode.
        mode: String,
        /// What is wrong, and the remedy.
        problem: &'static str,
    },
    /// A speed that cannot be.
    #[error("mode `{mode}`: {gesture} has the speed {speed}; take more than 0, at most {limit} {unit}")]
    Speed {
        /// The mode.
        mode: String,
        /// The gesture.
        gesture: Gesture,
        /// Its speed.
        speed: f64,
        /// The largest.
        limit: f64,
        /// Its unit.
        unit: &'static str,
    },
}

/// Fastest motion that a configuration may ask for; the arm's own limits are lower.
const FASTEST_MM_PER_S: f64 = 1000.0;
const FASTEST_DEG_PER_S: f64 = 180.0;

/// Checks the modes for a session with these gestures. `has_long_grip`: a long grip changes the mode.
pub(crate) fn check_modes(
    modes: &[Mode],
    gestures: &GestureSet,
    has_long_grip: bool,
) -> Result<(), InvalidModes> {
    if !(1..=MAXIMUM_MODES).contains(&modes.len()) {
        return Err(InvalidModes::Count(modes.len()));
    }
    for (place, mode) in modes.iter().enumerate() {
        if !(1..=16).contains(&mode.name.chars().count()) || mode.name.chars().any(char::is_control) {
            return Err(InvalidModes::Name(mode.name.clone()));
        }
        if modes[..place].iter().any(|other| other.name == mode.name) {
            return Err(InvalidModes::Twice(mode.name.clone()));
        }
        check_mode(mode, gestures)?;
        let has = |wanted: Action| mode.actions.values().any(|action| *action == wanted);
        let changes = has(Action::NextMode) || (has_long_grip && has(Action::Gripper));
        let problem = match (modes.len(), changes) {
            (1, _) if has(Action::NextMode) => {
                Some("there is no other mode to go to: add one, or take another action")
            }
            (2.., false) => Some(
                "no gesture leads out of it: map one to next_mode, or one to gripper and set long_grip_s",
            ),
            _ => None,
        };
        if let Some(problem) = problem {
            return Err(InvalidModes::Change { mode: mode.name.clone(), problem });
        }
    }
    Ok(())
}

fn check_mode(mode: &Mode, gestures: &GestureSet) -> Result<(), InvalidModes> {
    for (&gesture, action) in &mode.actions {
        if gestures.number(gesture).is_none() {
            let known = gestures.iter().collect();
            return Err(InvalidModes::Gesture { mode: mode.name.clone(), gesture, known });
        }
        if gesture == Gesture::REST && *action != Action::Nothing {
            return Err(InvalidModes::Rest(mode.name.clone()));
        }
        let Action::Move(Motion { direction, speed: Some(speed), .. }) = *action else { continue };
        let (limit, unit) = match direction.axis.is_rotation() {
            true => (FASTEST_DEG_PER_S, "deg/s"),
            false => (FASTEST_MM_PER_S, "mm/s"),
        };
        if !(speed > 0.0 && speed <= limit) {
            return Err(InvalidModes::Speed { mode: mode.name.clone(), gesture, speed, limit, unit });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn modes(text: &str) -> Result<Vec<Mode>, String> {
        #[derive(Deserialize)]
        struct File {
            modes: Vec<Mode>,
        }
        toml::from_str(text).map(|file: File| file.modes).map_err(|error| error.message().to_owned())
    }

    #[test]
    fn actions_are_words_or_tables_and_read_back_as_written() {
        let text = "[[modes]]\nname = \"wrist\"\nextension = \"-pitch\"\ngrip = \"gripper\"\nradial = \"nothing\"\n\
                    ulnar = { motion = \"+x\", frame = \"tool\", speed_mm_per_s = 20.0 }\nfist = \"next_mode\"\n";
        let read = modes(text).unwrap();
        let motion = |axis, is_negative, frame, speed| {
            Action::Move(Motion { direction: Direction { axis, is_negative }, frame, speed })
        };
        let actions = &read[0].actions;
        assert_eq!(actions[&Gesture::EXTENSION], motion(Axis::Pitch, true, Frame::Base, None));
        assert_eq!(actions[&Gesture::ULNAR], motion(Axis::X, false, Frame::Tool, Some(20.0)));
        assert_eq!(actions[&Gesture::GRIP], Action::Gripper);
        assert_eq!(actions[&"fist".parse().unwrap()], Action::NextMode);
        let written = toml::to_string(&BTreeMap::from([("modes", &read)])).unwrap();
        assert_eq!(modes(&written).unwrap(), read);
    }

    #[test]
    fn what_is_no_action_is_refused_in_words() {
        for (action, part) in [
            ("\"up\"", "`up` is no action: take a motion"),
            ("\"z\"", "`z` is no action"),
            ("\"\"", "`` is no action"),
            ("{ motion = \"+w\" }", "`+w` is no motion"),
            ("{ motion = \"+z\", frame = \"flange\" }", "`flange` is no frame: take base or tool"),
            ("{ motion = \"+z\", speed_deg_per_s = 5.0 }", "+z has its speed in speed_mm_per_s"),
            ("{ motion = \"+yaw\", speed_mm_per_s = 5.0 }", "+yaw has its speed in speed_deg_per_s"),
            ("{ motion = \"+z\", sped = 5.0 }", "unknown field `sped`"),
            ("5", "invalid type: integer `5`, expected an action, such as"),
        ] {
            let message = modes(&format!("[[modes]]\nname = \"a\"\ngrip = {action}\n")).unwrap_err();
            assert!(message.contains(part), "{action}: {message}");
        }
    }

    #[test]
    fn modes_that_cannot_work_are_refused_by_name() {
        let check = |text: &str, has_long_grip| {
            check_modes(&modes(text).unwrap(), &GestureSet::default(), has_long_grip)
                .err()
                .map_or(String::new(), |error| error.to_string())
        };
        let two =
            "[[modes]]\nname = \"a\"\ngrip = \"gripper\"\n[[modes]]\nname = \"b\"\ngrip = \"gripper\"\n";
        assert_eq!(check(two, true), "");
        for (text, part) in [
            ("modes = []", "0 of them; take 1 to 8"),
            ("[[modes]]\nname = \"\"\n", "take 1 to 16 characters"),
            (
                "[[modes]]\nname = \"a\\u001b[2J\"\n",
                "the name `a\\u{1b}[2J`; take 1 to 16 characters that can be shown",
            ),
            (
                "[[modes]]\nname = \"a\"\nfist = \"+z\"\n",
                "the session has no gesture `fist`; its gestures are rest,",
            ),
            ("[[modes]]\nname = \"a\"\nrest = \"+z\"\n", "rest does nothing"),
            ("[[modes]]\nname = \"a\"\ngrip = \"next_mode\"\n", "there is no other mode"),
            (two, "no gesture leads out of it"),
            (&two.replace("\"b\"", "\"a\""), "no gesture leads out of it"),
            (
                "[[modes]]\nname = \"a\"\ngrip = { motion = \"+z\", speed_mm_per_s = -1.0 }\n",
                "grip has the speed -1; take more than 0, at most 1000 mm/s",
            ),
        ] {
            let message = check(text, false);
            assert!(message.contains(part), "{text}: {message}");
        }
        assert!(check(&two.replace("\"b\"", "\"a\""), true).contains("two have the name `a`"));
    }
}
