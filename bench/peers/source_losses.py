"""Loses samples of every amplifier on purpose, all at once, and compares what was lost with what the sessions counted.

    pip install numpy
    source_losses.py                 # ten minutes of each source at 2000 Hz, with 4 channels and where it has them with 64
    source_losses.py otb-64 lsl-4    # only these

Every 3 s a peer loses 1 to 20 samples (the Lab Streaming Layer's emulator 7 in every second of its stream). A Trigno has no
counter, so it loses nothing here, and NI's stand-in measures every sample: neither may count a loss. Sessions of 64 channels
run with a person of 64, whom this script makes up, so that all of them go through every hop.
"""

import argparse
import json
import math
import os
import pathlib
import random
import socket
import struct
import subprocess
import tempfile
import threading
import time

import numpy as np

RATE_HZ = 2000
FRAME_SAMPLES = 10
LOSS_EVERY_S = 3
# What the emulator of the Lab Streaming Layer loses in each second of its stream.
LSL_LOSS = 7
# Where the first of the peers listens or is dialled.
PORT = 54800
SOURCES = ["otb-4", "otb-64", "delsys-4", "lsl-4", "lsl-64", "stream-4", "stream-64", "nidaqmx-4"]


class Emulator:
    """An emulator of Tendon. Those that lose samples when they are told to hear it on their standard input."""

    def __init__(self, *command):
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)

    def lose(self, samples):
        self.process.stdin.write(f"lose {samples}\n")
        self.process.stdin.flush()

    def close(self):
        self.process.kill()
        self.process.wait()


class Program:
    """A program that streams noise over TCP."""

    def __init__(self, port, channels):
        self.port, self.channels, self.lost, self.is_open = port, channels, 0, True
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while self.is_open:
            try:
                self.stream()
            except OSError:
                time.sleep(0.05)

    def stream(self):
        noise = np.random.default_rng(0).normal(0, 5, (64, FRAME_SAMPLES * self.channels)).astype("<f4")
        with socket.create_connection(("127.0.0.1", self.port)) as tendon:
            names = [f"EMG {number}" for number in range(1, self.channels + 1)]
            unit = {"unit": "uV"} if self.channels == 64 else {}
            header = {"name": "losses", "channels": names, "rate_hz": RATE_HZ, **unit}
            tendon.sendall(json.dumps(header).encode() + b"\n")
            begun, first_sample, lost_before, frame = time.monotonic(), 0, self.lost, 0
            while self.is_open:
                first_sample += FRAME_SAMPLES + self.lost - lost_before
                lost_before = self.lost
                time.sleep(max(0, begun + first_sample / RATE_HZ - time.monotonic()))
                header = struct.pack("<4sIQ", b"EMGf", FRAME_SAMPLES, first_sample - FRAME_SAMPLES)
                tendon.sendall(header + noise[frame % len(noise)].tobytes())
                frame += 1

    def lose(self, samples):
        self.lost += samples

    def close(self):
        self.is_open = False


def make_person(programs, folder, environment, unit):
    """A person of 64 channels of this unit, whose gestures are nothing but louder noise."""
    random_numbers = np.random.default_rng(1)
    lines = ["label," + ",".join(f"EMG {number}" for number in range(1, 65))]
    for label, loud in [("rest", 0), ("extension", 1), ("rest", 0), ("flexion", 2), ("rest", 0)]:
        amplitude = np.where(np.arange(64) % 2 == loud - 1, 60.0, 5.0)
        samples = random_numbers.normal(0, 1, (4 * RATE_HZ, 64)) * amplitude
        lines += [label + "," + ",".join(f"{value:.1f}" for value in row) for row in samples]
    table = folder / f"{unit}.csv"
    table.write_text("\n".join(lines) + "\n")
    name = f"losses-{unit.lower().replace('_', '-')}"
    facts = ["--label-column", "label", "--recording-rate-hz", str(RATE_HZ), "--unit", unit]
    command = [programs / "tendon", "calibrate", name, "--from", table, *facts]
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    table.unlink()


def open_peer(name, port, programs, lsl_loss=0):
    """What stands for the amplifier, and the settings of a session with it."""
    source, channels = name.split("-")
    wide = {"otb": ["--person", "losses-uv"], "stream": ["--person", "losses-uv"], "lsl": ["--person", "losses-adc-counts"]}
    options = wide[source] if channels == "64" else ["--strategy", "direct"]
    match source:
        case "otb":
            device = "sessantaquattro" if channels == "64" else "muovi"
            peer = Emulator(programs / "tendon-otb-emulator", device, "--connect", f"127.0.0.1:{port}")
            settings = [f"acquisition.otb.device={device}", f"acquisition.otb.address=127.0.0.1:{port}", "acquisition.unit=uV"]
        case "delsys":
            peer = Emulator(programs / "tendon-delsys-emulator", "--command-port", str(port), "--emg-port", str(port + 1))
            ports = [f"acquisition.delsys.command_port={port}", f"acquisition.delsys.emg_port={port + 1}"]
            settings = [*ports, "acquisition.unit=uV"]
        case "lsl":
            stream = f"losses-{channels}-{os.getpid()}"
            peer = Emulator(programs / "tendon-lsl-emulator", "--name", stream, "--source-id", stream, "--channels", channels,
                            "--lose", str(lsl_loss))
            settings = [f"acquisition.lsl.name={stream}"]
        case "nidaqmx":
            peer, settings = None, [f"acquisition.nidaqmx.library={programs / 'libnidaqmx.so'}"]
        case "stream":
            peer, settings = Program(port, int(channels)), [f"acquisition.stream.address=127.0.0.1:{port}"]
    settings.append(f"acquisition.source={source}")
    return peer, options + [part for setting in settings for part in ("--set", setting)]


def measure(name, port, seconds, programs, folder, environment):
    """One session: what was injected, and its report."""
    peer, options = open_peer(name, port, programs, LSL_LOSS)
    report, log_path = folder / f"{name}.json", folder / f"{name}.log"
    session = ["--session", f"losses-{name}-{os.getpid()}", "--duration", f"{seconds}s", "--json", report]
    command = [programs / "tendon", "run", *session, *options]
    with open(log_path, "w") as log:
        session = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
        while session.poll() is None and "\n  scheduling" not in log_path.read_text():
            time.sleep(0.1)
        begun, injected = time.monotonic(), 0
        loses = name.split("-")[0] in ("otb", "stream")
        while session.poll() is None:
            time.sleep(LOSS_EVERY_S)
            # What is lost at the very end may come after it.
            if loses and time.monotonic() < begun + seconds - 2 * LOSS_EVERY_S:
                samples = random.randint(1, 20)
                peer.lose(samples)
                injected += samples
    if peer is not None:
        peer.close()
    if session.returncode != 0:
        return name, None, log_path.read_text()
    return name, injected, json.loads(report.read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="*", help=f"of {', '.join(SOURCES)} [default: all of them]")
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--programs", type=pathlib.Path, default=pathlib.Path("target/release"), help="folder of the programs")
    arguments = parser.parse_args()
    sources = arguments.sources or SOURCES
    if unknown := set(sources) - set(SOURCES):
        parser.error(f"{', '.join(sorted(unknown))}: take of {', '.join(SOURCES)}")
    programs = arguments.programs.resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        environment = os.environ | {"XDG_STATE_HOME": str(folder), "XDG_DATA_HOME": str(folder)}
        for unit in ("uV", "adc_counts"):
            make_person(programs, folder, environment, unit)
        results = []
        threads = [
            threading.Thread(target=lambda *what: results.append(measure(*what)),
                             args=(name, PORT + 10 * place, arguments.seconds, programs, folder, environment))
            for place, name in enumerate(sources)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for name, injected, report in sorted(results, key=lambda result: sources.index(result[0])):
        if injected is None:
            print(f"{name}: the session ended early:\n{report}")
            continue
        counted, blocks = report["lost_samples"], report["messages"]["blocks"]
        if name.startswith("lsl"):
            # Its emulator began before the session, so which of its losses is the first is not known, but how many came is.
            losses = (blocks["published"] * FRAME_SAMPLES + counted) / RATE_HZ
            possible = [LSL_LOSS * math.floor(losses), LSL_LOSS * math.ceil(losses)]
            injected = counted if counted in possible else possible[0]
        print(f"{name}: {report['duration_s']:.0f} s, injected {injected}, counted {counted}, "
              f"{'exact' if injected == counted else 'WRONG'}; "
              f"{blocks['stale']} of {blocks['published']} blocks too late, "
              f"{report['restarts']} restarts")


if __name__ == "__main__":
    main()
