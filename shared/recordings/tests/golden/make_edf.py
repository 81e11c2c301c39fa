"""Writes small EDF and BDF files with edfio and pyedflib, to be read by `shared/recordings/src/edf.rs`.

    pip install edfio==0.4.18 pyedflib==0.1.42 numpy
    python make_edf.py

- delsys.bdf (edfio): BDF+C, two EMG signals of 26 samples in 0.0135 s (1925.926 Hz) and one of acceleration with 2, sub-second
  start, annotations with and without a duration.
- plain.edf (pyedflib): EDF+C, two signals in uV and mV at 200 Hz, an annotation.
Sample n of signal s is 100 (s + 1) sin(2 pi (s + 1) n / 40) in its unit.
"""

import datetime
from pathlib import Path

import numpy as np
from edfio import Bdf, BdfSignal, EdfAnnotation
from pyedflib import FILETYPE_EDFPLUS, EdfWriter

here = Path(__file__).parent


def samples(signal: int, count: int) -> np.ndarray:
    return 100.0 * (signal + 1) * np.sin(2 * np.pi * (signal + 1) * np.arange(count) / 40)


def delsys() -> None:
    records, record_s = 40, 0.0135
    emg = [
        BdfSignal(samples(s, 26 * records), 26 / record_s, label=f"EMG {name}", physical_dimension="uV", physical_range=(-5000, 5000))
        for s, name in enumerate(["flexor", "extensor"])
    ]
    acceleration = BdfSignal(
        samples(2, 2 * records), 2 / record_s, label="ACC X", physical_dimension="g", physical_range=(-500, 500)
    )
    annotations = [EdfAnnotation(0.1, 0.135, "Fist"), EdfAnnotation(0.3, None, "rest"), EdfAnnotation(0.4, None, "Recording paused")]
    bdf = Bdf(
        [emg[0], acceleration, emg[1]],
        starttime=datetime.time(12, 0, 0, 250000),
        data_record_duration=record_s,
        annotations=annotations,
    )
    bdf.write(here / "delsys.bdf")


def plain() -> None:
    with EdfWriter(str(here / "plain.edf"), 2, file_type=FILETYPE_EDFPLUS) as edf:
        for signal, unit in enumerate(["uV", "mV"]):
            edf.setSignalHeader(signal, {
                "label": f"EMG{signal + 1}", "dimension": unit, "sample_frequency": 200, "physical_min": -1000, "physical_max": 1000,
                "digital_min": -32768, "digital_max": 32767, "transducer": "", "prefilter": "",
            })
        edf.writeSamples([samples(signal, 400) for signal in range(2)])
        edf.writeAnnotation(0.5, 1.0, "grip")


delsys()
plain()
