"""Makes the golden vectors beside this file, with SciPy and NumPy: python make_golden.py

Numbers are written with as many digits as a test of the stated tolerance needs.
"""

import json
import pathlib

import numpy as np
import scipy
import scipy.signal as ss

HERE = pathlib.Path(__file__).parent


def write(name, value):
    value["made_with"] = f"scipy {scipy.__version__}, numpy {np.__version__}"
    (HERE / name).write_text(json.dumps(value) + "\n")


def rounded(values, digits=9):
    return [float(f"{value:.{digits}g}") for value in np.ravel(values)]


def notch_section(frequency_hz, quality, rate_hz):
    return np.concatenate(ss.iirnotch(frequency_hz, quality, rate_hz))[None]


def design():
    notches, filters = [], []
    for rate_hz in (1000, 1259, 2000, 4000):
        for mains_hz in (50, 60):
            notches.append(
                {
                    "sample_rate_hz": rate_hz,
                    "frequency_hz": mains_hz,
                    "quality": 30,
                    "sos": notch_section(mains_hz, 30, rate_hz).tolist(),
                }
            )
        # Odd orders have real poles, narrow bands have none.
        for order, low_hz, high_hz in ((6, 5, 500), (6, 20, 450), (5, 5, 480), (1, 10, 400), (3, 100, 120), (4, 20, 300)):
            band = {"sample_rate_hz": rate_hz, "order": order, "low_hz": low_hz}
            if high_hz < rate_hz / 2:
                sos = ss.butter(order, [low_hz, high_hz], "bandpass", fs=rate_hz, output="sos")
                filters.append(band | {"high_hz": high_hz, "sos": sos.tolist()})
            sos = ss.butter(order, low_hz, "highpass", fs=rate_hz, output="sos")
            filters.append(band | {"high_hz": None, "sos": sos.tolist()})
    write("design.json", {"notches": notches, "filters": filters})


def emg(random, samples, rate_hz, offset, mains_hz):
    """An ADC's counts: offset and drift, mains with a harmonic, coloured noise that bursts."""
    t = np.arange(samples) / rate_hz
    burst = 0.2 + (np.sin(2 * np.pi * 2.1 * t) > 0.3)
    noise = ss.lfilter([1, 0.5], [1, -0.6], random.standard_normal(samples)) * burst
    mains = np.sin(2 * np.pi * mains_hz * t) + 0.2 * np.sin(6 * np.pi * mains_hz * t + 1)
    return np.round(offset + 150 * t + 200 * mains + 60 * noise).astype(np.float32)


def filtered(signal, rate_hz, mains_hz):
    sos = notch_section(mains_hz, 30, rate_hz)
    if rate_hz > 1000:
        band = ss.butter(6, [5, 500], "bandpass", fs=rate_hz, output="sos")
    else:
        band = ss.butter(6, 5, "highpass", fs=rate_hz, output="sos")
    sos = np.vstack([sos, band])
    signal = signal.astype(np.float64)
    return ss.sosfilt(sos, signal, zi=ss.sosfilt_zi(sos) * signal[0])[0]


def moving_rms(signal, length):
    squares = np.concatenate([np.zeros(length - 1), signal**2])
    return np.sqrt(np.lib.stride_tricks.sliding_window_view(squares, length).mean(axis=1))


def baseline(envelope):
    median = np.median(envelope)
    return median, 1.4826 * np.median(np.abs(envelope - median))


def streaming(random):
    cases = []
    for rate_hz, mains_hz, offset in ((1000, 50, -12000), (1259, 60, 8000), (2000, 60, 32000), (4000, 50, 30)):
        signal = emg(random, 700, rate_hz, offset, mains_hz)
        output = filtered(signal, rate_hz, mains_hz)
        length = round(0.025 * rate_hz)
        envelope = moving_rms(output.astype(np.float32).astype(np.float64), length)
        median, sigma = baseline(envelope)
        cases.append(
            {
                "sample_rate_hz": rate_hz,
                "notch_hz": mains_hz,
                "input": [int(value) for value in signal],
                "filtered": rounded(output),
                "envelope": rounded(envelope),
                "median": median,
                "sigma": sigma,
                "threshold": median + 2.5 * sigma,
            }
        )
    write("streaming.json", {"cases": cases})


def onset(signal, rate_hz, peak_percentile=None):
    """The first sample of the movement by the paper's methods: `signal` is [channels, samples]."""
    envelopes = np.array([moving_rms(channel, round(0.025 * rate_hz)) for channel in signal])
    envelope = envelopes[np.argmax(envelopes.mean(axis=1))]
    if peak_percentile is None:
        median, sigma = baseline(envelope[: round(0.5 * rate_hz)])
        threshold = median + 2.5 * sigma
    else:
        threshold = np.percentile(envelope[ss.argrelmax(envelope)[0]], peak_percentile)
    above = envelope > threshold
    duration = round(0.020 * rate_hz)
    for start in range(round(0.1 * rate_hz), min(round(1.0 * rate_hz), len(envelope)) - duration + 1):
        if above[start : start + duration].all():
            return start
    return None


def onsets(random):
    cases = []
    # Movement from so many ms on; -1: never, 0: from the start, 990: too late to last 20 ms by 1000 ms.
    for rate_hz, begins_ms in ((1000, 420), (1000, 700), (1000, -1), (1000, 0), (1000, 990), (400, 640)):
        samples = round(1.2 * rate_hz)
        signal = random.standard_normal((2, samples)) * [[3.0], [2.0]]
        if begins_ms >= 0:
            signal[1, round(begins_ms * rate_hz / 1000) :] *= 12
        # Fine enough that no two envelopes side by side are equal: where is the peak then?
        signal = np.round(signal, 3).astype(np.float32)
        cases.append(
            {
                "sample_rate_hz": rate_hz,
                "channels": 2,
                "signal": rounded(signal, 4),
                "onset": onset(signal.astype(np.float64), rate_hz),
                "onset_by_peaks": onset(signal.astype(np.float64), rate_hz, peak_percentile=80),
            }
        )
    write("onset.json", {"cases": cases})


def resample(random):
    cases = []
    for up, down in ((2, 1), (1, 2), (3, 2), (5, 7)):
        signal = np.round(random.standard_normal(150) * 100 + 500).astype(np.float32)
        half = 10 * max(up, down)
        taps = ss.firwin(2 * half + 1, 1 / max(up, down), window=("kaiser", 5.0)) * up
        output = ss.upfirdn(taps, signal.astype(np.float64), up, down)
        cases.append({"up": up, "down": down, "input": [int(value) for value in signal], "output": rounded(output, 10)})
    write("resample.json", {"cases": cases})


if __name__ == "__main__":
    design()
    generator = np.random.default_rng(20260101)
    streaming(generator)
    onsets(generator)
    resample(generator)
