// The connection to the server: comes back by itself, and knows the difference between the server's clock and the page's.
//
//   server ── hello, state, desk, latency, answer (text), frame (binary) ──▶ handlers
//          ◀── ping, order, request ──

const PING_MS = 1000;
/** Until so many pings were answered they go out four times as often. */
const FEW_TRIPS = 8;
/** The arm's state comes 30 times a second; after so long without any, what is shown is old. */
const SILENCE_MS = 1000;
const FIRST_RETRY_MS = 300;
const LAST_RETRY_MS = 3000;
const FRAME_WORD = 0x474d4554;
const FRAME_VERSION = 1;
const FRAME_HEADER_BYTES = 32;

/** With these words the server ends the connection when the session has ended as it should. */
const SESSION_ENDED = "session-ended";

/** Why there are no values: words of texts.json, under "away". */
const AWAY = {
  opening: "opening",
  lost: "lost",
  silent: "silent",
  noToken: "no-token",
  refused: "refused",
  forbidden: "forbidden",
  full: "full",
  noSession: "no-session",
  ended: "ended",
};

export class Connection {
  /** `handlers`: hello, state, desk, latency, answer, frame, and away, with a reason when values stop and null when they come. */
  constructor(handlers) {
    this.handlers = handlers;
    this.token = location.hash.slice(1);
    this.retryMs = FIRST_RETRY_MS;
    this.heardMs = performance.now();
    this.why = undefined;
    // Round trips of the last pings; the shortest tells the clock difference best.
    this.trips = [];
    this.pingedMs = -Infinity;
  }

  begin() {
    setInterval(() => this.tick(), PING_MS / 4);
    this.setAway(AWAY.opening);
    this.open();
  }

  get isOpen() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  open() {
    if (this.token === "") {
      this.setAway(AWAY.noToken);
      return;
    }
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/ws?token=${encodeURIComponent(this.token)}`);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    let wasOpen = false;
    socket.onopen = () => {
      wasOpen = true;
      this.retryMs = FIRST_RETRY_MS;
      this.trips = [];
      this.pingedMs = -Infinity;
      this.tick();
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this.hear(JSON.parse(event.data));
      else this.hearFrame(event.data);
    };
    socket.onclose = ({ reason }) => {
      if (reason === SESSION_ENDED) this.setAway(AWAY.ended);
      else if (wasOpen || this.why !== AWAY.ended) this.setAway(AWAY.lost);
      if (!wasOpen) this.askWhy();
      setTimeout(() => this.open(), this.retryMs);
      this.retryMs = Math.min(this.retryMs * 2, LAST_RETRY_MS);
    };
  }

  /** A browser does not tell a script why a socket was refused; an ordinary request to the same place does. */
  async askWhy() {
    try {
      const { status } = await fetch(`/ws?token=${encodeURIComponent(this.token)}`, { cache: "no-store" });
      if (this.isOpen) return;
      if (status === 401) this.setAway(AWAY.refused);
      else if (status === 403) this.setAway(AWAY.forbidden);
      else if (status === 503) this.setAway(AWAY.full);
    } catch {
      // The server is not there: the connection is lost, as is shown already.
    }
  }

  tick() {
    if (!this.isOpen) return;
    const nowMs = performance.now();
    if (nowMs - this.pingedMs >= (this.trips.length < FEW_TRIPS ? PING_MS / 4 : PING_MS)) {
      this.pingedMs = nowMs;
      this.send({ ping: { t: nowMs } });
    }
    if (this.why === null && nowMs - this.heardMs > SILENCE_MS && !document.hidden) this.setAway(AWAY.silent);
  }

  hear(message) {
    if (message.pong) {
      const nowMs = performance.now();
      const tripMs = nowMs - message.pong.t;
      this.trips.push({ tripMs, offsetMs: message.pong.now_ns / 1e6 - (message.pong.t + tripMs / 2) });
      if (this.trips.length > 20) this.trips.shift();
    } else if (message.state) {
      this.heardMs = performance.now();
      this.setAway(null);
      this.handlers.state(message.state);
    } else if (message.hello) this.handlers.hello(message.hello);
    else if (message.hello === null) this.setAway(AWAY.noSession);
    else if ("desk" in message) this.handlers.desk(message.desk);
    else if (message.latency) this.handlers.latency(message.latency);
    else if (message.answer) this.handlers.answer(message.answer);
  }

  hearFrame(buffer) {
    if (buffer.byteLength < FRAME_HEADER_BYTES) return;
    const view = new DataView(buffer);
    if (view.getUint32(0, true) !== FRAME_WORD || view.getUint32(4, true) !== FRAME_VERSION) return;
    const channels = view.getUint32(24, true);
    const bins = view.getUint32(28, true);
    if (buffer.byteLength !== FRAME_HEADER_BYTES + 4 * channels * (2 * bins + 2)) return;
    const values = new Float32Array(buffer, FRAME_HEADER_BYTES);
    this.handlers.frame({
      firstBin: Number(view.getBigUint64(8, true)),
      capturedMs: Number(view.getBigUint64(16, true)) / 1e6,
      channels,
      bins,
      extremes: values.subarray(0, 2 * channels * bins),
      envelope: values.subarray(2 * channels * bins, channels * (2 * bins + 1)),
      rest: values.subarray(channels * (2 * bins + 1)),
    });
  }

  setAway(why) {
    if (why === this.why) return;
    this.why = why;
    this.handlers.away(why);
  }

  /** Sends at once or not at all: an order that waits for a connection would come when nobody expects it. */
  send(message) {
    if (!this.isOpen) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** The server's clock less the page's in ms, or null while it is not known. */
  clockOffsetMs() {
    if (this.trips.length === 0) return null;
    return this.trips.reduce((least, trip) => (trip.tripMs < least.tripMs ? trip : least)).offsetMs;
  }
}
