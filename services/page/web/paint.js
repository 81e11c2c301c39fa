// What both canvases need: their size in device pixels, and the colours of the style sheet.

let colours = {};

/** Reads the colours of the style sheet, which depend on light and dark. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = [
    "ground",
    "panel",
    "ink",
    "quiet",
    "line",
    "trace",
    "good",
    "wait",
    "bad",
    "path",
    "zone",
    "link",
    "joint",
  ];
  colours = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

export function colour(name) {
  return colours[name];
}

export const FONT = "system-ui, sans-serif";

/** A canvas that fits the element around it. */
export class Sheet {
  constructor(canvas, resized) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => {
      this.fit();
      resized();
    }).observe(canvas.parentElement);
    this.fit();
  }

  fit() {
    const { width, height } = this.canvas.parentElement.getBoundingClientRect();
    const scale = window.devicePixelRatio || 1;
    this.width = Math.max(1, Math.floor(width));
    this.height = Math.max(1, Math.floor(height));
    this.canvas.width = Math.round(this.width * scale);
    this.canvas.height = Math.round(this.height * scale);
    this.context.setTransform(scale, 0, 0, scale, 0, 0);
  }

  clear() {
    this.context.clearRect(0, 0, this.width, this.height);
  }
}
