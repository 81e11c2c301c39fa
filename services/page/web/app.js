// The page of a session.
//
//   server ─▶ Connection ─▶ newest state, desk, frames ─▶ at the next frame of the screen: traces, recognition, arm, large line
//   STOP, Arm, space bar ─▶ Orders ─────────────────────────────┬▶ Connection ─▶ server
//   Actions, NextPanel, Calibration (all else) ─▶ Requests ─────┘
//
// Messages are only kept when they come; everything is drawn at most once for each frame of the screen. A tab that nobody
// sees therefore draws nothing, and shows the newest values when it is seen again.

import { Actions } from "./actions.js";
import { ArmView } from "./arm.js";
import { Calibration, calibrationStanding } from "./calibration.js";
import { Connection } from "./connection.js";
import { Latency } from "./latency.js";
import { NextPanel } from "./next.js";
import { Orders } from "./orders.js";
import { readColours } from "./paint.js";
import { loadHands, Recognition } from "./recognition.js";
import { Requests } from "./requests.js";
import { SessionFacts } from "./session.js";
import { standing } from "./state.js";
import { Task } from "./task.js";
import { chooseLanguage, language, languages, loadTexts, show, text } from "./texts.js";
import { Traces } from "./traces.js";

const byId = (id) => document.getElementById(id);

await Promise.all([loadTexts(), loadHands()]);
readColours();

let hello = null;
let state = null;
let desk = null;
let isStateNew = false;
let isScheduled = false;
let spoken = "";
let spokenTone = "";
let spokenMs = -Infinity;

function redraw() {
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(draw);
}

const traces = new Traces(redraw);
const recognition = new Recognition();
const arm = new ArmView(redraw);
const latency = new Latency();
const session = new SessionFacts();
const task = new Task();

const connection = new Connection({
  hello(newHello) {
    if (hello !== null && hello.started_ns !== newHello.started_ns) requests.begunAnew(newHello.kind !== "failed");
    hello = newHello;
    state = desk = null;
    document.title = `${hello.session} · Tendon`;
    for (const part of [traces, orders, session, actions, next, calibration]) part.setUp(hello);
    document.body.classList.toggle("is-failed", hello.kind === "failed");
    if (hello.kind === "session") for (const part of [recognition, arm, latency, task]) part.setUp(hello);
    redraw();
  },
  state(newState) {
    state = newState;
    isStateNew = true;
    if (hello?.kind === "session") orders.showState(state);
    requests.look(desk, state);
    redraw();
  },
  desk(newDesk) {
    desk = newDesk;
    requests.look(desk, state);
    for (const part of [session, actions, next, calibration, arm, task]) part.showDesk(desk);
    isStateNew = state !== null;
    redraw();
  },
  frame(frame) {
    const newBins = traces.take(frame);
    latency.await(frame.capturedMs, newBins, traces.binMs);
    redraw();
  },
  latency: (newLatency) => latency.showLatency(newLatency),
  answer(answer) {
    if (answer.order === "stop" || answer.order === "arm") orders.takeAnswer(answer);
    else requests.takeAnswer(answer);
  },
  away(why) {
    // Old values are never shown as live ones.
    document.body.classList.toggle("is-away", why !== null);
    for (const values of document.querySelectorAll("main section:not(#session), #session-facts, #actions"))
      values.inert = why !== null;
    orders.lookAway(why);
    if (why === null) return;
    isStateNew = false;
    latency.lookAway();
    requests.lookAway();
    actions.lookAway();
    showAway(why);
  },
});
const orders = new Orders(connection);
const requests = new Requests(connection, () => {
  actions.refresh();
  calibration.refresh();
  // What was to come does not come: then the connection is lost, and no longer changing.
  if (connection.why) showAway(connection.why);
});
const actions = new Actions(requests);
const next = new NextPanel(requests);
const calibration = new Calibration(requests, () => next.open());
const afterPaint = new MessageChannel();
afterPaint.port1.onmessage = () => latency.painted();

function draw() {
  isScheduled = false;
  if (isStateNew && hello !== null && connection.why === null) {
    isStateNew = false;
    for (const part of [traces, session]) part.showState(state);
    if (calibration.isOn) showStanding(calibrationStanding(calibration.calibration, calibration.people));
    else if (hello.kind === "failed") showFailed();
    else {
      // The robot ends before its session's page does.
      if (state.arm_is_silent && requests.isChanging) showAway("lost");
      else showStanding(standing(hello, state, desk));
      for (const part of [recognition, arm, latency, task, actions]) part.showState(state);
    }
  }
  traces.draw();
  arm.draw();
  // The next task runs when this frame has been handed to the screen.
  afterPaint.port2.postMessage(null);
}

/** What was asked for could not begin. */
function showFailed() {
  showStanding({ tone: "stop", title: text("not-begun"), detail: desk?.failed ?? "" });
}

function showAway(why) {
  if (requests.isChanging && ["lost", "opening", "no-session", "ended"].includes(why)) why = "changing";
  // A calibration has no arm, and what could not begin has none either.
  if (why === "ended" && hello?.kind !== "session") why = "ended-without-arm";
  showStanding({ tone: "away", title: text(`away.${why}`), detail: text(`away.${why}-detail`) });
}

function showStanding({ tone, title, detail }) {
  byId("standing").dataset.tone = tone;
  show(byId("standing-title"), title);
  show(byId("standing-detail"), detail);
  // Screen readers hear at once why the arm does not follow, and that it does again; gestures no more than every 2 s.
  const words = tone === "go" ? title.replace(/ · [\d.,]+$/, "") : `${title}. ${detail}`;
  const nowMs = performance.now();
  if (words === spoken || (tone === "go" && spokenTone === "go" && nowMs - spokenMs < 2000)) return;
  spoken = words;
  spokenTone = tone;
  spokenMs = nowMs;
  show(byId("spoken"), words);
}

function chooseAgain(tag) {
  chooseLanguage(tag);
  for (const button of byId("languages").children) {
    button.setAttribute("aria-pressed", String(button.dataset.tag === language));
  }
  isStateNew = state !== null && connection.why === null;
  if (connection.why) {
    showAway(connection.why);
    // What is old is not drawn anew, but is to be read.
    if (state !== null && hello?.kind === "session")
      for (const part of [traces, recognition, arm, latency, task]) part.showState(state);
  }
  for (const part of [session, orders, actions, next, calibration]) part.refresh();
  redraw();
}

// Buttons and no list: an open list would take the space bar for itself, which has to stop the arm.
for (const [tag, name] of languages()) {
  const button = byId("languages").appendChild(document.createElement("button"));
  button.type = "button";
  button.lang = button.dataset.tag = tag;
  button.textContent = name;
  button.addEventListener("click", (event) => {
    chooseAgain(tag);
    // After a click Enter goes on in a calibration, as before it.
    if (event.detail > 0) button.blur();
  });
}
chooseAgain(language);

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  redraw();
});
document.addEventListener("visibilitychange", () => latency.lookAway());
// The token is the address's fragment: another token is another page.
window.addEventListener("hashchange", () => location.reload());
setInterval(() => latency.showMuscleToPixel(connection.clockOffsetMs()), 1000);
connection.begin();
