// What the session is: its source, person, model, strategy, recording and time.

import { hasText, show, text } from "./texts.js";

export class SessionFacts {
  constructor() {
    this.list = document.getElementById("session-facts");
    this.values = new Map();
  }

  setUp(hello) {
    this.hello = hello;
    this.state = this.desk = null;
    this.refresh();
  }

  /** Writes the list anew: the session or the language has changed. */
  refresh() {
    if (!this.hello) return;
    const { hello } = this;
    const ofSession =
      hello.kind === "calibration"
        ? {}
        : {
            person: hello.person ?? text("no-person"),
            model: "",
            strategy: text(`strategy.${hello.strategy}`),
            recording: "",
          };
    const fixed = { session: hello.session, source: sourceName(hello.source), ...ofSession, time: "", version: hello.version };
    this.values.clear();
    this.list.replaceChildren(
      ...Object.entries(fixed).map(([key, value]) => {
        const pair = document.createElement("div");
        pair.dataset.fact = key;
        const term = pair.appendChild(document.createElement("dt"));
        const words = pair.appendChild(document.createElement("dd"));
        term.textContent = text(`session.${key}`);
        words.textContent = words.title = value;
        this.values.set(key, words);
        return pair;
      }),
    );
    this.showDesk(this.desk);
    if (this.state) this.showState(this.state);
  }

  /** The models that run; a person has none. `desk` is null while nobody tells it. */
  showDesk(desk) {
    this.desk = desk;
    const model = this.values.get("model");
    if (!model) return;
    model.title = desk?.model ?? "";
    const names = model.title.split(", ").filter((path) => path.endsWith(".onnx")).map(fileName);
    show(model, names.join(", ") || text("none"));
  }

  showState(state) {
    this.state = state;
    show(this.values.get("time"), clock(state.elapsed_s));
    const recording = this.values.get("recording");
    if (!recording) return;
    show(recording, state.recording ? `● ${recordingName(state.recording)}` : text("not-recorded"));
    recording.classList.toggle("is-recording", Boolean(state.recording));
  }
}

/** The kind of source in words; the name of a program as it is. */
function sourceName(source) {
  return hasText(`source.${source}`) ? text(`source.${source}`) : source;
}

/** The last part of a path. */
export function fileName(path) {
  return path == null ? null : path.split("/").at(-1);
}

/** A recording has a folder of its own, whose name, the time it began at, tells it from the others. */
export function recordingName(path) {
  return path.split("/").at(-2) ?? path;
}

/** Seconds as h:mm:ss. */
export function clock(seconds) {
  const whole = Math.floor(seconds);
  const two = (value) => String(value).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}
