// The panel that ends this session and begins the next one, or a calibration. It covers values but neither STOP nor Arm.
//
//   person, strategy, task ─▶ next session            name, how often, check ─▶ calibration

import { text } from "./texts.js";

const TASKS = [null, "zones"];
const REPETITIONS = [1, 2, 3, 4];
const BEGUN_WITHIN_MS = 20_000;
const PERSON_NAME = /^[a-z0-9_-]{1,40}$/;

const byId = (id) => document.getElementById(id);

/** An element with a class, words and children. */
export function element(name, { className, words, children = [], ...properties } = {}) {
  const made = Object.assign(document.createElement(name), properties);
  if (className) made.className = className;
  if (words !== undefined) made.textContent = words;
  made.append(...children);
  return made;
}

export function button(words, pressed, className = "") {
  const made = element("button", { words, className, type: "button" });
  made.addEventListener("click", pressed);
  return made;
}

/** Asks for the next session; `person` is null for none. */
export function beginSession(requests, session) {
  requests.ask(
    "next",
    { next: { session } },
    {
      words: session.person === null ? text("do.session") : text("do.session-with", { person: session.person }),
      outlives: true,
      withinMs: BEGUN_WITHIN_MS,
    },
  );
}

/** After a calibration, asks for the session from which it was begun. */
export function goBack(requests) {
  requests.ask("next", { next: "back" }, { words: text("do.back"), outlives: true, withinMs: BEGUN_WITHIN_MS });
}

/** Asks for a calibration; what is not given is as in the terminal. */
export function beginCalibration(requests, options) {
  const calibrate = {
    gestures: null,
    repetitions: 1,
    check: false,
    redo: null,
    update: false,
    replace: false,
    ...options,
  };
  // An update asks for each gesture as often as it needs.
  if (calibrate.update) calibrate.repetitions = null;
  requests.ask(
    "next",
    { next: { calibrate } },
    {
      words: text("do.calibrate", { name: options.name }),
      outlives: true,
      withinMs: BEGUN_WITHIN_MS,
    },
  );
}

export class NextPanel {
  constructor(requests) {
    this.requests = requests;
    this.panel = byId("next");
    this.opener = byId("next-open");
    this.opener.addEventListener("click", () => (this.panel.hidden ? this.open() : this.close()));
    window.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !this.panel.hidden && event.target !== byId("note-text")) this.close();
    });
  }

  setUp(hello) {
    this.hello = hello;
    this.desk = null;
    this.close();
  }

  showDesk(desk) {
    this.desk = desk;
    if (!desk?.can?.next) this.close();
  }

  open() {
    const { desk } = this;
    if (!desk) return;
    const people = desk.people ?? [];
    this.chosen = {
      person: people.includes(desk.person) ? desk.person : null,
      strategy: desk.strategy,
      task: desk.task?.kind ?? null,
      name: "",
      repetitions: 1,
      check: true,
      how: "update",
    };
    this.panel.hidden = false;
    this.opener.setAttribute("aria-expanded", "true");
    this.refresh();
    this.panel.focus();
  }

  close() {
    if (this.panel.hidden) return;
    const hadFocus = this.panel.contains(document.activeElement);
    this.panel.hidden = true;
    this.opener.setAttribute("aria-expanded", "false");
    if (hadFocus) this.opener.focus();
  }

  /** Writes the panel: it was opened, or the language has changed. */
  refresh() {
    if (this.panel.hidden) return;
    const { desk, chosen } = this;
    const strategies = desk.strategies ?? [];
    const close = button("×", () => this.close(), "closes");
    close.setAttribute("aria-label", text("close"));
    const heading = element("h2", { id: "next-heading", words: text("next-heading") });
    const person = this.choices(
      "next-person",
      [null, ...(desk.people ?? [])],
      "person",
      (name) => name ?? text("nobody"),
    );
    const strategy = this.choices("next-strategy", strategies, "strategy", (name) => text(`strategy.${name}`));
    const task = this.choices("next-task", TASKS, "task", (name) => text(`task.${name ?? "none"}`));
    // A person's recogniser and the strategy "personal" belong together.
    person.addEventListener("click", () => {
      const others = strategies.filter((name) => name !== "personal");
      if (chosen.person !== null) chosen.strategy = "personal";
      else if (chosen.strategy === "personal") chosen.strategy = others[0] ?? "threshold";
      strategy.refresh();
    });
    const wrong = element("p", { className: "is-wrong", role: "alert" });
    strategy.addEventListener("click", () => {
      if (chosen.strategy !== "personal") chosen.person = null;
      person.refresh();
    });
    for (const part of [person, strategy]) part.addEventListener("click", () => (wrong.textContent = ""));
    const beginsSession = () => {
      if (chosen.strategy === "personal" && chosen.person === null) wrong.textContent = text("next-person-missing");
      else beginSession(this.requests, { person: chosen.person, strategy: chosen.strategy, task: chosen.task });
    };
    const begin = button(text("next-begin"), beginsSession, "begins");
    const session = element("div", {
      className: "column",
      children: [element("h3", { words: text("next-session") }), person, strategy, task, wrong, begin],
    });
    const notes = ["next-note", ...(desk.recording == null ? [] : ["next-note-recording"])];
    const note = element("p", { className: "facts", words: notes.map((key) => text(key)).join(" ") });
    const columns = element("div", { className: "columns", children: [session, this.calibration()] });
    this.panel.replaceChildren(element("div", { className: "head", children: [heading, close] }), note, columns);
  }

  calibration() {
    const { chosen } = this;
    const field = element("input", {
      id: "calibrate-name",
      type: "text",
      maxLength: 40,
      autocomplete: "off",
      spellcheck: false,
      value: chosen.name,
    });
    field.setAttribute("autocapitalize", "none");
    const label = element("label", { words: text("calibrate-name"), htmlFor: field.id });
    const known = this.choices("calibrate-known", ["update", "replace"], "how", (how) => text(`calibrate.${how}`));
    const repetitions = this.choices("calibrate-repetitions", REPETITIONS, "repetitions", String);
    const wrong = element("p", { id: "calibrate-wrong", className: "is-wrong", role: "alert" });
    const refresh = () => {
      chosen.name = field.value.trim();
      known.hidden = !(this.desk.people ?? []).includes(chosen.name);
      repetitions.hidden = !known.hidden && chosen.how === "update";
      wrong.textContent = "";
    };
    field.addEventListener("input", refresh);
    known.addEventListener("click", refresh);
    refresh();
    const begin = () => {
      if (!PERSON_NAME.test(chosen.name)) {
        wrong.textContent = text("calibrate-wrong-name");
        field.focus();
        return;
      }
      const { name, repetitions, check } = chosen;
      const how = known.hidden ? {} : { [chosen.how]: true };
      beginCalibration(this.requests, { name, repetitions, check, ...how });
    };
    field.addEventListener("keydown", (event) => {
      if (event.key === "Enter") begin();
    });
    return element("div", {
      className: "column",
      children: [
        element("h3", { words: text("calibrate") }),
        element("div", { className: "field", children: [label, field] }),
        wrong,
        known,
        repetitions,
        this.choices("calibrate-check", [true, false], "check", (isOn) => text(isOn ? "yes" : "no")),
        button(text("calibrate-begin"), begin, "begins"),
      ],
    });
  }

  /** Buttons of which one is on; no list, which would take the space bar for itself. */
  choices(key, options, name, wordsOf) {
    const id = `${key}-label`;
    const group = element("div", { className: "choices" });
    group.setAttribute("role", "group");
    group.setAttribute("aria-labelledby", id);
    const buttons = options.map((option) => {
      const made = button(wordsOf(option), () => {
        this.chosen[name] = option;
        box.refresh();
      });
      made.dataset.option = String(option);
      return made;
    });
    group.append(...buttons);
    const box = element("div", { className: "field", children: [element("p", { id, words: text(key) }), group] });
    box.dataset.choice = name;
    box.refresh = () =>
      buttons.forEach((made, place) => made.setAttribute("aria-pressed", String(options[place] === this.chosen[name])));
    box.refresh();
    return box;
  }
}
