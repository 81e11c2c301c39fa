// A guided calibration over the whole page: what to do now, how firmly, what is wrong; then the report.
//
//   desk.calibration ─▶ large line (calibrationStanding) · drawing · countdown · effort beside the asked one · progress
//   Enter, R, buttons ─▶ request {calibration: go-on | redo | stop}
//   the report's buttons ─▶ the next session or calibration

import { button, element, beginCalibration, beginSession, goBack } from "./next.js";
import { drawingOf, gestureName } from "./recognition.js";
import { number, said, show, text } from "./texts.js";

/** From this expected accuracy on a calibration is called so; texts.json says what that means. */
const GRADES = [
  [0.95, "very-good"],
  [0.85, "good"],
  [0.7, "fair"],
  [0, "poor"],
];
/** Below this, mistakes are common. */
const RELIABLE = 0.85;
/** A confusion with more than this share of its row is marked. */
const MARKED_SHARE = 0.1;

const byId = (id) => document.getElementById(id);
const percent = (share) => text("percent", { value: number(share === null ? null : 100 * share) });
const capital = (words) => words.slice(0, 1).toUpperCase() + words.slice(1);
/** The large line's colour for an expected accuracy. */
const toneOf = (accuracy) => (accuracy === null || accuracy >= RELIABLE ? "go" : accuracy >= 0.7 ? "wait" : "stop");
/** What a check round has shown; without one, what is expected. */
const accuracyOf = (report) => report?.check?.after ?? report?.expected_accuracy ?? null;
const gradeOf = (accuracy) => GRADES.find(([least]) => accuracy >= least)?.[1] ?? "poor";

/** The large line of a calibration; `calibration` is null until the desk has come. */
export function calibrationStanding(calibration, people) {
  if (calibration === null) return standing("away", "calibration-opening");
  const { name, phase, ask, gesture, trouble, error, report, may } = calibration;
  const places = {
    name,
    gesture: gesture == null ? "" : capital(gestureName(gesture)),
    seconds: calibration.countdown_s,
  };
  if (phase === "fitting") return standing("wait", "fitting", places);
  if (phase === "failed") return { tone: "stop", title: text("not-calibrated", places), detail: error ?? "" };
  if (phase === "stopped") {
    const detail = text(`calibration-stopped-${people.includes(name) ? "known" : "detail"}`, places);
    return { tone: "stop", title: text("calibration-stopped", places), detail };
  }
  if (phase === "done") {
    const accuracy = accuracyOf(report);
    const detail = accuracy === null ? "" : text(`grade.${gradeOf(accuracy)}`);
    return { tone: toneOf(accuracy), title: text("calibrated", places), detail };
  }
  if (trouble) return { tone: "stop", title: text("calibration-trouble"), detail: findingWords(trouble) };
  if (ask === "hold") return standing("go", gesture === "rest" ? "hold-rest" : "hold", places);
  if (ask === "relax") return standing("move", places.seconds == null ? "cue-relax" : "cue-countdown", places);
  // Before the source is there nothing is waited for that somebody could say.
  if (ask === "wait" && may.includes("go-on"))
    return standing("wait", phase === "check" ? "check-ready" : "calibration-ready", places);
  return standing("wait", "calibration-opening", places);
}

/** What is wrong, and what to do about it. */
function findingWords({ text: words, kind, repetition, ...values }) {
  const isOfRest = kind === "alike" && values.first === "rest";
  // Repetitions are counted from 0.
  return said(`finding.${isOfRest ? "like_rest" : kind}`, { ...values, repetition: (repetition ?? 0) + 1 }, words);
}

function standing(tone, key, places) {
  return { tone, title: text(key, places), detail: text(`${key}-detail`, places) };
}

export class Calibration {
  /** `openNext` opens the panel of all that can come next. */
  constructor(requests, openNext) {
    this.requests = requests;
    this.openNext = openNext;
    this.section = byId("calibration");
    this.orders = byId("calibration-orders");
    this.isOn = false;
    this.told = "";
    window.addEventListener("keydown", (event) => this.pressed(event));
  }

  setUp(hello) {
    this.hello = hello;
    this.isOn = hello.kind === "calibration";
    this.calibration = null;
    this.people = [];
    this.told = "";
    this.section.hidden = !this.isOn;
    document.body.classList.toggle("is-calibration", this.isOn);
    this.refresh();
  }

  showDesk(desk) {
    if (!this.isOn) return;
    this.calibration = desk?.calibration ?? null;
    this.people = desk?.people ?? [];
    this.refresh();
  }

  get isOver() {
    return ["done", "failed", "stopped"].includes(this.calibration?.phase);
  }

  /** Enter goes on and R does it again, unless a button or the report has the focus and takes the key itself. */
  pressed(event) {
    if (!this.isOn || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    const isButton = event.target instanceof HTMLButtonElement;
    if ((event.key === "Enter" || event.key === " ") && !isButton) this.order("go-on");
    else if (event.key.toLowerCase() === "r") this.order("redo");
    else return;
    event.preventDefault();
  }

  order(what) {
    if (this.hello.rights !== "orders" || !this.calibration?.may?.includes(what)) return;
    this.requests.ask("calibration", { calibration: what }, { words: text(`calibration.${what}`), isQuiet: true });
  }

  /** Writes what is asked now. */
  refresh() {
    const { calibration } = this;
    if (!this.isOn) return;
    show(byId("calibration-heading"), text("calibration-of", { name: calibration?.name ?? "–" }));
    const isCue = calibration !== null && !this.isOver && calibration.phase !== "fitting";
    for (const id of ["cue", "effort"]) byId(id).hidden = !isCue;
    byId("calibration-progress").hidden = calibration === null || this.isOver;
    byId("report").hidden = !this.isOver;
    this.refreshOrders();
    if (calibration === null) return;
    if (isCue) this.showCue();
    byId("progress-done").style.transform = `scaleX(${calibration.progress ?? 0})`;
    const isFitting = calibration.phase === "fitting";
    show(
      byId("progress-left"),
      isFitting
        ? text("fitting-left")
        : text("time-left", { seconds: number(Math.ceil(calibration.all_left_s ?? NaN)) }),
    );
    if (this.isOver) this.showReport();
  }

  showCue() {
    const { gesture, repetition, repetitions, countdown_s: countdown, ask, left_s: left, trouble } = this.calibration;
    const isRest = ask === "relax" && countdown == null;
    // While the muscles are to be loose the drawing is that of rest; what comes next is named beside it.
    const href = `#hand-${isRest ? "rest" : drawingOf(gesture)}`;
    const use = byId("cue-hand").firstElementChild;
    if (use.getAttribute("href") !== href) use.setAttribute("href", href);
    byId("cue").dataset.ask = ask;
    const name = gesture == null ? "–" : gestureName(gesture);
    const isNext = ask !== "hold" && gesture != null && !trouble;
    show(byId("cue-gesture"), isNext ? text("cue-next", { gesture: name }) : name);
    show(byId("cue-repetition"), repetitions > 1 ? text("cue-repetition", { repetition, repetitions }) : "");
    const isLeft = ask === "hold" && Number.isFinite(left);
    byId("countdown").classList.toggle("is-left", isLeft);
    const leftWords = isLeft ? text("seconds", { seconds: number(Math.ceil(left)) }) : "";
    show(byId("countdown"), countdown == null ? leftWords : String(countdown));
    this.showEffort();
  }

  showEffort() {
    const { effort_share: made, asked_effort_share: asked, ask } = this.calibration;
    const within = (share) => Math.max(0, Math.min(1, Number.isFinite(share) ? share : 0));
    byId("effort-made").style.transform = `scaleX(${within(made)})`;
    const mark = byId("effort-asked");
    mark.hidden = ask !== "hold" || !Number.isFinite(asked);
    mark.style.left = `${100 * within(asked)}%`;
    // In steps of a tenth: a screen reader would otherwise be told of every change.
    const step = (share) => percent(Number.isFinite(share) ? Math.round(10 * within(share)) / 10 : null);
    const label = text("effort-label", { made: step(made), asked: step(asked) });
    if (byId("effort").getAttribute("aria-label") !== label) byId("effort").setAttribute("aria-label", label);
  }

  /** The buttons of what may be done now, anew only when that changes: the focus stays where it is. */
  refreshOrders() {
    const may = this.hello.rights === "orders" && !this.isOver ? (this.calibration?.may ?? []) : [];
    const key = [...may, text("calibration.go-on"), this.requests.isAsked("calibration")].join(" ");
    if (this.orders.dataset.key === key) return;
    const focused = this.orders.contains(document.activeElement) ? document.activeElement.dataset.what : null;
    this.orders.dataset.key = key;
    const keys = { "go-on": "Enter", redo: "R" };
    this.orders.replaceChildren(
      ...["go-on", "redo", "stop"]
        .filter((what) => may.includes(what))
        .map((what) => {
          const made = button(text(`calibration.${what}`), () => this.order(what), what === "go-on" ? "begins" : "");
          made.dataset.what = what;
          if (keys[what]) made.append(" ", element("kbd", { words: keys[what] }));
          return made;
        }),
    );
    if (focused) this.orders.querySelector(`[data-what="${focused}"]`)?.focus();
  }

  /** The report, written once: it does not change any more. */
  showReport() {
    const told = JSON.stringify([this.calibration.report, this.calibration.phase, text("language-name")]);
    if (told === this.told) return;
    this.told = told;
    const { report } = this.calibration;
    const parts = report === null ? [] : [this.head(report), this.findings(report), this.tables(report)];
    byId("report").replaceChildren(this.reportOrders(), ...parts.filter(Boolean));
    byId("report").focus({ preventScroll: true });
  }

  reportOrders() {
    const { name, phase, report } = this.calibration;
    const box = element("div", { className: "report-orders" });
    if (this.hello.rights !== "orders") return box;
    if (phase === "done") {
      const session = { person: name, strategy: null, task: null };
      box.append(button(text("report-session", { name }), () => beginSession(this.requests, session), "begins"));
    }
    const options = phase === "done" ? { replace: true } : {};
    box.append(button(text("report-again"), () => beginCalibration(this.requests, { name, check: true, ...options })));
    if (report === null) box.append(button(text("report-back"), () => goBack(this.requests)));
    box.append(button(text("report-other"), this.openNext));
    return box;
  }

  head(report) {
    const accuracy = accuracyOf(report);
    const expected = { expected: percent(report.expected_accuracy ?? null), alike: percent(report.expected_if_alike ?? null) };
    const expectedKey = report.expected_if_alike == null ? "expected-later" : "expected-later-alike";
    const key = report.check ? "check-is" : accuracy === null ? "expected-unknown" : "expected-is";
    const words = element("div", { children: [element("p", { className: "expected", words: text(key) })] });
    const add = (line) => words.append(element("p", { className: "checked", words: line }));
    if (report.check && report.check.before != null) add(text("check-before", { before: percent(report.check.before) }));
    if (report.check && report.expected_accuracy != null) add(text(expectedKey, expected));
    else if (report.expected_if_alike != null) add(text("expected-alike", expected));
    const parts = [element("p", { className: "accuracy", words: percent(accuracy) }), words];
    return element("div", { className: "report-head", children: parts });
  }

  findings(report) {
    if ((report.findings ?? []).length === 0) return element("p", { className: "is-fine", words: text("no-findings") });
    return element("div", {
      className: "findings",
      children: [
        element("h3", { words: text("findings") }),
        element("ul", { children: report.findings.map((finding) => element("li", { words: findingWords(finding) })) }),
      ],
    });
  }

  tables(report) {
    return element("div", {
      className: "columns",
      children: [this.gestures(report), this.confusion(report), this.channels(report)].filter(Boolean),
    });
  }

  gestures(report) {
    const rows = (report.gestures ?? []).map(({ name, recall: expected }) => {
      const recall = report.check?.after_by_gesture?.[name] ?? expected;
      const redo = button(text("report-redo"), () =>
        beginCalibration(this.requests, { name: this.calibration.name, redo: name }),
      );
      redo.setAttribute("aria-label", text("report-redo-label", { gesture: gestureName(name) }));
      const mayRedo = this.hello.rights === "orders" && this.calibration.phase === "done";
      const share = element("td", { words: percent(recall ?? null), className: recall < RELIABLE ? "is-wrong" : "" });
      return [heading(gestureName(name)), share, mayRedo ? redo : ""];
    });
    return table(text("report-gestures"), [text("gesture"), text("recognised"), ""], rows);
  }

  confusion(report) {
    const { confusion } = report;
    if (!confusion) return null;
    const names = confusion.gestures.map(gestureName);
    const rows = confusion.counts.map((counts, row) => {
      const all = counts.reduce((sum, count) => sum + count, 0);
      const cells = counts.map((count, column) => {
        const share = all > 0 ? count / all : 0;
        const cell = element("td", { words: share < 0.005 ? "·" : number(100 * share) });
        if (row === column) cell.className = "is-right";
        else if (share > MARKED_SHARE) cell.className = "is-wrong";
        return cell;
      });
      return [heading(names[row]), ...cells];
    });
    return table(text("confusion"), [text("confusion-corner"), ...names], rows, "confusion");
  }

  channels(report) {
    const rows = (report.channels ?? []).map(({ name, snr_db: snr, remark }) => [
      heading(name),
      text("decibel", { value: number(snr, 0) }),
      element("td", { words: remark == null ? "" : text(`remark.${remark}`), className: "is-wrong" }),
    ]);
    return table(text("report-channels"), [text("channel"), text("snr"), text("remark")], rows);
  }
}

const heading = (words) => element("th", { words, scope: "row" });

function table(caption, heads, rows, className = "") {
  const cell = (content) =>
    content instanceof HTMLTableCellElement ? content : element("td", { children: [content] });
  return element("table", {
    className,
    children: [
      element("caption", { words: caption }),
      element("thead", {
        children: [
          element("tr", {
            children: heads.map((words) => (words === "" ? element("td") : element("th", { words, scope: "col" }))),
          }),
        ],
      }),
      element("tbody", { children: rows.map((row) => element("tr", { children: row.map(cell) })) }),
    ],
  });
}
