"""Checks a data set of `tendon dataset build` against an implementation of its own, in NumPy and SciPy.

    python check_dataset.py DATASET        # NumPy 2, SciPy 1.16

From the files that the manifest names it makes everything anew: text, resampling, filter, envelope, onset, places of
the windows, windows. Onsets and places must be the same to the sample, windows to 1e-4 of the largest sample in them.
Of the split it checks that nobody and no sample is on both sides of the test, how many windows each part has, and what
the manifest says of those for training, to 1e-9.
"""

import json
import re
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import scipy.signal as ss

RECORDING_HZ = 1000


def filtered(signal: np.ndarray, settings: dict, rate_hz: float) -> np.ndarray:
    """Notch, then band-pass, as if the first sample had lasted for ever. Above half the rate there is nothing to cut."""
    notch = ss.tf2sos(*ss.iirnotch(settings["notch_hz"], settings["notch_quality"], fs=rate_hz))
    low, high = settings["band_pass_hz"]
    edges, kind = (low, "highpass") if high >= rate_hz / 2 else ([low, high], "bandpass")
    band = ss.butter(settings["band_pass_order"], edges, kind, fs=rate_hz, output="sos")
    for sections in (notch, band):
        start = ss.sosfilt_zi(sections) * signal[0]
        signal, _ = ss.sosfilt(sections, signal, zi=start)
    return signal


def moving_rms(signal: np.ndarray, length: int) -> np.ndarray:
    squares = np.concatenate([np.zeros(length), np.cumsum(signal.astype(np.float64) ** 2)])
    sums = squares[length:] - np.concatenate([np.zeros(length), squares[length:-length]])
    return np.sqrt(np.maximum(sums, 0) / length)


def onset(envelope: np.ndarray, settings: dict, rate_hz: float) -> int | None:
    def samples(ms: float) -> int:
        return round(ms * rate_hz / 1000)

    if settings["method"] == "baseline":
        rest = envelope[: samples(settings["baseline_ms"])]
        median = np.median(rest)
        threshold = median + settings["threshold_sigma"] * 1.4826 * np.median(np.abs(rest - median))
    else:
        threshold = np.percentile(envelope[ss.argrelmax(envelope)[0]], settings["peak_percentile"])
    above = envelope > threshold
    first, last = (samples(ms) for ms in settings["search_ms"])
    length = samples(settings["duration_ms"])
    for start in range(first, min(last, len(above)) - length + 1):
        if above[start : start + length].all():
            return start
    return None


def repetition_of(entry: dict) -> tuple:
    return entry["person"], entry["session"], entry["repetition"]


def check(dataset: Path) -> None:
    manifest = json.loads((dataset / "manifest.json").read_text())
    settings, entries = manifest["settings"], manifest["recordings"]
    windows = np.load(dataset / "windows.npy", mmap_mode="r")
    places = np.stack([np.load(dataset / "recordings.npy"), np.load(dataset / "starts.npy")], axis=1)
    rate_hz, channels = settings["sample_rate_hz"], settings["channels"]
    window, increment = settings["windows"]["window_samples"], settings["windows"]["increment_samples"]
    onsets = checked = 0
    worst = 0.0
    for _, group in groupby(enumerate(entries), key=lambda item: repetition_of(item[1])):
        group = list(group)
        first = Path(group[0][1]["file"])
        repetition = re.fullmatch(r"3dc_EMG_gesture_(\d+)_\d+\.txt", first.name)[1]
        # All gestures of the repetition follow on without a gap, those that no window is cut from among them.
        files = [first.with_name(f"3dc_EMG_gesture_{repetition}_{gesture}.txt") for gesture in range(11)]
        parts = {path: np.loadtxt(path, delimiter=",", ndmin=2)[:, channels] for path in files if path.exists()}
        whole = np.concatenate(list(parts.values()))
        if rate_hz != RECORDING_HZ:
            up, down = round(rate_hz / RECORDING_HZ), 1
            whole = ss.resample_poly(whole, up, down, axis=0, padtype="edge").astype(np.float32).astype(np.float64)
        if settings["filter"] is not None:
            whole = np.stack([filtered(channel, settings["filter"], rate_hz) for channel in whole.T], axis=1)
        whole = whole.astype(np.float32)
        ends = np.cumsum([round(len(part) * rate_hz / RECORDING_HZ) for part in parts.values()])
        spans = dict(zip(parts, zip([0, *ends[:-1]], ends)))
        for index, entry in group:
            signal = whole[slice(*spans[Path(entry["file"])])]
            assert len(signal) == entry["samples"], entry
            length = round(settings["onset"]["envelope_ms"] * rate_hz / 1000)
            envelopes = [moving_rms(channel, length) for channel in signal.T]
            start = round(settings["rest_start_ms"] * rate_hz / 1000)
            if entry["gesture"] != "rest":
                found = onset(max(envelopes, key=np.mean), settings["onset"], rate_hz)
                assert found == entry["onset_sample"], (found, entry)
                onsets += found is not None
                margin = round(settings["onset"]["margin_ms"] * rate_hz / 1000)
                fallback = round(settings["fallback_ms"] * rate_hz / 1000)
                start = fallback if found is None else max(0, found - margin)
            starts = np.arange(start, len(signal) - window + 1, increment)
            here = np.arange(entry["first_window"], entry["first_window"] + entry["windows"])
            assert len(starts) == len(here), (len(starts), entry)
            assert (places[here] == np.stack([np.full(len(here), index), starts], axis=1)).all(), entry
            content = signal.T if settings["input"] == "raw" else np.array(envelopes)
            for at, first_sample in zip(here, starts):
                expected = content[:, first_sample : first_sample + window]
                worst = max(worst, np.abs(windows[at] - expected).max() / np.abs(expected).max())
            checked += len(here)
    assert checked == manifest["windows"] == len(windows), (checked, manifest["windows"], len(windows))
    assert worst < 1e-4, worst
    print(f"{len(entries)} recordings, {onsets} onsets, {checked} windows: all the same; samples to {worst:.1e}")


def check_split(dataset: Path) -> None:
    manifest = json.loads((dataset / "manifest.json").read_text())
    split, entries = manifest["split"], manifest["recordings"]
    windows = np.load(dataset / "windows.npy", mmap_mode="r")
    splits, labels, people, recordings, starts = (
        np.load(dataset / f"{name}.npy") for name in ("splits", "labels", "people", "recordings", "starts")
    )
    training, validation, test = (splits == number for number in range(3))
    assert set(people[test]) == set(split["test_people"]), split
    assert set(people[~test]) == set(split["train_people"]), split
    assert not set(split["test_people"]) & set(split["train_people"]), split
    counts = {"train": training.sum(), "validation": validation.sum(), "test": test.sum()}
    assert counts == split["windows"], counts
    assert sum(counts.values()) == len(windows)

    # Which samples of each file are on which side.
    length = manifest["settings"]["windows"]["window_samples"]
    sides: dict[tuple, set] = {}
    for index in np.unique(recordings):
        of_recording = recordings == index
        entry = entries[index]
        for is_test in np.unique(test[of_recording]):
            for start in starts[of_recording & (test == is_test)]:
                first = entry["first_sample"] + int(start)
                sides.setdefault((entry["file"], bool(is_test)), set()).update(range(first, first + length))
    for file, is_test in sides:
        assert not is_test or not sides[file, True] & sides.get((file, False), set()), file

    statistics = manifest["training_statistics"]
    channels = windows.shape[1]
    total = np.zeros((3, channels))
    for gesture, found in statistics["per_gesture"].items():
        label = labels[next(entry["first_window"] for entry in entries if entry["gesture"] == gesture)]
        of_gesture = labels == label
        number = (of_gesture & ~test).sum()
        assert (of_gesture & validation).sum() == np.floor(split["validation_share"] * number + 0.5), gesture
        chosen = np.flatnonzero(of_gesture & training)
        assert found["windows"] == len(chosen), gesture
        sums = np.zeros((3, channels))
        for part in np.array_split(chosen, max(1, len(chosen) // 1000)):
            values = windows[part].astype(np.float64)
            sums += [values.sum((0, 2)), np.abs(values).sum((0, 2)), (values**2).sum((0, 2))]
        assert (np.abs(found["sum"] - sums[0]) <= 1e-9 * sums[1]).all(), gesture
        assert (np.abs(found["sum_of_squares"] - sums[2]) <= 1e-9 * sums[2]).all(), gesture
        total += sums
    count = training.sum() * length
    mean = total[0] / count
    sd = np.sqrt(total[2] / count - mean**2)
    assert (np.abs(statistics["channel_mean"] - mean) <= 1e-9 * total[1] / count).all()
    assert (np.abs(statistics["channel_sd"] - sd) <= 1e-9 * sd).all()
    print(f"split {split['windows']}, test people {split['test_people']}: no leak; statistics the same")


if __name__ == "__main__":
    check(Path(sys.argv[1]))
    check_split(Path(sys.argv[1]))
