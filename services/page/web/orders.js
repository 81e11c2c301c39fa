// STOP and Arm. A button says "asked" when it was pressed and "stopped" only when the arm's state says so.

import { Outcome } from "./outcome.js";
import { said, show, text } from "./texts.js";

/** An order that the arm's state does not confirm within this time is said to be unconfirmed. */
const CONFIRMED_WITHIN_MS = 700;

/** Nobody has taken in a stop before it was shown for this long, and the robot obeys no order to arm before. */
const REACTION_MS = 200;

/** While it comes up and goes to its start position the arm moves, or soon will, though it follows no gesture. */
const isUnderWay = (state) => ["bringing-up", "going-to-start"].includes(state.phase);

export class Orders {
  constructor(connection) {
    this.connection = connection;
    this.next = 1;
    this.asked = new Map();
    // Whether a stop was said to be unconfirmed.
    this.isStopUnconfirmed = false;
    this.rights = null;
    this.state = null;
    // Since when the arm is seen to be stopped.
    this.stoppedMs = null;
    this.stop = document.getElementById("stop");
    this.arm = document.getElementById("arm");
    this.note = document.getElementById("note-text");
    this.outcome = new Outcome(document.getElementById("order-outcome"));
    this.isCalibration = false;
    this.listen();
    this.refresh();
  }

  listen() {
    // A finger that goes down counts, not one that comes up; the click that follows it is the same press.
    let pressedMs = -Infinity;
    this.stop.addEventListener("pointerdown", () => {
      pressedMs = performance.now();
      this.give("stop");
    });
    this.stop.addEventListener("click", () => {
      if (performance.now() - pressedMs > 1000) this.give("stop");
      pressedMs = -Infinity;
    });
    this.arm.addEventListener("click", () => {
      if (this.canArm) this.give("arm");
    });
    // The space bar stops whatever has the focus, ahead of everything else that would take it. In a note one types a space
    // and two stop: whoever is startled strikes the bar more than once. A calibration has no arm to stop.
    const isSpace = (event) => event.code === "Space" || event.key === " ";
    window.addEventListener(
      "keydown",
      (event) => {
        if (!isSpace(event) || this.isCalibration || this.typesSpace(event)) return;
        event.preventDefault();
        event.stopImmediatePropagation();
        if (!event.repeat || event.target === this.note) this.give("stop");
        this.note.blur();
      },
      true,
    );
    window.addEventListener(
      "keyup",
      (event) => {
        if (isSpace(event) && !this.isCalibration) event.preventDefault();
      },
      true,
    );
    for (const kind of ["focus", "blur"]) this.note.addEventListener(kind, () => this.refresh());
    this.note.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.note.blur();
    });
  }

  /** Whether this press of the space bar belongs to the note: it follows a letter. */
  typesSpace(event) {
    if (event.target !== this.note || event.repeat) return false;
    const before = this.note.value.slice(0, this.note.selectionStart);
    return before !== "" && !before.endsWith(" ");
  }

  setUp(hello) {
    this.rights = hello.rights;
    this.isCalibration = hello.kind === "calibration";
    this.refresh();
  }

  give(what) {
    if (this.rights === "watch") {
      this.tell("only-watches", "bad");
      return;
    }
    const id = this.next;
    this.next += 1;
    // A session that is silent may still hear: only STOP is tried then.
    const isHeard = this.connection.why === null || what === "stop";
    // Which state of the arm this is about: if it was stopped since, it stays so.
    const seen = what === "arm" ? { seen_ns: this.state.seen_ns } : {};
    if (!isHeard || !this.connection.send({ order: { id, what, ...seen } })) {
      this.tell(what === "stop" ? "stop-not-sent" : "arm-not-sent", "bad");
      return;
    }
    const asked = { id };
    this.asked.set(what, asked);
    this.tell(`${what}-asked`, "wait");
    setTimeout(() => {
      if (this.asked.get(what) !== asked) return;
      this.asked.delete(what);
      this.tellUnconfirmed(what);
      this.refresh();
    }, CONFIRMED_WITHIN_MS);
    this.refresh();
  }

  /** The server's answer: only a refusal is news, since the state confirms what was done. */
  takeAnswer({ id, order, ok, key, values, text: words }) {
    const asked = this.asked.get(order);
    if (ok || asked?.id !== id) return;
    this.asked.delete(order);
    this.isStopUnconfirmed ||= order === "stop";
    this.tell("order-refused", "bad", { words: said(`said.${key}`, values, words) });
    this.refresh();
  }

  showState(state) {
    const rests = ({ permission, stop_reason: reason }) => permission === "await-rest" && Boolean(reason);
    if (rests(state) && this.state?.permission === "granted")
      this.tell("rested", "wait", { reason: text(`reason.${state.stop_reason}`) });
    const isStopped = state.permission === "stopped" && !state.arm_is_silent;
    // "The arm may move" is not true any more.
    if (isStopped && this.state?.permission !== "stopped") this.outcome.clear();
    if (isStopped && (this.asked.delete("stop") || this.isStopUnconfirmed)) {
      this.isStopUnconfirmed = false;
      this.tell("stop-confirmed", "good");
    }
    // It has obeyed, too, when it goes to its start position first.
    const obeys = state.permission !== "stopped" ? "arm-confirmed" : isUnderWay(state) ? "arm-goes-to-start" : null;
    if (obeys && !state.arm_is_silent && this.asked.delete("arm")) this.tell(obeys, "good");
    this.state = state;
    this.refresh();
  }

  /** Values have stopped, with a reason, or come again: no order of a connection that is gone is confirmed by the next. */
  lookAway(why) {
    if (why !== null) this.state = null;
    for (const what of [...this.asked.keys()]) {
      this.asked.delete(what);
      this.tellUnconfirmed(what);
    }
    this.refresh();
  }

  tellUnconfirmed(what) {
    this.isStopUnconfirmed ||= what === "stop";
    this.tell(`${what}-not-confirmed`, "bad");
  }

  tell(key, tone, places) {
    this.outcome.tell(text(key, places), tone);
  }

  refresh() {
    const { state } = this;
    const isStopped = state?.permission === "stopped" && !state.arm_is_silent && !isUnderWay(state);
    this.stoppedMs = isStopped ? (this.stoppedMs ?? performance.now()) : null;
    const stopKey = this.asked.has("stop") ? "stop-button-asked" : isStopped ? "stop-button-stopped" : "stop-button";
    show(this.stop.firstElementChild, text(stopKey));
    show(this.stop.lastElementChild, text(this.stopNote()));
    show(this.arm.firstElementChild, text(this.asked.has("arm") ? "arm-button-asked" : "arm-button"));
    show(this.arm.lastElementChild, text("arm-note"));
    this.stop.classList.toggle("is-watching", this.rights === "watch");
    this.arm.classList.toggle("is-asked", this.asked.has("arm"));
    this.stop.classList.toggle("is-away", !this.connection.isOpen);
    this.stop.classList.toggle("is-asked", this.asked.has("stop"));
    this.stop.classList.toggle("is-stopped", isStopped);
    this.stop.setAttribute("aria-disabled", String(this.rights === "watch"));
    // Not disabled, which would take the focus away from whoever works by keyboard.
    this.canArm = isStopped && this.rights !== "watch" && performance.now() - this.stoppedMs > REACTION_MS;
    this.arm.setAttribute("aria-disabled", String(!this.canArm));
  }

  stopNote() {
    if (this.rights === "watch") return "watch-note";
    if (!this.connection.isOpen) return "away-note";
    return document.activeElement === this.note ? "stop-note-typing" : "stop-note";
  }
}
