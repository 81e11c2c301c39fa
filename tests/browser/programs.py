"""Sessions of the built programs for the tests in a browser: `tendon` with the simulated amplifier and an emulated xArm7.

    browser ◀──▶ tendon-page ◀── topics ── tendon and its stages ◀── wire protocol ──▶ xarm-emulator
                                                                          test ──▶ its state
"""

import os
import pathlib
import socket
import subprocess
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
NEEDED = ("tendon", "tendon-page", "xarm-emulator")
WATCHDOG_S = 60.0


def find_programs():
    """The folder of the programs that were built last, or None where they are not built. TENDON_PROGRAMS names one."""
    named = os.environ.get("TENDON_PROGRAMS")
    folders = [pathlib.Path(named)] if named else [ROOT / "target" / profile for profile in ("debug", "release")]
    built = [folder for folder in folders if all((folder / name).is_file() for name in NEEDED)]
    return max(built, key=lambda folder: (folder / "tendon-page").stat().st_mtime, default=None)


def wait_until(what, condition, watchdog_s=WATCHDOG_S):
    deadline = time.monotonic() + watchdog_s
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {watchdog_s:.0f} s in vain for {what}")
        time.sleep(0.03)
    return value


def children(parent):
    """Numbers of all processes below a process, and their names."""
    found, parents = {}, {}
    for entry in pathlib.Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            head, fields = (entry / "stat").read_text().rsplit(")", 1)
        except (FileNotFoundError, ProcessLookupError):
            continue
        parents.setdefault(int(fields.split()[1]), []).append((int(entry.name), head.split("(", 1)[1]))
    waiting = [parent]
    while waiting:
        for number, name in parents.get(waiting.pop(), []):
            found[number] = name
            waiting.append(number)
    return found


class Program:
    """A running program whose output is gathered; a context that ends it."""

    def __init__(self, command, **options):
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        text=True, **options)
        self.lines = []
        self._reader = threading.Thread(target=self._gather, daemon=True)
        self._reader.start()

    def _gather(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip("\n"))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        """Ends it as Ctrl-C does, and returns its exit status."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(WATCHDOG_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise AssertionError(f"{self.process.args[0]} did not end; it said {self.lines}") from None
        finally:
            self._reader.join(5)
            self.process.stdin.close()
            self.process.stdout.close()

    def line(self, start):
        """What follows `start` in the first line that begins so."""
        def find():
            if found := [line[len(start):] for line in list(self.lines) if line.startswith(start)]:
                return found
            assert self.process.poll() is None, f"{self.process.args} has ended; it said {self.lines}"
            return None

        return wait_until(f"'{start}' of {self.process.args[0]}", find)[0]


class Emulator(Program):
    """An emulated xArm7 on ports that are free."""

    def __init__(self, folder):
        kinds = ("control", "normal-report", "rich-report", "real-time-report")
        holders = [socket.create_server(("127.0.0.1", 0)) for _ in kinds]
        self.ports = {kind: holder.getsockname()[1] for kind, holder in zip(kinds, holders)}
        for holder in holders:
            holder.close()
        options = [word for kind, port in self.ports.items() for word in (f"--{kind}-port", str(port))]
        super().__init__([folder / "xarm-emulator", *options])
        self.line("ready")

    def state(self):
        """State, speed in mm/s, and height of the flange in mm, of the arm itself."""
        before = len(self.lines)
        self.process.stdin.write("state\n")
        self.process.stdin.flush()
        words = wait_until("the arm's state", lambda: self.lines[before:])[0]
        pose = words[words.index("pose [") + 6:words.index("]", words.index("pose ["))]
        speed = words.split("speed_mm_per_s ")[1].split()[0]
        return words.split()[1], float(speed), float(pose.split(",")[2])

    def settings(self):
        """Options of `tendon run` for this arm."""
        settings = {"robot.backend": "xarm", "robot.xarm.address": "127.0.0.1",
                    "robot.xarm.control_port": self.ports["control"],
                    "robot.xarm.normal_report_port": self.ports["normal-report"],
                    "robot.xarm.real_time_report_port": self.ports["real-time-report"]}
        return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


class Home:
    """A folder for all that a user keeps, and the programs run in it."""

    def __init__(self, programs):
        self.programs = programs
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.path = pathlib.Path(self._folder.name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._folder.cleanup()

    @property
    def environment(self):
        """Variables by which programs find it."""
        return {"HOME": str(self.path), "XDG_DATA_HOME": str(self.path / "data"), "XDG_STATE_HOME": str(self.path / "state"),
                "ORT_DYLIB_PATH": os.environ.get("ORT_DYLIB_PATH", str(ROOT / ".cache/onnxruntime/libonnxruntime.so"))}

    def tendon(self, *words):
        """Starts `tendon` with these words."""
        return Program([self.programs / "tendon", *map(str, words)], cwd=self.path, env=os.environ | self.environment)
