use std::io::Cursor;

use proptest::prelude::*;

use crate::mat::{MatError, MatFile};

/// Made by `tests/golden/make_mat73.py`, which says what they hold.
const AS_MATLAB: &[u8] = include_bytes!("../../../tests/golden/matlab73.mat");
const HDF5STORAGE: &[u8] = include_bytes!("../../../tests/golden/hdf5storage.mat");
const NEWER: &[u8] = include_bytes!("../../../tests/golden/newer.mat");

fn open(bytes: &[u8]) -> Result<MatFile<Cursor<&[u8]>>, MatError> {
    MatFile::open(Cursor::new(bytes))
}

fn refused(result: Result<Vec<Vec<f32>>, MatError>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn matrices_of_three_writers_are_read_to_the_last_digit() {
    for bytes in [AS_MATLAB, HDF5STORAGE, NEWER] {
        let mut mat = open(bytes).unwrap();
        assert_eq!(mat.shape("data").unwrap(), (6, 4));
        let column = |first: f32| (0..6).map(|row| first + 10.0 * row as f32).collect::<Vec<_>>();
        assert_eq!(mat.columns("data", &[2, 0]).unwrap(), [column(2.25), column(0.25)]);
        assert_eq!(mat.number("fs").unwrap(), Some(1259.2593));
        assert_eq!(mat.number("iD").unwrap(), Some(7.0));
        assert_eq!((mat.number("units").unwrap(), mat.number("none").unwrap()), (None, None));
        assert!(refused(mat.columns("data", &[4])).contains("no channel 4"));
        assert!(refused(mat.columns("units", &[0])).contains("`units` is text, not a matrix"));
    }
}

#[test]
fn pieces_that_are_shuffled_compressed_and_checked_are_joined() {
    for bytes in [AS_MATLAB, HDF5STORAGE] {
        let columns = open(bytes).unwrap().columns("long", &[2, 1, 0]).unwrap();
        for (values, column) in columns.iter().zip([2, 1, 0]) {
            let expected: Vec<f32> = (0..300).map(|row| (row * 7 % 251 - 100 * column) as f32).collect();
            assert_eq!(*values, expected, "column {column}");
        }
    }
}

#[test]
fn what_is_no_matrix_of_numbers_is_named_and_damages_nothing() {
    let mut mat = open(AS_MATLAB).unwrap();
    for (name, found) in [
        ("subject", "of the MATLAB class string"),
        ("cells", "a cell array"),
        ("head", "a structure"),
        ("cube", "an array of more than two dimensions"),
        ("wave", "a matrix of complex numbers"),
        ("empty", "empty"),
    ] {
        let expected = format!("variable `{name}` is {found}, not a matrix of real numbers");
        assert_eq!(refused(mat.columns(name, &[0])), expected);
    }
    assert!(refused(mat.columns("wide", &[0])).contains("transpose it"));
    assert!(refused(mat.columns("gap", &[0])).contains("sample 1 of channel 0 is not finite"));
    assert_eq!(mat.columns("gap", &[1]).unwrap(), [[1.0, 1.0]]);
    assert!(refused(mat.columns("partial", &[0])).contains("part of a variable was never written"));
    assert!(refused(mat.columns("squeezed", &[0])).contains("otherwise than by deflate"));
    let missing = refused(mat.columns("signal", &[0]));
    assert!(missing.contains("more39") && !missing.contains("#refs#"), "{missing}");
    assert_eq!(mat.number("more39").unwrap(), Some(39.0));
}

#[test]
fn a_changed_byte_of_the_values_fails_its_checksum() {
    let fails = |place: &usize| {
        let mut bytes = AS_MATLAB.to_vec();
        bytes[*place] ^= 0x10;
        let columns = open(&bytes).and_then(|mut mat| mat.columns("long", &[0, 1, 2]));
        columns.is_err_and(|error| error.to_string().contains("a checksum differs"))
    };
    // The compressed values have 1051 bytes.
    assert!((0..AS_MATLAB.len()).step_by(23).filter(fails).count() > 40);
}

#[test]
fn a_file_that_was_cut_off_is_refused() {
    for bytes in [AS_MATLAB, HDF5STORAGE, NEWER] {
        for length in (0..bytes.len()).step_by(7) {
            let cut = open(&bytes[..length]).and_then(|mut mat| mat.columns("data", &[0, 3]));
            if let Ok(columns) = cut {
                assert_eq!(columns, open(bytes).unwrap().columns("data", &[0, 3]).unwrap(), "{length}");
            }
        }
        assert!(open(&bytes[..bytes.len() / 3]).is_err());
    }
}

proptest! {
    #[test]
    fn no_damage_makes_it_panic(
        which in 0..3_usize,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = [AS_MATLAB, HDF5STORAGE, NEWER][which].to_vec();
        for (place, value) in damage {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(mut mat) = open(&bytes) {
            for name in ["data", "long", "fs", "cells", "partial"] {
                let _ = mat.number(name);
                if let Ok(columns) = mat.columns(name, &[0, 1]) {
                    prop_assert!(columns.iter().flatten().all(|sample| sample.is_finite()));
                }
            }
        }
    }
}
