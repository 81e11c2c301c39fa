"""Checks the three exports of one session against each other, through readers that are not part of Tendon.

    python3 -m venv /tmp/readers
    /tmp/readers/bin/pip install pandas edfio==0.4.18 pyedflib==0.1.42 pyxdf==1.17.5 bids-validator-deno==3.0.2
    tendon export SESSION --csv /tmp/tables --bids /tmp/study --xdf /tmp/session.xdf
    /tmp/readers/bin/python shared/export/tests/reference/check_export.py /tmp/tables /tmp/study /tmp/session.xdf

The data set must hold this one session. Without gaps, every sample of the BDF file is compared; with gaps, edfio reads its
records one after the other, and each part of the session is compared there.
"""

import json
import subprocess
import sys
from pathlib import Path

import edfio
import numpy as np
import pandas as pd
import pyedflib
import pyxdf


def check_xdf(file, signal, tables):
    streams, _ = pyxdf.load_xdf(file, dejitter_timestamps=False)
    by_type = {stream["info"]["type"][0]: stream for stream in streams}
    emg = by_type["EMG"]
    assert np.array_equal(emg["time_series"], signal.iloc[:, 1:].to_numpy(np.float32), equal_nan=True)
    times = emg["time_stamps"] - emg["time_stamps"][0]
    assert np.abs(times - signal.time_s).max() < 1e-6
    for name, table in [("Predictions", "predictions"), ("Decisions", "decisions"), ("Commands", "commands")]:
        stream, rows = by_type[name], pd.read_csv(tables / f"{table}.csv")
        assert len(stream["time_stamps"]) == len(rows)
        assert np.abs(stream["time_stamps"] - emg["time_stamps"][0] - rows.time_s).max() < 1e-6
    events = pd.read_csv(tables / "events.csv")
    assert len(by_type["Markers"]["time_series"]) == len(events)
    for stream in streams:
        assert int(stream["footer"]["info"]["sample_count"][0]) == len(stream["time_stamps"])


def check_bdf(file, signal, gaps, trials):
    recording = edfio.read_bdf(file)
    rate_hz = recording.signals[0].sampling_frequency
    ends = [int(np.searchsorted(signal.time_s, gap["end_s"] - 0.25 / rate_hz)) for gap in gaps] + [len(signal)]
    record_samples = round(recording.data_record_duration * rate_hz)
    start, place = 0, 0
    for end in ends:
        for channel, name in zip(recording.signals, signal.columns[1:]):
            expected = signal[name].to_numpy()[start:end]
            found = channel.data[place : place + end - start]
            digit = (channel.physical_max - channel.physical_min) / (2**24 - 1)
            is_number = np.isfinite(expected)
            assert np.abs(found - expected)[is_number].max() <= digit, name
        place += -(-(end - start) // record_samples) * record_samples
        start = end
    assert place == len(recording.signals[0].data)
    said = [annotation.text for annotation in recording.annotations]
    assert all(gesture in said for gesture in trials.gesture)
    if not gaps:
        with pyedflib.EdfReader(str(file)) as reader:
            assert reader.getNSamples()[0] == place


def main(tables, data_set, xdf):
    tables, data_set = Path(tables), Path(data_set)
    gaps = json.loads((tables / "session.json").read_text())["gaps"]
    signal = pd.read_csv(tables / "signal.csv")
    check_xdf(xdf, signal, tables)
    [bdf] = data_set.glob("sub-*/ses-*/emg/*_emg.bdf")
    check_bdf(bdf, signal, gaps, pd.read_csv(tables / "trials.csv"))
    validator = Path(sys.executable).parent / "bids-validator-deno"
    subprocess.run([validator, "--ignoreWarnings", data_set], check=True)
    print(f"{len(signal)} samples, {len(gaps)} gaps: the same in all three")


main(*sys.argv[1:])
