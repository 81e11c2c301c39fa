"""Writes a small XDF file byte by byte and checks with pyxdf that it says what it should, to be read by `shared/recordings/src/xdf.rs`.

    pip install pyxdf==1.17.5 numpy
    python make_xdf.py

streams.xdf: stream 1 "Armband" (EMG, 2 x float32, 200 Hz, in uV and mV): sample n of channel c is 100 (c + 1) sin(2 pi (c + 1) n / 40).
600 samples, 3 s are missing before sample 400. Its clock is 0.5 s ahead of the recorder's and 100 ppm fast. Stamps, one every 20 samples, jitter by up to 1 ms. Stream 2 "Motion" (ACC, int16, 50 Hz), stream 3 "Cues" (Markers,
on the recorder's clock): "rest" 0.25 s after the first sample, "Grip" at 1 s, "note: good" at 1.5 s, "rest" at 5.5 s, which is sample
500. A boundary lies between the two parts.
"""

import struct
from pathlib import Path

import numpy as np
import pyxdf

here = Path(__file__).parent
RATE_HZ, SAMPLES, GAP_AT, GAP_S = 200.0, 600, 400, 3.0
START_S = 1000.0  # By the recorder's clock.
BOUNDARY = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")


def length(count: int) -> bytes:
    return struct.pack("<BB", 1, count) if count < 256 else struct.pack("<BI", 4, count)


def chunk(tag: int, content: bytes) -> bytes:
    return length(len(content) + 2) + struct.pack("<H", tag) + content


def of_stream(tag: int, stream: int, content: bytes) -> bytes:
    return chunk(tag, struct.pack("<I", stream) + content)


def head(stream: int, name: str, kind: str, channels: list[tuple[str, str]], rate: float, channel_format: str) -> bytes:
    listed = "".join(f"<channel><label>{label}</label><unit>{unit}</unit><type>{kind}</type></channel>" for label, unit in channels)
    xml = (
        f'<?xml version="1.0"?><info><name>{name}</name><type>{kind}</type><channel_count>{len(channels)}</channel_count>'
        f"<nominal_srate>{rate:g}</nominal_srate><channel_format>{channel_format}</channel_format>"
        f"<desc><channels>{listed}</channels></desc></info>"
    )
    return of_stream(2, stream, xml.encode())


def foot(stream: int) -> bytes:
    return of_stream(6, stream, b'<?xml version="1.0"?><info><sample_count>0</sample_count></info>')


def true_time(n: int) -> float:
    return START_S + n / RATE_HZ + (GAP_S if n >= GAP_AT else 0.0)


def device_time(time_s: float) -> float:
    return START_S + 0.5 + (time_s - START_S) * (1 + 1e-4)


def emg(first: int, jitter: np.random.Generator) -> bytes:
    content = length(20)
    for n in range(first, first + 20):
        values = struct.pack("<2f", *(100 * (c + 1) * np.sin(2 * np.pi * (c + 1) * n / 40) for c in range(2)))
        stamp = struct.pack("<Bd", 8, device_time(true_time(n)) + jitter.uniform(-0.001, 0.001)) if n == first else b"\0"
        content += stamp + values
    return of_stream(3, 1, content)


def marker(after_s: float, text: str) -> bytes:
    return of_stream(3, 3, length(1) + struct.pack("<Bd", 8, START_S + after_s) + length(len(text)) + text.encode())


def offset(time_s: float) -> bytes:
    return of_stream(4, 1, struct.pack("<dd", device_time(time_s), time_s - device_time(time_s)))


def main() -> None:
    jitter = np.random.default_rng(1)
    parts = [b"XDF:", chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')]
    parts += [
        head(1, "Armband", "EMG", [("flexor", "microvolts"), ("extensor", "mV")], RATE_HZ, "float32"),
        head(2, "Motion", "ACC", [("x", "g")], 50, "int16"),
        head(3, "Cues", "Markers", [("marker", "")], 0, "string"),
    ]
    for first in range(0, SAMPLES, 20):
        if first == GAP_AT:
            parts.append(chunk(5, BOUNDARY))
        parts.append(emg(first, jitter))
        time_s = true_time(first)
        if first % 60 == 0:
            parts.append(offset(time_s))
            parts.append(of_stream(3, 2, length(1) + struct.pack("<Bdh", 8, time_s, first)))
        for after_s, text in [(0.25, "rest"), (1.0, "Grip"), (1.5, "note: good"), (5.5, "rest")]:
            if true_time(first) <= START_S + after_s < true_time(first) + 0.1:
                parts.append(marker(after_s, text))
    parts += [foot(stream) for stream in (1, 2, 3)]
    path = here / "streams.xdf"
    path.write_bytes(b"".join(parts))

    streams, _ = pyxdf.load_xdf(path)
    armband = next(stream for stream in streams if stream["info"]["name"] == ["Armband"])
    cues = next(stream for stream in streams if stream["info"]["name"] == ["Cues"])
    assert armband["time_series"].shape == (SAMPLES, 2), armband["time_series"].shape
    times = np.array([true_time(n) for n in range(SAMPLES)])
    print(f"pyxdf: stamps are off by {np.abs(armband['time_stamps'] - times).max() * 1e3:.2f} ms at most,")
    print(f"segments {armband['info'].get('segments')}, markers {[text for [text] in cues['time_series']]} at {cues['time_stamps']}")


main()
