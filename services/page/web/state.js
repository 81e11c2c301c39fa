// The large line: what the arm does, why it does not, and what to do about it, in words for whoever stands beside it.

import { actionOf, gestureName, motionOf } from "./recognition.js";
import { number, text } from "./texts.js";
import { troublesInWords } from "./traces.js";

/** How the arm was found at the start: then it was not stopped, and waits for its first "arm". */
const HOW_FOUND = [
  "not-left-in-good-order",
  "used-since",
  "record-unusable",
  "moved-since",
  "start-is-far",
  "start-beyond-limit",
  "outside-box",
  "way-leaves-box",
  "next-session",
];

/** Title, detail and tone ("go", "move", "wait", "stop", "away") of a state; `desk` is null while nobody tells it. */
export function standing(hello, state, desk) {
  // Whatever else the arm has said last is old.
  if (state.arm_is_silent && desk === null)
    return { tone: "away", title: text("away.silent"), detail: text("away.silent-detail") };
  if (state.arm_is_silent) return line("stop", "arm-silent");
  const channels = troublesInWords(hello, state);
  const fault = state.fault ? ` ${text("fault-is", { fault: state.fault })}` : "";
  const reason = state.stop_reason ? text(`reason.${state.stop_reason}`) + fault : "";
  if (state.permission === "stopped") {
    if (state.phase === "connecting" && !state.stop_reason) return line("wait", "connecting");
    if (state.phase === "bringing-up") return line("wait", "bringing-up");
    if (state.phase === "going-to-start") return line("move", "going-to-start");
    const canOrder = hello.rights !== "watch";
    const title = HOW_FOUND.includes(state.stop_reason) ? "waiting" : "stopped";
    return {
      tone: "stop",
      title: text(title),
      detail: [reason, canOrder ? text("arm-to-go-on") : ""].join(" ").trim(),
    };
  }
  if (state.permission === "await-rest") {
    const leftMs = state.calibration_left_ms;
    if (leftMs > 0) return line("wait", "measuring-rest", { seconds: number(Math.ceil(leftMs / 1000)) });
    const detail = channels === "" ? text("relax-detail") : text("relax-electrode", { channels });
    return { tone: "wait", title: text(reason ? "relax-again" : "relax"), detail: reason || detail };
  }
  const gesture = state.voted ?? state.gesture;
  const places = { gesture: gesture == null ? "–" : gestureName(gesture), confidence: number(state.confidence, 2) };
  if (state.hindrance) {
    return { tone: "wait", title: text("held-up", places), detail: hindranceText(state.hindrance) };
  }
  if (state.unsure) {
    const detail = channels === "" ? text("unsure-detail") : text("unsure-electrode", { channels });
    return { tone: "wait", title: text("unsure-title"), detail };
  }
  const motion = gesture == null ? null : motionOf(hello, state, gesture);
  if (motion === null) return { tone: "go", title: text("ready", places), detail: text("ready-detail") };
  if (["gripper", "next-mode"].includes(actionOf(hello, state, gesture)))
    return { tone: "go", title: text("does", { ...places, motion }), detail: text("does-detail") };
  if (!state.moves) return line("wait", "held", places);
  return { tone: "go", title: text("following", { ...places, motion }), detail: text("following-detail") };
}

function line(tone, key, places) {
  return { tone, title: text(key, places), detail: text(`${key}-detail`, places) };
}

/** What holds the arm up: a face of the workspace box, a joint, a posture or a joint's speed. */
function hindranceText(hindrance) {
  const face = /workspace.*?([+-])([xyz])/.exec(hindrance);
  if (face) return text("hindrance.face", { face: text(`face.${face[1]}${face[2]}`) });
  const joint = /joint\D*(\d)/.exec(hindrance);
  if (joint) return text("hindrance.joint", { joint: joint[1] });
  return text(`hindrance.${hindrance}`);
}
