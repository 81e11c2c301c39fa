//! The one conversion between an enum and the number that stands for it in a message.

/// Declares an enum that travels as a number: `ALL`, `number` and `from_number` follow from the declaration.
///
/// `from_number` gives `None` for a number that no sender of ours writes, or, where the declaration ends with
/// `otherwise Variant`, that variant: the harmless one.
macro_rules! numbered {
    ($(#[$meta:meta])* pub enum $name:ident {
        $($(#[$variant_meta:meta])* $variant:ident = $number:literal,)+
    } $(otherwise $fallback:ident)?) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum $name {
            $($(#[$variant_meta])* $variant = $number,)+
        }

        impl $name {
            /// All of them, in the order of their numbers.
            pub const ALL: [$name; [$($number),+].len()] = [$($name::$variant),+];

            /// The number that stands for it in a message.
            pub const fn number(self) -> u8 {
                self as u8
            }

            numbered!(@from_number $name $($fallback)?);
        }
    };
    (@from_number $name:ident) => {
        /// The one with this number; `None` for a number that no sender of ours writes.
        pub fn from_number(number: u8) -> Option<$name> {
            $name::ALL.into_iter().find(|one| one.number() == number)
        }
    };
    (@from_number $name:ident $fallback:ident) => {
        /// The one with this number. What no sender of ours writes is taken for the harmless one.
        pub fn from_number(number: u8) -> $name {
            $name::ALL.into_iter().find(|one| one.number() == number).unwrap_or($name::$fallback)
        }
    };
}

pub(crate) use numbered;

#[cfg(test)]
mod tests {
    use crate::{Activity, ArmPhase, Permission, Stage, StopReason};

    #[test]
    fn every_enum_is_found_by_its_number_and_a_foreign_number_is_harmless() {
        assert!(Stage::ALL.iter().all(|stage| Stage::from_number(stage.number()) == Some(*stage)));
        assert!(StopReason::ALL.iter().all(|why| StopReason::from_number(why.number()) == Some(*why)));
        assert!(Permission::ALL.iter().all(|one| Permission::from_number(one.number()) == *one));
        assert!(Activity::ALL.iter().all(|one| Activity::from_number(one.number()) == *one));
        assert!(ArmPhase::ALL.iter().all(|one| ArmPhase::from_number(one.number()) == *one));
        assert_eq!((Stage::from_number(77), StopReason::from_number(0)), (None, None));
        assert_eq!(Permission::from_number(77), Permission::Stopped);
        assert_eq!(Activity::from_number(77), Activity::Calibrating);
        assert_eq!(ArmPhase::from_number(77), ArmPhase::Connecting);
    }
}
