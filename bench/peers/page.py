"""Measures the page in a real browser, beside a session of the built programs.

    page.py stop                   # 100 presses of STOP while the arm moves: press to the arm's own stop on the wire
    page.py memory                 # an hour of a session: memory of browser and programs, once a minute
    page.py pixel                  # a minute of a session: muscle to pixel, as the page measures and shows it

    browser ── press ──▶ tendon-page ─▶ robot ──▶ Tap ──▶ xarm-emulator       one clock: this program's
                                              ◀──────◀

Build the programs first (`cargo build --release --workspace --bins`). TENDON_PROGRAMS names their folder, TENDON_BROWSER a browser;
nothing but Python is needed besides.
"""

import argparse
import json
import os
import pathlib
import random
import socket
import struct
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/browser"))

from browser import Browser, find_program  # noqa: E402
from case import IS_LIVE, MAY_ARM, TITLE  # noqa: E402
from programs import Emulator, Home, children, find_programs, wait_until  # noqa: E402

# Of the arm's protocol: transaction, protocol, length of what follows; then a register and what is written there.
HEAD = struct.Struct(">HHH")
SET_STATE = 0x0C
STOPPED = 4
# A loaded machine is slow.
LIMIT_S = 60.0
# Memory is still being taken so long after the start, min.
WARM_UP_MIN = 5


class Tap:
    """Stands between the session and the arm's control port, and keeps when the arm answered each order to stop, s."""

    def __init__(self, arm_port):
        self.arm_port = arm_port
        self.stops = []
        self._asked = set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            session, _ = self._listener.accept()
            arm = socket.create_connection(("127.0.0.1", self.arm_port))
            for end in (session, arm):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for source, target, hear in ((session, arm, self._hear_order), (arm, session, self._hear_answer)):
                threading.Thread(target=self._pass_on, args=(source, target, hear), daemon=True).start()

    def _pass_on(self, source, target, hear):
        unread = b""
        while chunk := source.recv(4096):
            came_s = time.monotonic()
            unread += chunk
            while len(unread) >= HEAD.size:
                transaction, _, length = HEAD.unpack_from(unread)
                if len(unread) < HEAD.size + length:
                    break
                # Heard before it is passed on: the answer cannot come first.
                hear(transaction, unread[HEAD.size:HEAD.size + length], came_s)
                unread = unread[HEAD.size + length:]
            target.sendall(chunk)
        target.close()

    def _hear_order(self, transaction, words, _came_s):
        if words[:2] == bytes([SET_STATE, STOPPED]):
            self._asked.add(transaction)

    def _hear_answer(self, transaction, words, came_s):
        if words[0] == SET_STATE and transaction in self._asked:
            self._asked.remove(transaction)
            self.stops.append(came_s)


def start_session(home, name, *words):
    return home.tendon("run", "--session", f"{name}-{os.getpid()}", "--page", "--page-port", "0", "--strategy", "direct",
                       "--model", ROOT / "models/cnn-six-class.onnx", *words)


def measure_stops(browser, home, count, seed):
    chance = random.Random(seed)
    with Emulator(home.programs) as arm:
        tap = Tap(arm.ports["control"])
        arm.ports["control"] = tap.port
        with start_session(home, "page-stop", "--keyboard", *arm.settings()) as tendon:
            page = browser.open(tendon.line("page: "))
            page.wait_for(f"{IS_LIVE} && {TITLE} === 'The arm waits'", LIMIT_S)
            waits_ms = []
            for trial in range(count):
                page.wait_for(MAY_ARM)
                page.value("document.querySelector('#arm').focus()")
                page.press_enter()
                page.wait_for(f"{TITLE} === 'Ready · rest'", LIMIT_S)
                # Up and down in turns, so that it stays within its box.
                page.type("ef"[trial % 2])
                page.wait_for(f"{TITLE}.startsWith('Following · ')", LIMIT_S)
                time.sleep(chance.uniform(0.1, 0.5))
                place = page.middle_of("#stop")
                before, pressed_s = len(tap.stops), time.monotonic()
                page.click_at(place)
                wait_until("the arm's stop", lambda: len(tap.stops) > before)
                waits_ms.append(1e3 * (tap.stops[before] - pressed_s))
                page.wait_for(f"{TITLE} === 'The arm is stopped'", LIMIT_S)
                page.type("n")
            assert tendon.end() == 0, tendon.lines
    waits_ms.sort()
    at = lambda share: waits_ms[min(count - 1, int(share * count))]
    print(f"press of STOP to the arm's stop on the wire, {count} presses: p50 {at(0.5):.1f} ms, p99 {at(0.99):.1f} ms, "
          f"most {waits_ms[-1]:.1f} ms")


def memory_mb(numbers):
    """What processes have written, and their shares of the shared memory they use. Their code is left out: how much of it counts for whom
    changes as other sessions come and go."""
    total_kb = 0
    for number in numbers:
        try:
            rollup = pathlib.Path(f"/proc/{number}/smaps_rollup").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        total_kb += sum(int(line.split()[1]) for line in rollup.splitlines() if line.startswith(("Pss_Anon:", "Pss_Shmem:")))
    return total_kb / 1e3


def measure_pixel(browser, home, seconds):
    with start_session(home, "page-pixel", "--random") as tendon:
        page = browser.open(tendon.line("page: "))
        shown = "document.querySelector('#muscle-to-pixel').textContent"
        page.wait_for(f"{IS_LIVE} && {shown}.startsWith('p50')", LIMIT_S)
        # Every 10 s, as it is told of the last 10 s.
        for _ in range(max(1, seconds // 10)):
            time.sleep(10)
            print(f"muscle to pixel: {page.value(shown)}", flush=True)
        assert tendon.end() == 0, tendon.lines


def measure_memory(browser, home, minutes, seed):
    rows = []
    with start_session(home, "page-memory", "--random", "--seed", str(seed)) as tendon:
        page = browser.open(tendon.line("page: "))
        page.wait_for(f"{IS_LIVE} && {TITLE} !== ''", LIMIT_S)
        names = ("page's heap", "elements", "browser", "tendon-page", "tendon")
        print("min   " + "  ".join(f"{name:>12}" for name in names) + "   (MB but for the elements)", flush=True)
        begun_s = time.monotonic()
        for minute in range(minutes + 1):
            time.sleep(max(0.0, begun_s + 60 * minute - time.monotonic()))
            page.call("HeapProfiler.collectGarbage")
            heap_mb = page.call("Runtime.getHeapUsage")["usedSize"] / 1e6
            elements = page.value("document.querySelectorAll('*').length")
            servers = [number for number, name in children(tendon.process.pid).items() if name == "tendon-page"]
            row = [heap_mb, elements, memory_mb([browser.process_id, *children(browser.process_id)]), memory_mb(servers),
                   memory_mb([tendon.process.pid])]
            rows.append(row)
            print(f"{minute:3}   " + "  ".join(f"{value:12.2f}" for value in row), flush=True)
        assert page.value(IS_LIVE), "the page has lost the session"
        assert tendon.end() == 0, tendon.lines
    settled = rows[min(WARM_UP_MIN, minutes // 2):]
    print("growth an hour, from minute " + str(len(rows) - len(settled)) + " on: " + ", ".join(
        f"{name} {60 * slope([row[index] for row in settled]):+.2f}" for index, name in enumerate(names)))


def slope(values):
    """Of the line through values that are equally far apart, by least squares."""
    middle = (len(values) - 1) / 2
    spread = sum((index - middle) ** 2 for index in range(len(values)))
    return sum((index - middle) * value for index, value in enumerate(values)) / spread if spread else 0.0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of waits and gestures")
    what = parser.add_subparsers(dest="what", required=True)
    what.add_parser("stop").add_argument("--count", type=int, default=100, help="presses of STOP")
    what.add_parser("memory").add_argument("--minutes", type=int, default=60)
    what.add_parser("pixel").add_argument("--seconds", type=int, default=60)
    options = parser.parse_args()
    programs = find_programs()
    if programs is None:
        raise SystemExit("the programs are not built: cargo build --release --workspace --bins")
    if find_program() is None:
        raise SystemExit("no browser found: install chromium-headless-shell, or name one in TENDON_BROWSER")
    with Browser(find_program()) as browser, Home(programs) as home:
        if options.what == "stop":
            measure_stops(browser, home, options.count, options.seed)
        elif options.what == "pixel":
            measure_pixel(browser, home, options.seconds)
        else:
            measure_memory(browser, home, options.minutes, options.seed)


if __name__ == "__main__":
    main()
