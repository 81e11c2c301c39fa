// Latencies: a histogram for every hop, newest sample to command, and muscle to pixel as measured by this page.

import { number, show, text } from "./texts.js";

/** Edges of the histograms' logarithmic axis in µs. */
const LEAST_US = 1;
const MOST_US = 100_000;
const BARS = 40;
/** Muscle to pixel is told of the last so many bins, about 10 s. */
const KEPT = 1250;

export class Latency {
  constructor() {
    const byId = (id) => document.getElementById(id);
    this.toCommand = byId("sample-to-command");
    this.toPixel = byId("muscle-to-pixel");
    this.hops = byId("hops");
    this.facts = byId("latency-facts");
    this.rows = new Map();
    // When bins were painted, by the page's clock, less when they were captured, by the server's.
    this.betweenClocksMs = [];
    this.awaiting = [];
  }

  setUp(hello) {
    this.hello = hello;
    this.rows.clear();
    this.hops.replaceChildren();
    this.betweenClocksMs = [];
    this.awaiting = [];
    show(this.toCommand, "–");
    show(this.toPixel, "–");
  }

  /** New bins have come: the newest was captured then, the others each one bin before. */
  await(capturedMs, bins, binMs) {
    // Nothing is painted in a tab that nobody sees.
    if (document.hidden) return;
    for (let index = 0; index < bins; index += 1) this.awaiting.push(capturedMs - index * binMs);
  }

  lookAway() {
    this.awaiting = [];
  }

  /** Everything that was awaited has been handed to the screen, which shows it with its next refresh. */
  painted() {
    const nowMs = performance.now();
    for (const capturedMs of this.awaiting) this.betweenClocksMs.push(nowMs - capturedMs);
    this.awaiting = [];
    if (this.betweenClocksMs.length > KEPT) this.betweenClocksMs.splice(0, this.betweenClocksMs.length - KEPT);
  }

  /** `offsetMs` is the server's clock less the page's, which is known better with every answer to a ping. */
  showMuscleToPixel(offsetMs) {
    if (this.betweenClocksMs.length < 10 || offsetMs === null) return;
    const sorted = Float64Array.from(this.betweenClocksMs, (betweenMs) => betweenMs + offsetMs).sort();
    const at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
    show(this.toPixel, text("p50-p99-ms", { p50: number(at(0.5)), p99: number(at(0.99)) }));
  }

  showLatency(latency) {
    const newest = latency.newest_sample_to_command;
    if (newest?.count > 0) {
      show(
        this.toCommand,
        text("p50-p99-ms", { p50: number(newest.p50_us / 1000, 1), p99: number(newest.p99_us / 1000, 1) }),
      );
    }
    for (const hop of latency.hops) this.showHop(hop);
  }

  showHop(hop) {
    let row = this.rows.get(hop.name);
    if (!row) {
      const element = document.createElement("tr");
      const name = element.appendChild(document.createElement("th"));
      name.scope = "row";
      const canvas = element.appendChild(document.createElement("td")).appendChild(document.createElement("canvas"));
      canvas.width = 4 * BARS;
      canvas.height = 24;
      canvas.setAttribute("aria-hidden", "true");
      const [p50, p99] = [0, 1].map(() => element.appendChild(document.createElement("td")));
      row = { name, canvas, p50, p99 };
      this.rows.set(hop.name, row);
      this.hops.append(element);
    }
    show(row.name, hop.name.replaceAll("-", " ").replace(/ (to|>) /, " → "));
    show(row.p50, duration(hop.p50_us));
    show(row.p99, duration(hop.p99_us));
    drawHistogram(row.canvas, hop.buckets);
  }

  showState(state) {
    const { paper } = this.hello;
    const facts = [
      text("losses", {
        samples: number(state.lost_samples),
        blocks: number(state.lost_blocks),
        stale: number(Number(state.stale ?? 0)),
        restarts: number(state.restarts),
      }),
    ];
    if (paper) facts.push(text("paper-is", { median: number(paper.median_ms) }));
    show(this.facts, facts.join(" "));
  }
}

function duration(us) {
  return us >= 1000 ? `${number(us / 1000, 1)}\u00a0ms` : `${number(us, us < 10 ? 1 : 0)}\u00a0µs`;
}

/** Bars on a logarithmic axis; their height is the square root of their share, so that the tail is seen. */
function drawHistogram(canvas, buckets) {
  const bars = new Array(BARS).fill(0);
  for (const [upperUs, count] of buckets) {
    const place = (BARS * Math.log(upperUs / LEAST_US)) / Math.log(MOST_US / LEAST_US);
    bars[Math.max(0, Math.min(BARS - 1, Math.floor(place)))] += count;
  }
  const most = Math.max(1, ...bars);
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = getComputedStyle(canvas).color;
  bars.forEach((count, index) => {
    if (count === 0) return;
    const height = Math.max(2, Math.sqrt(count / most) * canvas.height);
    context.fillRect(4 * index, canvas.height - height, 3, height);
  });
}
