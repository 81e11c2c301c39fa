// What a page with orders does in a session: recording, notes, gestures of the simulated muscles, modes.

import { drawingOf, gestureName, modeIndex, motionOf } from "./recognition.js";
import { clock, recordingName } from "./session.js";
import { show, text } from "./texts.js";

/** The terminal's letters for the gestures of the paper; every gesture up to the tenth also has its number. */
const LETTERS = { rest: "n", extension: "e", flexion: "f", ulnar: "u", radial: "r", grip: "g" };
/** Letters of a note that are said again. */
const LONGEST_SHOWN = 60;
const MODE_WITHIN_MS = 2000;

const byId = (id) => document.getElementById(id);

export class Actions {
  constructor(requests) {
    this.requests = requests;
    this.hello = this.desk = this.state = null;
    this.made = null;
    this.recordedSinceMs = null;
    byId("record").addEventListener("click", () => this.toggleRecording());
    byId("marker").addEventListener("click", () => this.leaveNote(text("marker"), () => {}));
    byId("note").addEventListener("submit", (event) => {
      event.preventDefault();
      const field = byId("note-text");
      const words = field.value.trim();
      if (words === "") field.focus();
      else
        this.leaveNote(words, () => {
          // What was typed meanwhile stays.
          if (field.value.trim() === words) field.value = "";
        });
    });
    window.addEventListener("keydown", (event) => this.pressed(event));
  }

  setUp(hello) {
    this.hello = hello;
    this.desk = this.state = this.made = this.recordedSinceMs = null;
    this.gestures = hello.gestures ?? [];
    this.keys = new Map();
    const buttons = this.gestures.map((gesture, number) => {
      const keys = [LETTERS[gesture], number <= 9 ? String(number) : undefined].filter(Boolean);
      for (const key of keys) this.keys.set(key, gesture);
      return this.gestureButton(keys[0] ?? "", gesture);
    });
    byId("make-gestures").replaceChildren(...buttons);
    const label = Object.assign(document.createElement("span"), { className: "label" });
    byId("modes").replaceChildren(label, ...(hello.modes ?? []).map(({ name }) => this.modeButton(name)));
    this.refresh();
  }

  gestureButton(key, gesture) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.gesture = gesture;
    button.innerHTML = `<svg viewBox="0 0 120 96" aria-hidden="true"><use href="#hand-${drawingOf(gesture)}"></use></svg>`;
    const name = button.appendChild(document.createElement("span"));
    name.className = "make-name";
    button.appendChild(document.createElement("kbd")).textContent = key;
    button.addEventListener("click", () => this.make(gesture));
    return button;
  }

  modeButton(name) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.addEventListener("click", () => {
      const place = this.hello.modes.findIndex((mode) => mode.name === name);
      this.requests.ask(
        "mode",
        { mode: name },
        {
          words: text("do.mode", { mode: name }),
          isDone: (_, state) => modeIndex(this.hello, state) === place,
          withinMs: MODE_WITHIN_MS,
        },
      );
    });
    return button;
  }

  /** Single keys make gestures, as in the terminal, wherever nothing is typed. */
  pressed(event) {
    if (!this.can.gestures || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.target instanceof HTMLInputElement) return;
    const gesture = this.keys.get(event.key.toLowerCase());
    if (gesture !== undefined) this.make(gesture);
  }

  make(gesture) {
    const before = this.made;
    this.made = gesture;
    this.requests.ask(
      "gesture",
      { gesture: { gesture, effort: 1 } },
      {
        words: gestureName(gesture),
        isQuiet: true,
        failed: () => {
          if (this.made === gesture) this.made = before;
        },
      },
    );
    this.refresh();
  }

  toggleRecording() {
    const isOn = this.recording !== null;
    const before = this.desk.recording_failure;
    this.requests.ask(
      "record",
      { record: !isOn },
      {
        words: text(isOn ? "do.record-off" : "do.record-on"),
        isDone: (desk) => (desk.recording !== null) !== isOn,
        whyNot: (desk) => (desk.recording_failure === before ? null : desk.recording_failure),
      },
    );
  }

  leaveNote(note, done) {
    const words = note.length > LONGEST_SHOWN ? `${note.slice(0, LONGEST_SHOWN)}…` : note;
    this.requests.ask("note", { note }, { words: text("do.note", { note: words }), done });
  }

  /** What this page may do now. */
  get can() {
    const { hello, desk } = this;
    return hello?.rights === "orders" && hello.kind !== "calibration" ? (desk?.can ?? {}) : {};
  }

  get recording() {
    return this.desk?.recording ?? null;
  }

  /** `desk` is null while nobody tells it. */
  showDesk(desk) {
    const before = this.desk;
    this.desk = desk;
    if (this.recording === null) this.recordedSinceMs = null;
    // Since when an older recording runs is not known.
    else if (before !== null && before.recording !== this.recording) this.recordedSinceMs = performance.now();
    this.refresh();
  }

  showState(state) {
    this.state = state;
    this.refresh();
  }

  /** Values have stopped: what could be done is not known. */
  lookAway() {
    this.desk = this.state = null;
    this.recordedSinceMs = null;
  }

  refresh() {
    const { requests, hello, state } = this;
    if (hello === null) return;
    const { can } = this;
    const mayAnything = can.record || can.next || can.gestures || can.mode;
    byId("actions").hidden = !mayAnything;
    byId("record").hidden = byId("note").hidden = !can.record && this.recording === null;
    byId("next-open").hidden = !can.next;
    byId("make").hidden = !can.gestures;
    byId("modes").hidden = !can.mode || (hello.modes ?? []).length < 2;
    // The buttons tell the mode, too.
    byId("mode").hidden = !byId("modes").hidden;
    this.refreshRecording();
    show(byId("modes").firstElementChild, text("modes-label"));
    const modeNow = state === null ? -1 : modeIndex(hello, state);
    [...byId("modes").querySelectorAll("button")].forEach((button, place) =>
      button.setAttribute("aria-pressed", String(place === modeNow)),
    );
    for (const button of byId("make-gestures").children) {
      const { gesture } = button.dataset;
      const motion = state === null ? null : motionOf(hello, state, gesture);
      show(button.querySelector(".make-name"), gestureName(gesture));
      button.title = motion ? text("gesture-does", { gesture: gestureName(gesture), motion }) : gestureName(gesture);
      button.setAttribute("aria-pressed", String(gesture === this.made));
      button.classList.toggle("is-asked", gesture === this.made && requests.isAsked("gesture"));
    }
  }

  refreshRecording() {
    const { requests, recording } = this;
    const isOn = recording !== null;
    const failure = isOn ? null : this.desk?.recording_failure;
    byId("no-recording").hidden = !failure;
    show(byId("no-recording"), failure ? text("no-recording", { reason: failure }) : "");
    const button = byId("record");
    button.classList.toggle("is-on", isOn);
    button.classList.toggle("is-asked", requests.isAsked("record"));
    const key = requests.isAsked("record") ? "record-asked" : isOn ? "record-off" : "record-on";
    show(byId("record-name"), text(key));
    const since = this.recordedSinceMs === null ? null : clock((performance.now() - this.recordedSinceMs) / 1000);
    show(byId("record-facts"), [isOn ? recordingName(recording) : null, since].filter(Boolean).join(" · "));
    button.title = recording ?? "";
    for (const id of ["marker", "note-add"]) byId(id).setAttribute("aria-disabled", String(!isOn));
  }
}
