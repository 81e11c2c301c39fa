"""Writes small MAT-files of version 7.3: one as MATLAB lays them out, by h5py; one by hdf5storage; one in HDF5's newer form.

    python make_mat73.py        # NumPy 2, h5py 3.16, hdf5storage 0.2

All hold `data` 6 × 4 (10 row + column + 0.25), `fs` 1259.2593, `iD` 7 and variables that are no matrices. `long`, of the first
two, is 300 × 3 of whole numbers (row × 7 % 251 - 100 × column); in the first it lies in pieces that do not divide it evenly.
"""

from pathlib import Path

import h5py
import hdf5storage
import numpy as np

here = Path(__file__).parent
rows, columns = np.arange(6)[:, None], np.arange(4)[None, :]
data = 10.0 * rows + columns + 0.25
rows, columns = np.arange(300)[:, None], np.arange(3)[None, :]
long = (rows * 7 % 251 - 100 * columns).astype(np.int16)


def as_matlab(file, name, values, matlab_class, **storage):
    """MATLAB's columns are HDF5's rows."""
    variable = file.create_dataset(name, data=np.atleast_2d(values).T, **storage)
    variable.attrs["MATLAB_class"] = np.bytes_(matlab_class)
    return variable


def variables(file, **storage):
    as_matlab(file, "data", data, "double", **storage)
    as_matlab(file, "fs", 1259.2593, "double")
    as_matlab(file, "iD", np.uint8(7), "uint8")
    text = as_matlab(file, "units", np.frombuffer("mV".encode("utf-16-le"), "u2")[None, :], "char")
    text.attrs["MATLAB_int_decode"] = np.int32(2)
    subject = as_matlab(file, "subject", np.zeros((1, 6), "u4"), "string")
    subject.attrs["MATLAB_object_decode"] = np.int32(3)
    empty = file.create_dataset("empty", data=np.zeros(2, "u8"))
    empty.attrs["MATLAB_class"] = np.bytes_("double")
    empty.attrs["MATLAB_empty"] = np.uint8(1)


with h5py.File(here / "matlab73.mat", "w", userblock_size=512) as file:
    variables(file, chunks=(2, 4), compression=3)
    as_matlab(file, "long", long, "int16", chunks=(2, 128), compression=3, shuffle=True, fletcher32=True)
    as_matlab(file, "wide", np.ones((2, 3), "f4"), "single")
    as_matlab(file, "gap", np.array([[1.0, 1.0], [np.nan, 1.0]], "f4"), "single")
    as_matlab(file, "cube", np.ones((2, 2, 2)), "double")
    as_matlab(file, "wave", np.ones((3, 1), [("real", "f8"), ("imag", "f8")]), "double")
    file.create_dataset("partial", shape=(1, 300), dtype="f8", chunks=(1, 128))[0, :128] = 1.0
    file.create_dataset("squeezed", data=np.ones((1, 300)), chunks=(1, 128), compression="lzf")
    as_matlab(file, "cells", np.array([[file["fs"].ref]], h5py.ref_dtype), "cell")
    head = file.create_group("head")
    head.attrs["MATLAB_class"] = np.bytes_("struct")
    file.create_group("#refs#").create_dataset("a", data=1.0)
    # So many variables that the tree of their names has several nodes.
    for number in range(40):
        as_matlab(file, f"more{number}", float(number), "double")
with open(here / "matlab73.mat", "r+b") as file:
    file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")

with h5py.File(here / "newer.mat", "w", userblock_size=512, libver="latest") as file:
    variables(file)
with open(here / "newer.mat", "r+b") as file:
    file.write(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM")

(here / "hdf5storage.mat").unlink(missing_ok=True)
hdf5storage.savemat(
    str(here / "hdf5storage.mat"),
    {"data": data, "fs": 1259.2593, "iD": np.uint8(7), "units": "mV", "long": long, "cells": [1, 2]},
    format="7.3",
)
