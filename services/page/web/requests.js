// Requests to the session: all that is asked for but STOP and Arm. What was asked for is said to be done when the desk or the
// arm's state shows it; only what neither of them shows (a note) is done when the answer says so.
//
//   actions, next session, calibration ── ask ──▶ Requests ── request ──▶ server
//                        desk, state, answer ──▶    │
//                                                   └──▶ asked / done / not done, with the server's reason

import { Outcome } from "./outcome.js";
import { said, text } from "./texts.js";

const CONFIRMED_WITHIN_MS = 5000;

export class Requests {
  /** `changed` is called whenever something was asked for or has been settled. */
  constructor(connection, changed) {
    this.connection = connection;
    this.changed = changed;
    this.outcome = new Outcome(document.getElementById("request-outcome"));
    this.nextId = 1;
    this.asked = new Map();
  }

  isAsked(kind) {
    return this.asked.has(kind);
  }

  /**
   * Asks for `what`. `kind` names the request among those under way, `words` says what it is. `isDone(desk, state)` tells
   * whether it can be seen to be done, `whyNot(desk)` why it can be seen not to be. `outlives`: it is done when the next session or calibration has begun. `isQuiet`: only
   * what goes wrong is told. `done` and `failed` are called in the end, one of them.
   */
  ask(kind, what, options) {
    const { words, isDone = null, whyNot = null, outlives = false, isQuiet = false, withinMs = CONFIRMED_WITHIN_MS } = options;
    const { done, failed } = options;
    const id = this.nextId;
    this.nextId += 1;
    if (this.connection.why !== null || !this.connection.send({ request: { id, what } })) {
      this.outcome.tell(text("request-not-sent", { what: words }), "bad");
      failed?.();
      return;
    }
    const asked = { id, words, isDone, whyNot, outlives, isQuiet, done, failed };
    this.asked.set(kind, asked);
    if (!isQuiet) this.outcome.tell(text("request-asked", { what: words }), "wait");
    setTimeout(() => {
      if (this.asked.get(kind) === asked) this.fail(kind, "request-not-confirmed");
    }, withinMs);
    this.changed();
  }

  takeAnswer({ id, ok, key, values, text: words }) {
    for (const [kind, asked] of this.asked) {
      if (asked.id !== id) continue;
      if (!ok) this.fail(kind, "request-refused", said(`said.${key}`, values, words));
      else if (asked.outlives) asked.isAccepted = true;
      else if (asked.isDone === null) this.succeed(kind);
    }
  }

  /** The desk or the state has changed: is something that was asked for to be seen? */
  look(desk, state) {
    if (desk === null || state === null) return;
    for (const [kind, asked] of this.asked) {
      const whyNot = asked.whyNot?.(desk);
      if (asked.isDone?.(desk, state)) this.succeed(kind);
      else if (whyNot) this.fail(kind, "request-refused", whyNot);
    }
  }

  /** Whether the session has agreed to make way for the next. */
  get isChanging() {
    return [...this.asked.values()].some((asked) => asked.isAccepted);
  }

  /** Another session or calibration has begun, or could not: the page says why. */
  begunAnew(hasBegun) {
    for (const [kind, asked] of this.asked) {
      if (!asked.outlives) continue;
      if (hasBegun) this.succeed(kind);
      else this.fail(kind, "request-not-begun");
    }
  }

  /** The connection is gone: what was asked for is not confirmed by the next one. */
  lookAway() {
    for (const [kind, asked] of this.asked) if (!asked.outlives) this.fail(kind, "request-not-confirmed");
  }

  succeed(kind) {
    const { words, isQuiet, outlives, done } = this.asked.get(kind);
    this.asked.delete(kind);
    if (!isQuiet) this.outcome.tell(text(outlives ? "request-begun" : "request-done", { what: words }), "good");
    done?.();
    this.changed();
  }

  fail(kind, key, reason) {
    const { words, failed } = this.asked.get(kind);
    this.asked.delete(kind);
    this.outcome.tell(text(key, { what: words, reason }), "bad");
    failed?.();
    this.changed();
  }
}
