// The zones task in words: which way to the zone, how long the arm has been in it, the scores so far.

import { number, show, text } from "./texts.js";

/** Nearer than this along an axis is near enough not to be named. */
const NAMED_FROM_MM = 3;
const AXES = ["x", "y", "z"];

const byId = (id) => document.getElementById(id);

/** The zone there is, or null; `shape` is "cube" or "sphere". */
export function zoneOf(desk, state) {
  const zone = desk?.task?.zone ?? state?.zone ?? null;
  if (zone === null) return null;
  return { ...zone, shape: zone.shape ?? (desk?.task?.kind === "paper-zones" ? "cube" : "sphere") };
}

/** Whether a position lies in a zone, its edge included. */
export function isInZone(zone, positionMm) {
  const offsets = zone.center_mm.map((centre, axis) => Math.abs(centre - positionMm[axis]));
  const half = zone.width_mm / 2;
  return zone.shape === "cube" ? Math.max(...offsets) <= half : Math.hypot(...offsets) <= half;
}

export class Task {
  constructor() {
    this.desk = null;
  }

  setUp() {
    this.desk = null;
    byId("task").hidden = true;
  }

  showDesk(desk) {
    this.desk = desk;
  }

  showState(state) {
    const task = this.desk?.task ?? null;
    const zone = zoneOf(this.desk, state);
    byId("task").hidden = task === null && zone === null;
    if (byId("task").hidden) return;
    show(byId("task-zone"), zone === null ? text("task-no-zone") : this.wayTo(zone, state.position_mm));
    byId("task").classList.toggle("is-inside", zone !== null && isInZone(zone, state.position_mm));
    byId("task-dwell").style.transform = `scaleX(${Math.max(0, Math.min(1, task?.dwell_share ?? 0))})`;
    if (task === null) return;
    const { reached, trials, overshoots, throughput_bits_per_s: throughput } = task;
    show(
      byId("task-scores"),
      text("task-scores", {
        reached: number(reached),
        trials: number(trials),
        overshoots: number(overshoots),
        throughput: number(throughput, 2),
      }),
    );
  }

  wayTo(zone, positionMm) {
    if (isInZone(zone, positionMm)) return text("task-inside");
    const ways = AXES.map((axis, place) => ({ axis, away: zone.center_mm[place] - positionMm[place] }))
      .filter(({ away }) => Math.abs(away) >= NAMED_FROM_MM)
      .sort((a, b) => Math.abs(b.away) - Math.abs(a.away))
      .map(({ axis, away }) =>
        text("task-way", {
          distance: number(Math.abs(away)),
          direction: text(`motion.${away > 0 ? "+" : "-"}${axis}`),
        }),
      );
    return text("task-outside", { way: ways.join(" · ") });
  }
}
