"""What `tendon evaluate` does, in NumPy, SciPy and ONNX Runtime's Python package: the peer it is measured beside.

    python evaluate_numpy.py FOLDER… --model MODEL.onnx [--people 19,20,22] [--json FILE]    # NumPy 2, SciPy 1.17

From 3DC recordings to classes in one thread: text, resampling, filter, onset, windows, the model window by window. The
settings are the paper's, the filter is the model's. Each step is the fastest common way that gives the same result;
`time_s` says what each took. Not counted are the start of Python and the loading of the model.
"""

import os

# Before NumPy is loaded: one thread, as on our side.
os.environ.update({name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")})

import argparse
import json
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import onnxruntime as ort
import scipy.signal as ss

sys.path.append(str(Path(__file__).parents[2] / "shared/recordings/tests/reference"))
from check_dataset import RECORDING_HZ, moving_rms

CHANNELS = [0, 3, 5, 8]
COLUMNS = 10
GESTURES = 11
# The classes of gesture files 0, 1, …; the others are recorded but none of ours.
CLASSES = {0: "rest", 1: "radial", 2: "flexion", 3: "ulnar", 4: "extension", 7: "grip"}
RATE_HZ = 2000
WINDOW, INCREMENT = 600, 150
ENVELOPE, BASELINE, SEARCH, DURATION, MARGIN = 50, 1000, (200, 2000), 40, 100
THRESHOLD_SIGMA = 2.5
FALLBACK = REST_START = 1000


class Clock:
    """Time that each step takes, s: by the clock on the wall, and of the processor, for machines that are shared."""

    def __init__(self) -> None:
        self.wall_s, self.cpu_s = defaultdict(float), defaultdict(float)
        self.last = time.perf_counter(), time.process_time()

    def lap(self, step: str) -> None:
        now = time.perf_counter(), time.process_time()
        self.wall_s[step] += now[0] - self.last[0]
        self.cpu_s[step] += now[1] - self.last[1]
        self.last = now


def read(path: Path) -> np.ndarray:
    """The chosen channels of a file, [channels, samples]."""
    # Faster than loadtxt with usecols, and than anything that makes Python numbers.
    counts = np.fromstring(path.read_text().replace("\n", ","), dtype=np.int32, sep=",")
    return counts.reshape(-1, COLUMNS).T[CHANNELS].astype(np.float64)


def sections(settings: dict) -> np.ndarray:
    """Notch and band-pass as one cascade."""
    notch = ss.tf2sos(*ss.iirnotch(settings["notch_hz"], settings["notch_quality"], fs=RATE_HZ))
    order, edges = settings["band_pass_order"], settings["band_pass_hz"]
    return np.concatenate([notch, ss.butter(order, edges, "bandpass", fs=RATE_HZ, output="sos")])


def onset(envelope: np.ndarray) -> int | None:
    """As `check_dataset.onset` with the baseline method, without a loop over samples."""
    rest = envelope[:BASELINE]
    median = np.median(rest)
    threshold = median + THRESHOLD_SIGMA * 1.4826 * np.median(np.abs(rest - median))
    first, last = SEARCH
    above = np.concatenate([[0], np.cumsum(envelope[first:last] > threshold)])
    starts = np.flatnonzero(above[DURATION:] - above[:-DURATION] == DURATION)
    return first + int(starts[0]) if len(starts) else None


def start_of(name: str, signal: np.ndarray) -> int:
    """Where the first window of a file begins; `signal` is filtered, [channels, samples]."""
    if name == "rest":
        return REST_START
    envelopes = [moving_rms(channel, ENVELOPE) for channel in signal]
    found = onset(max(envelopes, key=np.mean))
    return FALLBACK if found is None else max(0, found - MARGIN)


def folders_of(path: Path, people: list[int]) -> list[Path]:
    """The folders ParticipantP/{train,test}/EMG at or below `path`, of these people, or of all if none are named."""
    found = [path] if path.name == "EMG" else sorted(path.rglob("EMG"))
    return [folder for folder in found if not people or person_of(folder) in people]


def person_of(folder: Path) -> int:
    return int(folder.resolve().parents[1].name.removeprefix("Participant"))


def evaluate(folders: list[Path], model: Path) -> dict:
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    classes = metadata["tendon.classes"].split(",")
    cascade = sections(json.loads(metadata["tendon.filter"]))
    steady = ss.sosfilt_zi(cascade)
    (window_input,) = (tensor.name for tensor in session.get_inputs())

    windows = correct = 0
    signal_s = used_s = 0.0
    clock = Clock()
    for folder in folders:
        for repetition in sorted({int(path.name.split("_")[3]) for path in folder.glob("3dc_EMG_gesture_*.txt")}):
            numbers = range(GESTURES)
            paths = {number: folder / f"3dc_EMG_gesture_{repetition}_{number}.txt" for number in numbers}
            parts = {number: read(path) for number, path in paths.items() if path.exists()}
            whole = np.concatenate(list(parts.values()), axis=1)
            clock.lap("read")
            whole = ss.resample_poly(whole, RATE_HZ // RECORDING_HZ, 1, axis=1, padtype="edge")
            clock.lap("resample")
            whole, _ = ss.sosfilt(cascade, whole, axis=1, zi=steady[:, None, :] * whole[:, :1])
            whole = whole.astype(np.float32)
            clock.lap("filter")
            signal_s += whole.shape[1] / RATE_HZ
            end = 0
            for number, part in parts.items():
                begin, end = end, end + part.shape[1] * RATE_HZ // RECORDING_HZ
                if CLASSES.get(number) not in classes:
                    continue
                truth = classes.index(CLASSES[number])
                signal = whole[:, begin:end]
                used_s += signal.shape[1] / RATE_HZ
                start = start_of(CLASSES[number], signal)
                clock.lap("onset")
                for first in range(start, signal.shape[1] - WINDOW + 1, INCREMENT):
                    window = np.ascontiguousarray(signal[None, :, first : first + WINDOW])
                    (probabilities,) = session.run(None, {window_input: window})
                    correct += int(probabilities.argmax()) == truth
                    windows += 1
                clock.lap("model")
    duration_s = sum(clock.wall_s.values())
    return {
        "model": str(model),
        "windows": windows,
        "correct": correct,
        "accuracy": correct / windows,
        "signal_s": signal_s,
        # Of the files that windows are cut from: the others are read and filtered only for what comes after them.
        "used_signal_s": used_s,
        "duration_s": duration_s,
        "x_real_time": signal_s / duration_s,
        "used_x_real_time": used_s / duration_s,
        "time_s": dict(clock.wall_s),
        "cpu_s": dict(clock.cpu_s),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="3DC folders: of people, of sessions, or above")
    parser.add_argument("--model", required=True, type=Path)
    parser.add_argument("--people", default="", help="only these, by number: 19,20,22")
    parser.add_argument("--json", type=Path, help="writes the result there")
    arguments = parser.parse_args()
    people = [int(number) for number in arguments.people.split(",") if number]
    folders = [found for given in arguments.folders for found in folders_of(given, people)]
    if not folders:
        parser.error("no folder ParticipantP/{train,test}/EMG of these people")
    result = evaluate(folders, arguments.model)
    print(f"{result['windows']} windows, {100 * result['accuracy']:.2f} % correct")
    cpu_s = sum(result["cpu_s"].values())
    for name in ("signal_s", "used_signal_s"):
        signal_s = result[name]
        print(
            f"{name} {signal_s:.0f} in {result['duration_s']:.2f} s: {signal_s / result['duration_s']:.0f} times faster "
            f"than real time; {signal_s / cpu_s:.0f} by the processor's time, {cpu_s:.2f} s"
        )
    print("of the processor: " + ", ".join(f"{step} {seconds:.2f} s" for step, seconds in result["cpu_s"].items()))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
