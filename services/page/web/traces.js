// The channels: filtered traces that scroll over 5 s, the envelope beside its rest, and lamps for what is wrong.
//
//   name   ───▁▂▇█▇▂▁──────────────  ▮▮▮│▮▮   envelope, with a mark at rest
//   FLAT   ────────────────────────  │

import { colour, FONT, Sheet } from "./paint.js";
import { number, show, text } from "./texts.js";

const SHOWN_MS = 5000;
const LABEL_PX = 74;
const METER_PX = 64;
/** Words below the traces, larger on a large screen, and the height they take. */
const axisFontPx = () => Math.max(13, Math.min(18, 0.0095 * innerWidth));
const axisPx = () => axisFontPx() + 5;
/** A trace is filled from its least to its most value, and at least so thick to both sides: cheaper than a stroke. */
const HALF_LINE_PX = 0.7;
/** Rows lower than this show no words. */
const ROW_WITH_WORDS_PX = 15;

/** A unit as it is written; one that has no text, as it is called. */
function unitName(unit) {
  return unit == null ? text("unit.adc_counts") : text(`unit.${unit}`);
}

/** The next of 1, 2, 5, 10, 20 … that is not below a value. */
function roundUp(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((step) => step * decade).find((step) => step >= value * 0.999);
}

/** A scale of round steps that grows at once and shrinks only when far too large, so that it does not flicker. */
class Scale {
  constructor() {
    this.top = 0;
  }

  follow(peak) {
    if (peak > this.top || peak < this.top * 0.3) this.top = peak > 0 ? roundUp(peak) : 0;
    return this.top || 1;
  }
}

/** The electrodes with problems, the first three by name; "" where there are none. */
export function troublesInWords(hello, state) {
  const troubles = state.troubles ?? [];
  const wrong = troubles.slice(0, 3).map(({ channel, kind }) => {
    const name = channelName(hello, channel);
    const spoken = /^\d+$/.test(name) ? text("channel-number", { number: name }) : name;
    return text("channel-trouble", { channel: spoken, trouble: text(`trouble.${kind}`) });
  });
  const more = troubles.length - wrong.length;
  if (more === 1) wrong.push(text("one-more-channel"));
  else if (more > 1) wrong.push(text("more-channels", { count: more }));
  return wrong.join(" · ");
}

function channelName(hello, channel) {
  return hello.channels[channel]?.name || String(channel);
}

export class Traces {
  constructor(redraw) {
    this.sheet = new Sheet(document.getElementById("traces"), redraw);
    this.facts = document.getElementById("signals-facts");
    this.electrodes = document.getElementById("electrodes");
    this.amplitude = new Scale();
    this.envelopeScale = new Scale();
    this.troubles = new Map();
    this.setUp({ channels: [], bin_ms: 8, sample_rate_hz: 0 });
  }

  setUp(hello) {
    this.hello = hello;
    this.binMs = hello.bin_ms;
    this.capacity = Math.ceil(SHOWN_MS / hello.bin_ms);
    this.extremes = new Float32Array(2 * hello.channels.length * this.capacity).fill(NaN);
    this.newestBin = null;
    this.envelope = this.rest = new Float32Array(hello.channels.length).fill(NaN);
  }

  /** Takes a frame; returns how many of its bins are new. */
  take(frame) {
    if (frame.channels !== this.hello.channels.length || frame.bins === 0) return 0;
    const lastBin = frame.firstBin + frame.bins - 1;
    if (this.newestBin !== null && lastBin < this.newestBin) this.setUp(this.hello);
    const before = this.newestBin ?? frame.firstBin - 1;
    // What came while this page looked away is not there.
    for (let bin = Math.max(before + 1, lastBin - this.capacity + 1); bin < frame.firstBin; bin += 1) {
      for (let channel = 0; channel < frame.channels; channel += 1) this.put(channel, bin, NaN, NaN);
    }
    for (let channel = 0; channel < frame.channels; channel += 1) {
      for (let index = 0; index < frame.bins; index += 1) {
        const at = 2 * (channel * frame.bins + index);
        this.put(channel, frame.firstBin + index, frame.extremes[at], frame.extremes[at + 1]);
      }
    }
    this.envelope = frame.envelope;
    this.rest = frame.rest;
    this.newestBin = lastBin;
    return Math.min(frame.bins, lastBin - before);
  }

  put(channel, bin, least, most) {
    const at = 2 * (channel * this.capacity + (bin % this.capacity));
    this.extremes[at] = least;
    this.extremes[at + 1] = most;
  }

  showState(state) {
    const { hello } = this;
    this.troubles = new Map((state.troubles ?? []).map(({ channel, kind }) => [channel, kind]));
    const rateHz = hello.sample_rate_hz * (1 + (state.clock_drift_ppm ?? 0) / 1e6);
    show(
      this.facts,
      text("signals-facts", {
        channels: hello.channels.length,
        rate: number(rateHz, 1),
        lost: number(state.lost_samples),
        top: number(this.amplitude.top),
        unit: unitName(hello.channels[0]?.unit),
      }),
    );
    const wrong = troublesInWords(hello, state);
    show(this.electrodes, wrong === "" ? text("electrodes-good") : `${wrong} · ${text("check-electrodes")}`);
    this.electrodes.classList.toggle("is-bad", wrong !== "");
  }

  draw() {
    const { sheet, hello } = this;
    const { context } = sheet;
    sheet.clear();
    const count = hello.channels.length;
    if (count === 0) return;
    const rowPx = (sheet.height - axisPx()) / count;
    const plotPx = sheet.width - LABEL_PX - METER_PX;
    const top = this.amplitude.follow(this.greatestPeak());
    const envelopeTop = this.envelopeScale.follow(this.greatestEnvelope());
    context.textBaseline = "middle";
    for (let channel = 0; channel < count; channel += 1) {
      const middlePx = (channel + 0.5) * rowPx;
      this.drawLabel(channel, middlePx, rowPx);
      this.drawTrace(channel, middlePx, rowPx, plotPx, top);
      this.drawMeter(channel, middlePx, rowPx, envelopeTop);
    }
    this.drawAxis(plotPx);
  }

  /** The greatest peak of the channels whose electrodes are good: one that is loose must not flatten the others. */
  greatestPeak() {
    const channels = [...this.hello.channels.keys()];
    const good = channels.filter((channel) => !this.troubles.has(channel));
    const peaks = (good.length > 0 ? good : channels).map((channel) => {
      let peak = 0;
      for (let at = 2 * channel * this.capacity; at < 2 * (channel + 1) * this.capacity; at += 1) {
        const size = Math.abs(this.extremes[at]);
        if (size > peak) peak = size;
      }
      return peak;
    });
    return Math.max(0, ...peaks);
  }

  /** The greatest envelope, and never less than a few times the rest: a bar at rest is short. */
  greatestEnvelope() {
    const known = (values, factor) => [...values].filter(Number.isFinite).map((value) => factor * value);
    return Math.max(0, ...known(this.envelope, 1), ...known(this.rest, 6));
  }

  drawLabel(channel, middlePx, rowPx) {
    const { context } = this.sheet;
    const trouble = this.troubles.get(channel);
    if (trouble) {
      context.fillStyle = colour("bad");
      context.fillRect(0, middlePx - rowPx / 2 + 1, 5, rowPx - 2);
    }
    const hasRoom = rowPx >= ROW_WITH_WORDS_PX;
    if (!hasRoom && !trouble && channel % Math.ceil(ROW_WITH_WORDS_PX / rowPx) !== 0) return;
    const isTall = rowPx >= 34;
    context.fillStyle = trouble ? colour("bad") : colour("ink");
    context.font = `${trouble ? 700 : 600} ${Math.min(15, Math.max(10, rowPx * 0.5))}px ${FONT}`;
    const word = trouble ? text(`lamp.${trouble}`) : "";
    if (trouble && !isTall)
      context.fillText(hasRoom ? `${channelName(this.hello, channel)} ${word}` : channelName(this.hello, channel), 9, middlePx, LABEL_PX - 12);
    else context.fillText(channelName(this.hello, channel), 9, trouble ? middlePx - 8 : middlePx, LABEL_PX - 12);
    if (trouble && isTall) context.fillText(word, 9, middlePx + 9, LABEL_PX - 12);
  }

  drawTrace(channel, middlePx, rowPx, plotPx, top) {
    const { context } = this.sheet;
    context.strokeStyle = colour("line");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(LABEL_PX, Math.round(middlePx) + 0.5);
    context.lineTo(LABEL_PX + plotPx, Math.round(middlePx) + 0.5);
    context.stroke();
    if (this.newestBin === null) return;
    const binPx = plotPx / this.capacity;
    const step = Math.max(1, Math.round((this.hello.channels.length > 16 ? 2 : 1) / binPx));
    const heightOf = (value) => middlePx - Math.max(-1, Math.min(1, value / top)) * (rowPx / 2 - 1);
    context.fillStyle = colour(this.troubles.has(channel) ? "bad" : "trace");
    context.beginPath();
    let run = [];
    const closeRun = () => {
      if (run.length > 0) {
        context.moveTo(run[0][0], run[0][1]);
        for (const [x, upper] of run) context.lineTo(x, upper);
        for (let index = run.length - 1; index >= 0; index -= 1) context.lineTo(run[index][0], run[index][2]);
        context.closePath();
      }
      run = [];
    };
    const oldest = this.newestBin - this.capacity + 1;
    // Groups of bins keep their place in time while they scroll, else the trace would flicker.
    for (let bin = Math.ceil(oldest / step) * step; bin <= this.newestBin; bin += step) {
      let least = Infinity;
      let most = -Infinity;
      for (let inside = bin; inside < Math.min(bin + step, this.newestBin + 1); inside += 1) {
        const at = 2 * (channel * this.capacity + (((inside % this.capacity) + this.capacity) % this.capacity));
        if (this.extremes[at] < least) least = this.extremes[at];
        if (this.extremes[at + 1] > most) most = this.extremes[at + 1];
      }
      if (most < least) closeRun();
      else
        run.push([
          LABEL_PX + (bin - oldest + 1) * binPx,
          heightOf(most) - HALF_LINE_PX,
          heightOf(least) + HALF_LINE_PX,
        ]);
    }
    closeRun();
    context.fill();
  }

  drawMeter(channel, middlePx, rowPx, envelopeTop) {
    const { context, width } = this.sheet;
    const left = width - METER_PX + 10;
    const room = METER_PX - 12;
    const height = Math.max(2, Math.min(16, rowPx * 0.5));
    context.fillStyle = colour("line");
    context.fillRect(left, middlePx - height / 2, room, height);
    const envelope = this.envelope[channel];
    if (Number.isFinite(envelope)) {
      context.fillStyle = colour("good");
      context.fillRect(left, middlePx - height / 2, room * Math.min(1, envelope / envelopeTop), height);
    }
    const rest = this.rest[channel];
    if (Number.isFinite(rest)) {
      context.fillStyle = colour("ink");
      context.fillRect(left + room * Math.min(1, rest / envelopeTop) - 1, middlePx - height / 2 - 3, 2, height + 6);
    }
  }

  drawAxis(plotPx) {
    const { context, height, width } = this.sheet;
    context.fillStyle = colour("quiet");
    context.font = `${axisFontPx()}px ${FONT}`;
    const middle = height - axisPx() / 2;
    const [ago, now] = [text("seconds-ago", { seconds: SHOWN_MS / 1000 }), text("now")];
    context.textAlign = "left";
    if (context.measureText(ago + now).width + 10 < plotPx) context.fillText(ago, LABEL_PX, middle);
    context.textAlign = "right";
    context.fillText(now, LABEL_PX + plotPx, middle);
    context.font = `13px ${FONT}`;
    context.fillText(text("envelope"), width, middle, METER_PX - 8);
    context.textAlign = "left";
  }
}
