"""A data set that `tendon dataset build` wrote, as examples to train on.

    windows.npy    float32 [n, channels, samples]     splits.npy      uint8  [n]  0 training, 1 validation, 2 test
    labels.npy     uint8   [n]  the gesture's number  recordings.npy  uint32 [n]  the window's recording
    people.npy     uint16  [n]                        manifest.json   settings, classes, sums of each gesture's training samples
"""

import json
from pathlib import Path

import numpy as np

GESTURES = ["rest", "extension", "flexion", "ulnar", "radial", "grip"]
# The paper's sets of classes, by name; any other set is given by the names of its gestures.
CLASS_SETS = {
    "six": GESTURES,
    "five": GESTURES[1:],
    "four": GESTURES[1:5],
    "rest-move": ["rest", "move"],
}
# Windows of a sequence for the LSTM (paper section "Classification Models").
SEQUENCE_WINDOWS = 5
TRAINING, VALIDATION, TEST = 0, 1, 2
# The filter of the paper's recordings, for a data set of recordings that came filtered.
PAPER_FILTER = {"notch_hz": 50.0, "notch_quality": 30.0, "band_pass_hz": [5.0, 500.0], "band_pass_order": 6}


def class_names(given: str) -> list[str]:
    """The classes of a named set, or of gestures separated by commas; ValueError if one is unknown."""
    names = CLASS_SETS.get(given) or given.split(",")
    for name in names:
        if name not in GESTURES and names != CLASS_SETS["rest-move"]:
            raise ValueError(f"`{name}` is not a gesture: use {', '.join(CLASS_SETS)}, or two or more of {', '.join(GESTURES)}")
    if len(set(names)) < 2 or len(set(names)) != len(names):
        raise ValueError(f"`{given}`: a classifier needs two or more different classes")
    return names


class Dataset:
    """Examples [n, channels, samples], or sequences of windows [n, windows, channels, samples], and their classes.

    An example is identified by its newest window, which also gives its class, person and split.
    """

    def __init__(self, folder: Path, classes: list[str], sequence_windows: int):
        manifest = folder / "manifest.json"
        if not manifest.is_file():
            raise SystemExit(f"{folder}: contains no complete data set; build one with `tendon dataset build`")
        self.manifest = json.loads(manifest.read_text())
        self.settings = self.manifest["settings"]
        self.settings["filter"] = self.settings["filter"] or PAPER_FILTER
        self.windows = np.load(folder / "windows.npy", mmap_mode="r")
        self.people = np.load(folder / "people.npy")
        if self.manifest.get("classes") not in (None, GESTURES):
            raise SystemExit(f"{folder}: its classes are {self.manifest['classes']}, not {GESTURES}: use the train.py of its version")
        self.sequence_windows = sequence_windows
        splits = np.load(folder / "splits.npy")
        recordings = np.load(folder / "recordings.npy")

        if classes == CLASS_SETS["rest-move"]:
            self.class_of_gesture = [0, 1, 1, 1, 1, 1]
        else:
            self.class_of_gesture = [classes.index(name) if name in classes else -1 for name in GESTURES]
        self.labels = np.array(self.class_of_gesture)[np.load(folder / "labels.npy")]

        before = sequence_windows - 1
        has_all = np.ones(len(recordings), dtype=bool)
        has_all[:before] = False
        has_all[before:] = recordings[before:] == recordings[: len(recordings) - before]
        used = has_all & (self.labels >= 0)
        self.training, self.validation, self.test = (
            np.flatnonzero(used & (splits == split)) for split in (TRAINING, VALIDATION, TEST)
        )
        for split, examples in (("training", self.training), ("validation", self.validation), ("test", self.test)):
            if len(examples) == 0:
                raise SystemExit(
                    f"{folder}: no {split} windows of {', '.join(classes)}; "
                    "build the data set with people held out, `tendon dataset build --test-people P,…`"
                )

    def who(self, number: int) -> str:
        """The person of this number in people.npy: their name, if they have one, or else the number."""
        return self.manifest.get("named_people", {}).get(str(number), str(number))

    @property
    def channel_names(self) -> list[str]:
        """Names of the channels in their order, numbers where the recordings give no names."""
        return self.manifest.get("channel_names") or [str(channel) for channel in self.settings["channels"]]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one example, as the network expects it."""
        return self.windows.shape[1:] if self.sequence_windows == 1 else (self.sequence_windows, *self.windows.shape[1:])

    def examples(self, newest: np.ndarray) -> np.ndarray:
        """The examples with these newest windows."""
        if self.sequence_windows == 1:
            return self.windows[newest]
        return self.windows[newest[:, None] + np.arange(1 - self.sequence_windows, 1)]

    def rest_rms(self) -> np.ndarray | None:
        """RMS of each channel over the training windows of rest, whatever the classes; None without any."""
        rest = self.manifest["training_statistics"]["per_gesture"].get("rest")
        if rest is None or rest["windows"] == 0:
            return None
        rms = np.sqrt(np.array(rest["sum_of_squares"]) / (rest["windows"] * self.windows.shape[2]))
        return rms if (rms > 0).all() else None

    def channel_statistics(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each channel over the training windows of the classes."""
        gestures = [name for name, label in zip(GESTURES, self.class_of_gesture) if label >= 0]
        per_gesture = self.manifest["training_statistics"]["per_gesture"]
        statistics = [per_gesture[name] for name in gestures if name in per_gesture]
        count = sum(entry["windows"] for entry in statistics) * self.windows.shape[2]
        mean = sum(np.array(entry["sum"]) for entry in statistics) / count
        variance = sum(np.array(entry["sum_of_squares"]) for entry in statistics) / count - mean**2
        return mean.astype(np.float32), np.sqrt(variance).astype(np.float32)
