// What became of an order, in words, for a few seconds.

import { show } from "./texts.js";

const SHOWN_MS = 6000;

export class Outcome {
  constructor(element) {
    this.element = element;
  }

  /** `tone`: "good", "wait" or "bad". */
  tell(words, tone) {
    this.element.hidden = false;
    this.element.dataset.tone = tone;
    show(this.element, words);
    clearTimeout(this.hiding);
    this.hiding = setTimeout(() => this.clear(), SHOWN_MS);
  }

  clear() {
    this.element.hidden = true;
  }
}
