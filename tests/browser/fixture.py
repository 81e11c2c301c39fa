"""A session that a test makes up: serves the page's files and speaks to them as the program `tendon-page` does.

    test ── attributes of Session ──▶ Session ── hello, state, desk, latency, answers, frames ──▶ page
         ◀─ Session.orders, requests ─────────◀─ orders, requests, pings ───────────────────────
"""

import base64
import hashlib
import http.server
import json
import math
import pathlib
import struct
import threading
import time
import urllib.parse

WEB = pathlib.Path(__file__).resolve().parents[2] / "services" / "page" / "web"
TOKEN = "token-of-the-test"
POLICY = "default-src 'self'; connect-src 'self'; img-src 'self' data:"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json",
         ".svg": "image/svg+xml"}
GESTURES = ["rest", "extension", "flexion", "ulnar", "radial", "grip"]
BIN_MS = 8
#: Modified Denavit-Hartenberg parameters of the xArm7: a in mm, d in mm, alpha in rad.
JOINTS = [(0, 267, 0), (0, 0, -math.pi / 2), (0, 293, math.pi / 2), (52.5, 0, math.pi / 2), (77.5, 342.5, math.pi / 2),
          (0, 0, math.pi / 2), (76, 97, -math.pi / 2)]
#: The arm stands at its start position.
JOINTS_RAD = [0.0, -0.2618, 0.0, 0.7854, 0.0, 1.0472, 0.0]
START_MM = [386.0, 0.0, 362.0]
MODES = [{"name": "y-z", "motions": dict(zip(GESTURES, ["none", "+z", "-z", "+y", "-y", "gripper"]))},
         {"name": "x-z", "motions": dict(zip(GESTURES, ["none", "+z", "-z", "+x", "-x", "gripper"]))}]
RECORDING = "/home/anna/sessions/2026-05-04T10-20-30/session.mcap"
#: Fields of the state that a calibration, which has no arm, does not know.
OF_THE_ARM = ["position_mm", "orientation_rad", "joints_rad", "speed_mm_per_s", "gripper", "stop_reason", "fault", "hindrance",
              "phase", "gesture", "voted", "confidence", "mode", "zone"]
#: What a calibration tells while a gesture is asked for.
CUE = {
    "name": "anna", "phase": "cues", "ask": "hold", "gesture": "grip", "repetition": 1, "repetitions": 2,
    "countdown_s": None, "left_s": 3.4, "effort_share": 0.55, "asked_effort_share": 0.7, "progress": 0.45,
    "all_left_s": 31, "trouble": None, "may": ["redo", "stop"], "report": None, "error": None,
}
REPORT = {
    "expected_accuracy": 0.97, "gestures": [{"name": name, "recall": 0.99 - 0.03 * place}
                                            for place, name in enumerate(GESTURES)],
    "channels": [{"name": f"EMG {number}", "snr_db": 24.0 - 2 * number, "remark": "hum" if number == 3 else None}
                 for number in range(8)],
    "findings": [{"kind": "alike", "first": "ulnar", "second": "radial", "percent": 12.4,
                  "text": "ulnar and radial look alike 12 % of the time: repeat them further apart"}],
    "confusion": {"gestures": GESTURES, "counts": [[40 if row == column else 5 if (row, column) == (3, 4) else 0
                                                    for column in range(6)] for row in range(6)]},
    "check": {"before": 0.71, "after": 0.99}, "file": "/home/anna/people/anna/person.toml",
}


class Session:
    """What the page is told. A test changes the attributes while the page looks."""

    def __init__(self, channels=8):
        self.channels = channels
        self.rights = "orders"
        self.gesture = "rest"
        #: Fields of the state that differ from an arm that follows.
        self.state = {}
        self.obeys = True
        self.is_silent = False
        self.accepts = True
        self.orders = []
        #: What was asked of the session, and how it answers.
        self.requests = []
        self.answer = {"ok": True, "text": "done"}
        self.kind = "session"
        #: Fields of the desk that differ from a session that lets the page do everything.
        self.desk = {}
        self._sockets = set()
        self._started_ns = time.monotonic_ns()
        session = self

        class Handler(Requests):
            of = session

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_port}/#{TOKEN}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.drop()
        self._server.shutdown()
        self._server.server_close()

    def drop(self):
        """Breaks every connection."""
        for socket in list(self._sockets):
            try:
                socket.shutdown(2)
            except OSError:
                pass

    def restart(self, kind="session"):
        """The next session, a calibration, or what could not begin takes the place of this one."""
        self.kind, self.state, self.desk = kind, {}, {}
        self._started_ns = time.monotonic_ns()
        self.drop()

    def hello(self):
        about = {
            "session": "browser-test", "version": "0.1.0", "rights": self.rights, "started_ns": self._started_ns,
            "source": "simulate", "sample_rate_hz": 2000.0, "bin_ms": BIN_MS, "kind": self.kind,
            "channels": [{"name": str(channel), "unit": "uV"} for channel in range(self.channels)],
        }
        if self.kind != "session":
            return about
        joints = [dict(a_mm=a, d_mm=d, alpha_rad=alpha, theta_offset_rad=0) for a, d, alpha in JOINTS]
        return about | {
            "person": None, "model": "models/cnn-five-gesture.onnx", "strategy": "threshold", "gestures": GESTURES,
            "modes": MODES, "workspace_mm": {"min": [200, -400, 150], "max": [600, 400, 650]}, "arm": {"joints": joints},
            "speed_mm_per_s": 50, "paper": {"median_ms": 326, "mean_ms": 324},
        }

    def whole_state(self):
        now_ns = time.monotonic_ns()
        return {
            "now_ns": now_ns, "captured_ns": now_ns, "elapsed_s": (now_ns - self._started_ns) / 1e9,
            "position_mm": START_MM, "orientation_rad": [math.pi, 0, 0], "joints_rad": JOINTS_RAD,
            "arm_is_silent": False, "moves": self.gesture != "rest", "speed_mm_per_s": 0.0, "gripper": 850.0, "permission": "granted", "stop_reason": None, "fault": None, "hindrance": None,
            "phase": "following", "gesture": self.gesture, "voted": self.gesture, "confidence": 0.93, "unsure": False,
            "novelty": 0.2, "probabilities": [0.93 if gesture == self.gesture else 0.014 for gesture in GESTURES],
            "efforts": [0.5] * len(GESTURES), "mode": 0, "calibration_left_ms": 0, "zone": None, "recording": (self.desk or {}).get("recording"),
            "lost_samples": 0, "lost_blocks": 0, "stale": 0, "restarts": 0, "clock_drift_ppm": 0.0, "troubles": [],
        } | (dict.fromkeys(OF_THE_ARM) | {"permission": "none"} if self.kind != "session" else self.state)

    def whole_desk(self):
        if self.desk is None:
            return None
        may_all = {"record": True, "gestures": True, "mode": True, "next": True}
        people = {} if self.rights == "watch" else {"people": ["anna", "bert"]}
        calibration = CUE if self.kind == "calibration" else None
        return {"can": may_all, "kind": self.kind, "recording": None, "recording_failure": None,
                "model": "/models/cnn-five-gesture.onnx, /models/rest-move.onnx", "person": None, "strategy": "threshold",
                "strategies": ["threshold", "two_stage", "direct", "personal"], "task": None,
                "calibration": calibration} | people | self.desk

    def take_request(self, what):
        self.requests.append(what)
        if self.answer["ok"] and self.obeys:
            if "record" in what:
                self.desk = {"recording": RECORDING if what["record"] else None}
            elif "gesture" in what:
                self.gesture = what["gesture"]["gesture"]
            elif "mode" in what:
                self.state = {"mode": [mode["name"] for mode in MODES].index(what["mode"])}

    def take_order(self, order):
        self.orders.append(order["what"])
        if self.obeys:
            stopped = {"permission": "stopped", "stop_reason": "ordered"}
            self.state = stopped if order["what"] == "stop" else {}

    def frame(self, first_bin, bins):
        """Bins of a signal that grows while a gesture is made."""
        header = struct.pack("<IIQQII", 0x474D4554, 1, first_bin, time.monotonic_ns(), self.channels, bins)
        size = 20.0 if self.gesture == "rest" else 180.0
        values = []
        for channel in range(self.channels):
            for index in range(bins):
                top = size * abs(math.sin(0.7 * (first_bin + index) + channel))
                values += [-top, top]
        values += [size / 2] * self.channels + [10.0] * self.channels
        return header + struct.pack(f"<{len(values)}f", *values)


LATENCY = {
    "hops": [{"name": name, "count": 100, "p50_us": 8.0, "p99_us": 31.0, "buckets": [[5, 20], [8, 60], [31, 20]]}
             for name in ("acquisition → dsp", "dsp → inference", "inference → decision", "decision → robot")],
    "newest_sample_to_command": {"count": 100, "p50_us": 850.0, "p99_us": 1900.0, "buckets": [[850, 100]]},
}


class Requests(http.server.BaseHTTPRequestHandler):
    """Answers one browser; `of` is the session."""

    of = None
    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass

    def do_GET(self):
        url = urllib.parse.urlsplit(self.path)
        if url.path == "/ws":
            is_known = urllib.parse.parse_qs(url.query).get("token") == [TOKEN]
            if is_known and self.of.accepts and "Sec-WebSocket-Key" in self.headers:
                self.serve_socket()
            else:
                self.answer(401 if not is_known else 503 if not self.of.accepts else 400)
            return
        path = WEB / (url.path.lstrip("/") or "index.html")
        if path.parent == WEB and path.is_file():
            self.answer(200, path.read_bytes(), TYPES[path.suffix])
        else:
            self.answer(404)

    def answer(self, status, body=b"", kind="text/plain"):
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", POLICY)
        self.end_headers()
        self.wfile.write(body)

    def serve_socket(self):
        key = self.headers["Sec-WebSocket-Key"] + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
        self.send_response(101)
        self.send_header("Upgrade", "websocket")
        self.send_header("Connection", "Upgrade")
        self.send_header("Sec-WebSocket-Accept", base64.b64encode(hashlib.sha1(key.encode()).digest()).decode())
        self.end_headers()
        self.close_connection = True
        self.sending = threading.Lock()
        self.of._sockets.add(self.connection)
        try:
            self.send({"hello": self.of.hello()})
            threading.Thread(target=self.tell, daemon=True).start()
            while True:
                self.hear(self.read_message())
        except (OSError, EOFError):
            pass
        finally:
            self.of._sockets.discard(self.connection)

    def hear(self, message):
        if "ping" in message:
            self.send({"pong": {"t": message["ping"]["t"], "now_ns": time.monotonic_ns()}})
        elif "order" in message:
            order = message["order"]
            self.of.take_order(order)
            self.send({"answer": {"id": order["id"], "order": order["what"], "ok": True, "text": "given"}})
        elif "request" in message:
            request = message["request"]
            self.of.take_request(request["what"])
            kind = next(iter(request["what"]))
            self.send({"answer": {"id": request["id"], "order": kind} | self.of.answer})

    def tell(self):
        """States and frames 30 times a second, latencies once."""
        next_bin = self.bin_now()
        turn = 0
        desk = None
        try:
            while self.connection in self.of._sockets:
                time.sleep(1 / 30)
                bins = self.bin_now() - next_bin
                if self.of.is_silent or bins == 0:
                    continue
                self.send(self.of.frame(next_bin, bins))
                next_bin += bins
                if desk != self.of.whole_desk():
                    desk = self.of.whole_desk()
                    self.send({"desk": desk})
                self.send({"state": self.of.whole_state()})
                if turn % 30 == 0:
                    self.send({"latency": LATENCY})
                turn += 1
        except OSError:
            pass

    @staticmethod
    def bin_now():
        return time.monotonic_ns() // (BIN_MS * 1_000_000)

    def send(self, message):
        is_text = not isinstance(message, bytes)
        payload = json.dumps(message).encode() if is_text else message
        first = 0x81 if is_text else 0x82
        length = len(payload)
        size = struct.pack("!B", length) if length < 126 else struct.pack("!BH", 126, length) if length < 65536 \
            else struct.pack("!BQ", 127, length)
        with self.sending:
            self.connection.sendall(bytes([first]) + size + payload)

    def read_message(self):
        """The next text of the page; pages send short, masked, whole texts."""
        first, length = self.read(2)
        if first & 0x0F == 8:
            raise EOFError
        length &= 0x7F
        if length == 126:
            (length,) = struct.unpack("!H", self.read(2))
        mask = self.read(4)
        return json.loads(bytes(byte ^ mask[index % 4] for index, byte in enumerate(self.read(length))))

    def read(self, count):
        data = self.rfile.read(count)
        if len(data) < count:
            raise EOFError
        return data
