"""What a part costs the rest: sessions with it and without it, in turns, because no two minutes of a computer are alike.

    in_turns.py viewers            # without a page, with one, and with two who look at it
    in_turns.py recorder           # not recorded, and recorded
    in_turns.py sources            # simulated, the Lab Streaming Layer, NI's stand-in: capture to command
    in_turns.py recorder --wide    # at 64 channels, from an emulated amplifier; also: viewers --wide

The figures are medians of all turns: of each hop, of newest sample to command, and of a process its share of a core. Build the
programs first (`cargo build --release --workspace --bins`); TENDON_PROGRAMS names their folder. `sources` needs
libnidaqmx.so beside them (it is built in `deps`), and --wide needs numpy.
"""

import argparse
import base64
import json
import os
import pathlib
import random
import socket
import statistics
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/browser"))

from programs import Home, children, find_programs, wait_until  # noqa: E402

WHOLE = "newest sample to command, p50"
# Of the sessions with the simulated amplifier.
CHANNELS = 8
CALIBRATION_S = 300.0
WIDE_PORT = 54900


class Viewer:
    """Looks at a page as a browser on another machine does: it reads all that comes, and draws nothing here."""

    def __init__(self, link):
        address, token = link.removeprefix("http://").split("/#")
        host, port = address.rsplit(":", 1)
        self._socket = socket.create_connection((host, int(port)))
        key = base64.b64encode(random.randbytes(16)).decode()
        self._socket.sendall((f"GET /ws?token={token} HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                              f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n").encode())
        self.bytes = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while chunk := self._socket.recv(1 << 20):
            self.bytes += len(chunk)


def processor_s(number):
    """Time that a process has had on the processor, s."""
    fields = pathlib.Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure_session(home, seconds, options, part=None, viewers=0):
    """Of one session, us: each hop, and newest sample to command. And what the process `part` had of a core."""
    row = {}
    report = home.path / "report.json"
    with home.tendon("run", "--session", f"in-turns-{os.getpid()}", "--duration", f"{seconds}s", "--json", report, *options) as tendon:
        if part is not None:
            looking = [Viewer(tendon.line("page: ")) for _ in range(viewers)]
            wait_until("the session's start", lambda: any(line.startswith("  scheduling") for line in tendon.lines))
            number = next(number for number, name in children(tendon.process.pid).items() if name == part)
            time.sleep(seconds / 4)
            before, begun_s = processor_s(number), time.monotonic()
            time.sleep(seconds / 2)
            row[f"{part}, % of a core"] = 100 * (processor_s(number) - before) / (time.monotonic() - begun_s)
            assert all(viewer.bytes > 1000 * seconds for viewer in looking), "a viewer was shown nothing"
        wait_until("the session's end", lambda: tendon.process.poll() is not None)
        assert tendon.process.returncode == 0, tendon.lines
    measured = json.loads(report.read_text())
    spans = {f"{hop['from']} to {hop['to']}": hop for hop in measured["hops"]}
    spans["newest sample to command"] = measured["newest_sample_to_command"]
    return row | {f"{name}, {short}": span[f"{short}_us"] for name, span in spans.items() for short in ("p50", "p99")}


def take_turns(kinds, turns, seconds):
    """Measures a session of each kind in every turn, and prints the medians beside those of the first kind."""
    rows = {kind: [] for kind in kinds}
    for turn in range(turns):
        for kind in random.sample(list(kinds), len(kinds)):
            rows[kind].append(kinds[kind]())
            print(f"{turn + 1} of {turns}: {kind}, {WHOLE} {rows[kind][-1][WHOLE]:.1f} us", flush=True)
    first = next(iter(kinds))
    print(f"medians of {turns} turns of {seconds} s, us; in brackets as a multiple of: {first}")
    median = {kind: {name: statistics.median(row[name] for row in rows[kind]) for name in rows[kind][0]} for kind in kinds}
    for name, base in median[first].items():
        print(f"{name:34}" + "  ".join(f"{kind} {median[kind][name]:7.1f} ({median[kind][name] / base:.2f})" for kind in kinds))
    for kind in kinds:
        for name in set(median[kind]) - set(median[first]):
            print(f"{kind}: {name} {median[kind][name]:.2f}")


def calibrated(home, is_wide, peers):
    """Options of a session with somebody who was calibrated: on 8 simulated channels, or on 64 of an emulated amplifier."""
    if is_wide:
        from source_losses import make_person, open_peer

        environment = os.environ | home.environment
        make_person(home.programs, home.path, environment, "uV")
        peer, options = open_peer("otb-64", WIDE_PORT, home.programs)
        peers.append(peer)
        return options
    signal = ["--set", f"acquisition.channels={CHANNELS}", "--set", "acquisition.simulate.profile=stranger-19"]
    print(f"calibrating somebody on {CHANNELS} channels", flush=True)
    with home.tendon("calibrate", "somebody", "--hold", "3s", *signal) as calibration:
        wait_until("the calibration", lambda: calibration.process.poll() is not None, CALIBRATION_S)
        assert calibration.process.returncode == 0, calibration.lines
    return ["--person", "somebody", *signal]


def kinds_of(what, home, is_wide, seconds, peers):
    """What is measured in turns, by name: first what everything else is compared with."""
    session = lambda *words, **more: lambda: measure_session(home, seconds, words, **more)  # noqa: E731
    if what == "sources":
        from source_losses import open_peer

        kinds = {"simulated": session("--strategy", "direct")}
        for name, source in (("Lab Streaming Layer", "lsl-4"), ("NI's stand-in", "nidaqmx-4")):
            peer, options = open_peer(source, WIDE_PORT, home.programs)
            peers.append(peer)
            kinds[name] = session(*options)
        return kinds
    options = calibrated(home, is_wide, peers)
    if what == "recorder":
        record = ("--record", home.path / "recorded")
        return {"not recorded": session(*options), "recorded": session(*options, *record, part="tendon-recorder")}
    page = (*options, "--page", "--page-port", "0", "--no-browser")
    viewed = {f"page, {count} viewers": session(*page, part="tendon-page", viewers=count) for count in (0, 1, 2)}
    return {"no page": session(*options)} | viewed


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["viewers", "recorder", "sources"])
    parser.add_argument("--turns", type=int, default=5, help="sessions of each kind")
    parser.add_argument("--seconds", type=int, default=12, help="length of each session")
    parser.add_argument("--wide", action="store_true", help="64 channels of an emulated amplifier instead of 8 simulated ones")
    arguments = parser.parse_args()
    programs = find_programs()
    if programs is None:
        raise SystemExit("the programs are not built: cargo build --release --workspace --bins")
    random.seed(1)
    peers = []
    with Home(programs.resolve()) as home:
        try:
            take_turns(kinds_of(arguments.what, home, arguments.wide, arguments.seconds, peers), arguments.turns, arguments.seconds)
        finally:
            for peer in filter(None, peers):
                peer.close()


if __name__ == "__main__":
    main()
