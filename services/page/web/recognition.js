// What the system thinks the hand does: probabilities, what was decided, and what that does to the arm.

import { hasText, number, show, text } from "./texts.js";

const DRAWN = ["rest", "extension", "flexion", "ulnar", "radial", "grip"];

/** A gesture's name in words: the default gestures have a text, a person's own are shown as they are called. */
export function gestureName(gesture) {
  return hasText(`gesture.${gesture}`) ? text(`gesture.${gesture}`) : gesture;
}

/** What a gesture does in the mode that is on: "+z", "gripper" …; undefined for nothing. */
export function actionOf(hello, state, gesture) {
  return hello.modes[modeIndex(hello, state)]?.motions[gesture];
}

/** The same in words, or null for nothing. */
export function motionOf(hello, state, gesture) {
  const motion = actionOf(hello, state, gesture);
  if (!motion || motion === "none" || motion === "nothing") return null;
  return hasText(`motion.${motion}`) ? text(`motion.${motion}`) : motion;
}

/** The name of a gesture's drawing. */
export function drawingOf(gesture) {
  return DRAWN.includes(gesture) ? gesture : "other";
}

/** The mode's place among the modes; it travels as place or as name. */
export function modeIndex(hello, state) {
  return typeof state.mode === "number" ? state.mode : hello.modes.findIndex(({ name }) => name === state.mode);
}

/** Puts the drawings into the document, from where they are shown at once whenever the gesture changes. */
export async function loadHands() {
  const file = await (await fetch("/hands.svg")).text();
  const drawings = document.importNode(new DOMParser().parseFromString(file, "image/svg+xml").documentElement, true);
  drawings.setAttribute("class", "for-ears");
  drawings.setAttribute("aria-hidden", "true");
  document.body.append(drawings);
}

export class Recognition {
  constructor() {
    const byId = (id) => document.getElementById(id);
    this.hand = byId("hand");
    this.gesture = byId("gesture");
    this.does = byId("gesture-does");
    this.mode = byId("mode");
    this.list = byId("probabilities");
    this.decided = byId("decided");
    this.rows = [];
  }

  setUp(hello) {
    this.hello = hello;
    this.rows = hello.gestures.map((gesture) => {
      const row = document.createElement("li");
      const [name, bar, share] = ["bar-name", "bar", "bar-share"].map((part) => {
        const element = row.appendChild(document.createElement("span"));
        element.className = part;
        return element;
      });
      const filled = bar.appendChild(document.createElement("span"));
      return { gesture, row, name, filled, share };
    });
    this.list.replaceChildren(...this.rows.map(({ row }) => row));
    this.list.classList.toggle("is-long", this.rows.length > 7);
  }

  showState(state) {
    const { hello } = this;
    const { voted } = state;
    // At rest the strategy "threshold" compares no gestures.
    const isInactive = hello.strategy === "threshold" && voted === "rest" && state.confidence === 1;
    const drawing = state.unsure ? "unsure" : drawingOf(voted);
    const href = `#hand-${drawing}`;
    const use = this.hand.firstElementChild;
    if (use.getAttribute("href") !== href) use.setAttribute("href", href);
    this.decided.classList.toggle("is-unsure", Boolean(state.unsure));
    show(this.gesture, voted == null ? "–" : state.unsure ? text("unsure") : gestureName(voted));
    const motion = voted == null ? null : motionOf(hello, state, voted);
    show(
      this.does,
      voted == null
        ? ""
        : state.unsure
          ? text("unsure-does", { gesture: gestureName(voted) })
          : isInactive
            ? text("decided-inactive")
            : text("decided-does", { motion: motion ?? text("motion.none"), confidence: number(state.confidence, 2) }),
    );
    const index = modeIndex(hello, state);
    const mode = hello.modes[index];
    show(this.mode, mode ? text("mode-is", { mode: mode.name, place: index + 1, count: hello.modes.length }) : "");
    this.rows.forEach(({ gesture, row, name, filled, share }, place) => {
      const probability = isInactive ? NaN : state.probabilities?.[place];
      const does = motionOf(hello, state, gesture);
      show(name, does ? text("gesture-does", { gesture: gestureName(gesture), motion: does }) : gestureName(gesture));
      filled.style.transform = `scaleX(${Number.isFinite(probability) ? probability : 0})`;
      show(share, number(probability, 2));
      row.classList.toggle("is-voted", gesture === voted && !state.unsure);
    });
  }
}
