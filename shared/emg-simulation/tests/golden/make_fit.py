"""Writes fit.json: two channels of noise with mains hum, and the profile that NumPy and SciPy find in them.

    python make_fit.py     # NumPy 2.4, SciPy 1.17

The definition in the crate's documentation of `fit`, written a second time.
"""

import json
from pathlib import Path

import numpy as np
from scipy import signal

RATE_HZ, FRAME, MAINS_HZ = 1000, 256, 60
FREQUENCIES_HZ = [5, 15, 25, 35, 45, 60, 75, 90, 105, 120, 140, 160, 180, 200, 230, 260, 300, 340, 380, 420, 460, 500]

rng = np.random.default_rng(3)
common = signal.lfilter([1], [1, -0.6], rng.standard_normal(1030))
hum = 30 * np.sin(2 * np.pi * MAINS_HZ * np.arange(1024) / RATE_HZ)
first = 100 * common[6:] + 40 * rng.standard_normal(1024) + hum
second = 60 * common[4:-2] + 50 * rng.standard_normal(1024) + hum
samples = np.round(np.stack([first, second])).astype(int)

starts = range(0, samples.shape[1] - FRAME + 1, FRAME // 2)
frames = np.stack([samples[:, start : start + FRAME] for start in starts]).astype(float)
frames -= frames.mean(axis=2, keepdims=True)
window = signal.get_window("hann", FRAME)  # periodic
spectra = np.fft.rfft(frames * window, axis=2) * np.sqrt(2 / ((window**2).sum() * FRAME))
bins_hz = np.fft.rfftfreq(FRAME, 1 / RATE_HZ)
bin_hz = bins_hz[1]
harmonic = np.maximum(1, np.round(bins_hz / MAINS_HZ))
usable = np.abs(bins_hz - harmonic * MAINS_HZ) >= 2 * bin_hz
power = (np.abs(spectra[:, :, usable & (bins_hz >= 8)]) ** 2).sum(axis=2)
normalised = spectra / np.sqrt(power)[:, :, None]
cross = np.einsum("kif,kjf->ijf", normalised, normalised.conj()) / len(frames)


def weights(at: int) -> np.ndarray:
    """Weights of the bins around one frequency: 1 there, 0 at its neighbours (0 Hz before the first) and at mains."""
    corners = [0, *FREQUENCIES_HZ][at : at + 3]
    heights = [float(corner == FREQUENCIES_HZ[at]) for corner in corners]
    hat = np.interp(bins_hz, corners, heights) * usable
    return hat / hat.sum()


means = np.einsum("ijf,af->ija", cross, np.array([weights(at) for at in range(len(FREQUENCIES_HZ))]))
own = np.einsum("iia->ia", means).real
density = np.sqrt(own * np.exp(np.log(power).mean(axis=0))[:, None] / bin_hz)
coherency = means[0, 1] / np.sqrt(own[0] * own[1])

golden = {
    "samples": samples.tolist(),
    "amplitude_density": density.tolist(),
    "coherency_real": coherency.real.tolist(),
    "coherency_imaginary": coherency.imag.tolist(),
}
Path(__file__).with_name("fit.json").write_text(json.dumps(golden))
