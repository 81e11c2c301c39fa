"""A session that a test makes up: serves the page's files and speaks to them as the program `tendon-page` does.

    test ── attributes of Session ──▶ Session ── hello, state, latency, answers, frames ──▶ page
         ◀─ Session.orders ───────────────────◀─ orders, pings ──────────────────────────
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

    def hello(self):
        motions = dict(zip(GESTURES, ["none", "up", "down", "left", "right", "gripper"]))
        joints = [dict(a_mm=a, d_mm=d, alpha_rad=alpha, theta_offset_rad=0) for a, d, alpha in JOINTS]
        return {
            "session": "browser-test", "version": "0.1.0", "rights": self.rights, "started_ns": self._started_ns,
            "source": "simulate", "person": None, "model": "models/cnn-five-gesture.onnx", "strategy": "threshold",
            "sample_rate_hz": 2000.0, "channels": [{"name": str(channel), "unit": "uV"} for channel in range(self.channels)],
            "gestures": GESTURES, "modes": [{"name": "y-z", "motions": motions}],
            "workspace_mm": {"min": [200, -400, 150], "max": [600, 400, 650]}, "arm": {"joints": joints},
            "speed_mm_per_s": 50, "task": False, "paper": {"median_ms": 326, "mean_ms": 324}, "bin_ms": BIN_MS,
        }

    def whole_state(self):
        now_ns = time.monotonic_ns()
        return {
            "now_ns": now_ns, "captured_ns": now_ns, "elapsed_s": (now_ns - self._started_ns) / 1e9,
            "position_mm": START_MM, "orientation_rad": [math.pi, 0, 0], "joints_rad": JOINTS_RAD,
            "speed_mm_per_s": 0.0, "gripper": 850.0, "permission": "granted", "stop_reason": None, "hindrance": None,
            "phase": "following", "gesture": self.gesture, "voted": self.gesture, "confidence": 0.93, "unsure": False,
            "novelty": 0.2, "probabilities": [0.93 if gesture == self.gesture else 0.014 for gesture in GESTURES],
            "efforts": [0.5] * len(GESTURES), "mode": "y-z", "calibration_left_ms": 0, "zone": None, "recording": None,
            "lost_samples": 0, "lost_blocks": 0, "stale": 0, "restarts": 0, "clock_drift_ppm": 0.0, "troubles": [],
        } | self.state

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

    def tell(self):
        """States and frames 30 times a second, latencies once."""
        next_bin = self.bin_now()
        turn = 0
        try:
            while self.connection in self.of._sockets:
                time.sleep(1 / 30)
                bins = self.bin_now() - next_bin
                if self.of.is_silent or bins == 0:
                    continue
                self.send(self.of.frame(next_bin, bins))
                next_bin += bins
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
