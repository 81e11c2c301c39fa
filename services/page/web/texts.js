// Every visible text stands in texts.json, by language and key; {word} in a text is a place to fill.

/** Places of texts that the name of a gesture fills. */
const GESTURE_PLACES = ["gesture", "first", "second"];

let all = {};
let current = {};
export let language = "en";

/** Loads the texts and takes the language chosen before, or the browser's, or English. */
export async function loadTexts() {
  all = await (await fetch("/texts.json")).json();
  let wanted = null;
  try {
    wanted = localStorage.getItem("language");
  } catch {
    // Storage may be forbidden; then the browser's language is taken each time.
  }
  chooseLanguage(wanted ?? navigator.languages.map((tag) => tag.slice(0, 2)).find((tag) => tag in all) ?? "en");
}

export function languages() {
  return Object.entries(all).map(([tag, texts]) => [tag, texts["language-name"]]);
}

/** Takes a language and fills the elements that carry `data-text`, `data-label` or `data-hint`. */
export function chooseLanguage(tag) {
  language = tag in all ? tag : "en";
  current = all[language];
  try {
    localStorage.setItem("language", language);
  } catch {
    // As above.
  }
  document.documentElement.lang = language;
  for (const element of document.querySelectorAll("[data-text]")) element.textContent = text(element.dataset.text);
  for (const element of document.querySelectorAll("[data-label]")) {
    element.setAttribute("aria-label", text(element.dataset.label));
  }
  for (const element of document.querySelectorAll("[data-hint]")) element.placeholder = text(element.dataset.hint);
}

/** The text of a key, its places filled. A key without a text shows itself, so that a new word of the system is seen. */
export function text(key, places = {}) {
  const template = current[key] ?? all.en?.[key] ?? key.slice(key.indexOf(".") + 1);
  return template.replace(/\{(\w+)\}/g, (whole, place) => places[place] ?? whole);
}

/**
 * What the server says: the text of `key`, its places filled with `values`, in which gestures and numbers are written as
 * everywhere; the server's own English, `words`, where there is no such text.
 */
export function said(key, values, words) {
  if (!hasText(key)) return words ?? "";
  const places = Object.entries(values ?? {}).map(([place, value]) => {
    if (GESTURE_PLACES.includes(place)) return [place, text(`gesture.${value}`)];
    return [place, typeof value === "number" ? number(value) : value];
  });
  return text(key, Object.fromEntries(places));
}

export function hasText(key) {
  return key in (all.en ?? {});
}

/** A number in the chosen language; a dash where it is not known. */
export function number(value, decimals = 0) {
  if (typeof value !== "number" || !Number.isFinite(value)) return "–";
  const shown = value.toLocaleString(language, {
    useGrouping: "min2",
    minimumFractionDigits: decimals,
    maximumFractionDigits: decimals,
  });
  return /^-[0.,]*$/.test(shown) ? shown.slice(1) : shown;
}

/** Sets an element's text only where it differs: the page is touched 30 times a second. */
export function show(element, words) {
  if (element.textContent !== words) element.textContent = words;
}
