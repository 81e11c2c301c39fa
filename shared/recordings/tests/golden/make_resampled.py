"""Writes noise at 1925.926 Hz and what SciPy makes of it at 2000 Hz, for `shared/recordings/tests/resampled.rs`.

    pip install scipy==1.17.1 numpy==2.4.6
    python make_resampled.py

resampled.json: `input`, white noise between 20 and 450 Hz, of deviation 100; `expected`, its band-limited interpolation at
27/26 of the rate, by `scipy.signal.resample_poly` with a low-pass that is 25 times as long as SciPy's own. Prints how far that is
from `scipy.signal.resample` (by FFT) away from the edges: the two have to agree far below what is tested.
"""

import json
from pathlib import Path

import numpy as np
from scipy.signal import firwin, resample, resample_poly

UP, DOWN = 27, 26
RATE_HZ = 1925.926
SAMPLES = 40 * DOWN
# Of the output, at each end: less than the length of the long low-pass, more than that of Tendon.
EDGE = 200

here = Path(__file__).parent


def noise() -> np.ndarray:
    """Band-limited without a seam: so SciPy's FFT, which takes the signal for periodic, errs nowhere."""
    spectrum = np.fft.rfft(np.random.default_rng(1925).standard_normal(SAMPLES))
    hz = np.fft.rfftfreq(SAMPLES, 1 / RATE_HZ)
    spectrum[(hz < 20) | (hz > 450)] = 0
    samples = np.fft.irfft(spectrum, SAMPLES)
    return np.round(samples / samples.std() * 100, 4)


def decibels(error: np.ndarray, signal: np.ndarray) -> float:
    return 20 * np.log10(np.std(error) / np.std(signal))


def main() -> None:
    samples = noise()
    taps = firwin(500 * UP + 1, 1 / UP, window=("kaiser", 14.0)) * UP
    # Three periods, of which the middle one has no edge.
    expected = resample_poly(np.tile(samples, 3), UP, DOWN, window=taps / UP)
    length = SAMPLES * UP // DOWN
    expected = expected[length : 2 * length]
    by_fft = resample(samples, length)
    print(f"SciPy's two ways differ by {decibels(expected - by_fft, expected):.1f} dB")
    inner = slice(EDGE, -EDGE)
    usual = resample_poly(samples, UP, DOWN)
    print(f"resample_poly with its own low-pass: {decibels((usual - expected)[inner], expected[inner]):.1f} dB")
    golden = {
        "made_with": f"scipy {__import__('scipy').__version__}, numpy {np.__version__}",
        "rate_hz": RATE_HZ,
        "edge": EDGE,
        "input": samples.tolist(),
        "expected": [float(f"{value:.9g}") for value in expected],
    }
    (here / "resampled.json").write_text(json.dumps(golden) + "\n")


if __name__ == "__main__":
    main()
