"""Breaks the connection to an amplifier many times in one session, and measures what the arm does.

    pip install mcap numpy
    source_faults.py otb close            # 100 trials; also: kill, cut, late, torn
    source_faults.py nidaqmx overrun      # also: close, cut
    source_faults.py lsl kill             # also: cut
    source_faults.py stream close --recording ../shared/data/3dc/Participant1/train/EMG

The person rests, makes a gesture until the arm moves, and holds it through the fault until the source has been back
for a while: only then comes the next rest. The session is recorded; the figures come from the times of its blocks
(CLOCK_MONOTONIC, as here) and from the positions of the arm, not from what Tendon says of itself.

| fault | what happens |
| --- | --- |
| close | the connection is closed, and the amplifier connects again at once (nidaqmx: unplugged for 0.5 s) |
| kill | the amplifier is killed, and started again after 0.4 s |
| cut | nothing comes for 1.2 s, though the connection stands |
| late | everything comes 1 s late, until the connection is closed 2.2 s later |
| torn | a second of packets comes in pieces |
| overrun | the driver's buffer is full for 0.3 s |
"""

import argparse
import contextlib
import json
import os
import pathlib
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np
from mcap.reader import NonSeekingReader

# The session's, and this script's own, names of gestures that move the arm to and fro.
GESTURES = ["extension", "flexion"]
# An arm that moved less between two of its reports, mm, is at rest.
STILL_MM = 0.02
# Blocks come every 5 ms. A longer pause between two of them, ns, is an outage: for so long no command can have come, and the arm stops.
OUTAGE_NS = 150e6
# A motion may still end so long after samples have come again, ns, before it counts as one without permission: where the whole
# machine stood still, so did the robot process.
ENDING_NS = 400e6


class Emulator:
    """An emulator of Tendon that hears gestures and faults on its standard input."""

    def __init__(self, command, environment):
        self.command, self.environment = command, environment
        self.start("rest 1000s")

    def start(self, script):
        command = [*self.command, "--script", script]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, env=self.environment, text=True)

    def say(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def gesture(self, gesture):
        self.say(gesture)

    def close(self):
        self.say("close")

    def cut(self, seconds):
        self.say(f"silent {seconds}")

    def late(self, seconds):
        self.say(f"late {seconds}")

    def torn(self, packets):
        self.say(f"torn {packets}")

    def kill(self):
        self.process.kill()
        self.process.wait()


class LslEmulator(Emulator):
    """The emulator of the Lab Streaming Layer, which hears nothing: another gesture is another run of it, after a rest."""

    def gesture(self, gesture):
        if gesture != "rest":
            self.kill()
            self.start(f"rest 2.5s, {gesture} 1000s")
            time.sleep(4)

    def cut(self, seconds):
        os.kill(self.process.pid, signal.SIGSTOP)
        threading.Timer(seconds, os.kill, [self.process.pid, signal.SIGCONT]).start()


class NiStandIn:
    """The stand-in of NI's library, whose faults are the text of a file. It measures a sine: the arm stays at rest."""

    def __init__(self, control):
        self.control = control

    def fault(self, text, seconds):
        self.control.write_text(text)
        time.sleep(seconds)
        self.control.unlink()

    def gesture(self, _):
        pass

    def close(self):
        self.fault("unplugged", 0.5)

    def cut(self, seconds):
        threading.Thread(target=self.fault, args=["silent", seconds]).start()

    def overrun(self):
        self.fault("overrun", 0.3)

    def kill(self):
        pass


class Program:
    """A program that streams a recording of 3DC over TCP: four channels, each sample twice, at 2000 Hz."""

    def __init__(self, port, recording):
        self.port = port
        names = {"rest": 0, "flexion": 2, "extension": 4}
        self.samples = {gesture: self.read(recording, number) for gesture, number in names.items()}
        self.playing, self.silent_until, self.lag_s, self.torn_frames = "rest", 0.0, 0.0, 0
        self.is_alive, self.is_closing = True, False
        threading.Thread(target=self.run, daemon=True).start()

    @staticmethod
    def read(recording, number):
        files = [np.loadtxt(recording / f"3dc_EMG_gesture_{repetition}_{number}.txt", delimiter=",") for repetition in range(4)]
        held = np.concatenate([file[1500:4500, [0, 3, 5, 8]] for file in files])
        return np.repeat(held, 2, axis=0).astype("<f4")

    def run(self):
        while True:
            if self.is_alive:
                try:
                    self.stream()
                except OSError:
                    pass
            time.sleep(0.02)

    def stream(self):
        with socket.create_connection(("127.0.0.1", self.port)) as tendon:
            header = {"name": "trial", "channels": ["a", "b", "c", "d"], "rate_hz": 2000}
            tendon.sendall(json.dumps(header).encode() + b"\n")
            begun, frame, self.lag_s, self.is_closing = time.monotonic(), 0, 0.0, False
            while True:
                while time.monotonic() < max(begun + (frame + 1) * 0.01 + self.lag_s, self.silent_until):
                    time.sleep(0.001)
                if self.is_closing or not self.is_alive:
                    return
                samples = self.samples[self.playing]
                at = frame * 20 % (len(samples) - 20)
                bytes_of_frame = struct.pack("<4sIQ", b"EMGf", 20, frame * 20) + samples[at : at + 20].tobytes()
                piece = 7 if self.torn_frames > 0 else len(bytes_of_frame)
                self.torn_frames -= 1
                for start in range(0, len(bytes_of_frame), piece):
                    tendon.sendall(bytes_of_frame[start : start + piece])
                frame += 1

    def gesture(self, gesture):
        self.playing = gesture

    def close(self):
        self.is_closing = True

    def cut(self, seconds):
        self.silent_until = time.monotonic() + seconds

    def late(self, seconds):
        self.lag_s += seconds

    def torn(self, frames):
        self.torn_frames = frames

    def kill(self):
        self.is_alive = False

    def start(self, script):
        self.playing, self.is_alive = script.split()[0], True


def open_source(arguments, folder, environment):
    """The source, and the settings of a session with it."""
    programs, port, name = arguments.programs, arguments.port, f"faults-{os.getpid()}"
    match arguments.source:
        case "otb":
            command = [programs / "tendon-otb-emulator", "muovi", "--connect", f"127.0.0.1:{port}"]
            return Emulator(command, environment), [f"acquisition.otb.address=127.0.0.1:{port}", "acquisition.unit=uV"]
        case "delsys":
            command = [programs / "tendon-delsys-emulator", "--command-port", str(port), "--emg-port", str(port + 1)]
            ports = [f"acquisition.delsys.command_port={port}", f"acquisition.delsys.emg_port={port + 1}"]
            return Emulator(command, environment), [*ports, "acquisition.unit=uV"]
        case "lsl":
            command = [programs / "tendon-lsl-emulator", "--name", name, "--source-id", name]
            return LslEmulator(command, environment), [f"acquisition.lsl.name={name}"]
        case "nidaqmx":
            environment["DAQMX_EMULATOR_CONTROL"] = str(folder / "control")
            return NiStandIn(folder / "control"), [f"acquisition.nidaqmx.library={programs / 'libnidaqmx.so'}"]
        case "stream":
            return Program(port, arguments.recording), [f"acquisition.stream.address=127.0.0.1:{port}"]


def trial(source, fault, gesture):
    """Breaks the source once, in a movement. Gives the times of the fault, of the return and of what follows, ns."""
    source.gesture("rest")
    time.sleep(0.9)
    source.gesture(gesture)
    time.sleep(1.1 + random.random() * 0.4)
    begun_ns = time.monotonic_ns()
    match fault:
        case "close":
            source.close()
        case "kill":
            source.kill()
            time.sleep(0.4)
            source.start(f"{gesture} 1000s")
        case "cut":
            source.cut(1.2)
            time.sleep(1.2)
        case "late":
            source.late(1)
            time.sleep(2.2)
            source.close()
        case "torn":
            source.torn(100)
        case "overrun":
            source.overrun()
    returned_ns = time.monotonic_ns()
    time.sleep(3.6)
    return {"begun_ns": begun_ns, "returned_ns": returned_ns, "ended_ns": time.monotonic_ns()}


def read_recording(path):
    """Of each block when it was captured and published, its first sample and its length; of each state its time and position."""
    blocks, states = [], []
    with open(path, "rb") as file:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            if channel.topic == "blocks":
                _, captured_ns, published_ns, first_sample = struct.unpack_from("<QQQQ", message.data)
                (samples,) = struct.unpack_from("<I", message.data, 68)
                blocks.append((captured_ns, published_ns, first_sample, samples))
            elif channel.topic == "states":
                state = json.loads(message.data)
                states.append((state["trace"]["published_ns"][4], *state["position_mm"]))
    return np.array(blocks, dtype=np.int64), np.array(states)


def judge(trials, blocks, states):
    """Of each trial whether the arm moved, how long it went on, when samples came again, and whether it moved without permission."""
    times_ns = states[:, 0]
    is_moving = np.r_[False, np.linalg.norm(np.diff(states[:, 1:], axis=0), axis=1) > STILL_MM]
    judged = []
    for times in trials:
        before = (times_ns > times["begun_ns"] - 150e6) & (times_ns < times["begun_ns"])
        result = {"was_moving": bool(is_moving[before].any())}
        first = max(np.searchsorted(blocks[:, 1], times["begun_ns"]) - 1, 0)
        near = blocks[first : np.searchsorted(blocks[:, 1], times["ended_ns"])]
        outages = np.flatnonzero(np.diff(near[:, 1]) > OUTAGE_NS)
        if len(outages) > 0:
            last_ns, back_ns = near[outages[0], 0], near[outages[0] + 1, 1]
            # A robot at work says 250 times a second where it is. Where it says nothing, the recorder missed what happened, blocks, too.
            if not ((times_ns > back_ns - 0.7 * OUTAGE_NS) & (times_ns < back_ns)).any():
                judged.append(result | {"was_missed": True})
                continue
            still_moving = is_moving & (times_ns > last_ns) & (times_ns < back_ns)
            after = (times_ns > max(back_ns, last_ns) + ENDING_NS) & (times_ns < times["ended_ns"])
            result |= {
                "rest_ms": (times_ns[still_moving].max() - last_ns) / 1e6 if still_moving.any() else 0.0,
                "found_s": max(back_ns - times["returned_ns"], 0) / 1e9,
                "moved_without_rest": bool(is_moving[after].any()),
                "pause_ms": (back_ns - near[outages[0], 1]) / 1e6,
            }
        judged.append(result)
    return judged


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", choices=["otb", "delsys", "lsl", "nidaqmx", "stream"])
    parser.add_argument("fault", choices=["close", "kill", "cut", "late", "torn", "overrun"])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--programs", type=pathlib.Path, default=pathlib.Path("target/release"), help="folder of the programs")
    parser.add_argument("--port", type=int, default=54700, help="where the source listens or is dialled; it also takes the next one")
    parser.add_argument("--recording", type=pathlib.Path, help="an EMG folder of 3DC, for the source `stream`")
    parser.add_argument("--keep", type=pathlib.Path, help="empty folder that keeps the session's recording and log, and each trial as judged")
    arguments = parser.parse_args()
    arguments.programs = arguments.programs.resolve()
    if arguments.source == "stream" and arguments.recording is None:
        parser.error("the source `stream` needs --recording")
    with tempfile.TemporaryDirectory() if arguments.keep is None else contextlib.nullcontext(arguments.keep) as folder:
        folder = pathlib.Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        environment = os.environ | {"XDG_STATE_HOME": str(folder)}
        source, settings = open_source(arguments, folder, environment)
        settings = [f"acquisition.source={arguments.source}", *settings]
        command = [arguments.programs / "tendon", "run", "--session", f"faults-{os.getpid()}", "--strategy", "direct", "--record", folder / "recorded"]
        command += [part for setting in settings for part in ("--set", setting)]
        with open(folder / "session.log", "w+") as log:
            session = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
            given_up = time.monotonic() + 90
            size, earlier = 0, 0
            # Samples take some 50 kB a second, all else less than 20.
            while size - earlier < 35_000:
                if session.poll() is not None or time.monotonic() > given_up:
                    source.kill()
                    log.seek(0)
                    sys.exit(f"the session did not start:\n{log.read()}")
                time.sleep(1)
                size, earlier = sum(file.stat().st_size for file in folder.glob("recorded/*/session.mcap")), size
            trials = [trial(source, arguments.fault, GESTURES[number % 2]) for number in range(arguments.trials)]
            session.send_signal(signal.SIGINT)
            session.wait(30)
        source.kill()
        judged = judge(trials, *read_recording(next(folder.glob("recorded/*/session.mcap"))))
        results = [times | {key: value.item() if isinstance(value, np.generic) else value for key, value in result.items()} for times, result in zip(trials, judged)]
        (folder / "trials.json").write_text(json.dumps(results, indent=1))
    outages = [result for result in judged if "rest_ms" in result]
    rest_ms = [result["rest_ms"] for result in outages if result["was_moving"]] or [0.0]
    wrong_ms = [round(result["pause_ms"]) for result in outages if result["moved_without_rest"]]
    found_s = [result["found_s"] for result in outages] or [0.0]
    missed = sum("was_missed" in result for result in judged)
    print(
        f"{arguments.source} {arguments.fault}: {len(trials)} trials, {sum(result['was_moving'] for result in judged)} in a movement, "
        f"{len(outages)} outages" + (f", {missed} trials not judged: the recorder missed parts of them" if missed else "") + "\n"
        f"  last sample to the arm at rest: median {np.median(rest_ms):.0f} ms, longest {max(rest_ms):.0f} ms\n"
        f"  found again after its return: median {np.median(found_s):.2f} s, longest {max(found_s):.2f} s\n"
        f"  moved before a rest: {len(wrong_ms)}" + (f", after pauses of {wrong_ms} ms" if wrong_ms else "")
    )


if __name__ == "__main__":
    main()
