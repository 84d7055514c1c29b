// What shared pages have in common: their bytes, the clock, keys, the theme, and playing while they are in view.

import { fitting } from "./plots.js";

const PACES = [0.25, 0.5, 1, 2, 4], REST = 800; // before it begins anew [ms]
const CARD = 30; // between the pictures of a card [ms]

export const part = (id) => document.getElementById(id), root = document.documentElement;
export const within = window !== top, asked = location.hash.slice(1).split("&"), card = asked.includes("card");
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
let page, playing = false, wanted = false, pace = 1, dark, moment = 0, begun = 0, drawn = 0;

// The data of a page.
export async function unpacked(data) {
  const packed = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer();
}

// Write the time that is seen; returns whether it is another one.
export function tell() {
  const { facts: { times, digits }, shown } = page.record, [factor, unit] = fitting(times.at(-1) - times[0] || 1, "s");
  const time = `t = ${(factor * times[shown]).toFixed(Math.max(0, digits - Math.log10(factor)))} ${unit}`;
  part("time").value = shown;
  part("time").setAttribute("aria-valuetext", time);
  if (part("clock").textContent === time) return false;
  part("clock").textContent = time;
  return true;
}

export function show(number, share = 0) {
  const { record } = page;
  [record.shown, record.way] = [Math.max(0, Math.min(record.facts.times.length - 1, Math.round(number))), share];
  page.draw();
}

export function go(number) {
  play(false);
  show(number);
}

export function play(on) {
  const { shown, way, facts } = page.record, last = facts.times.length - 1;
  wanted = playing = on && last > 0;
  part("play").textContent = on ? "Pause" : "Play";
  if (!on) return way && show(shown);
  start(shown === last ? 0 : shown + way, 0);
}
function start(from, rest) {
  [moment, begun] = [from, performance.now() + rest];
  requestAnimationFrame(tick);
}
function tick(now) {
  if (!playing) return;
  if (now < begun) return requestAnimationFrame(tick);
  const { facts } = page.record, last = facts.times.length - 1, at = moment + ((now - begun) * facts.rate * pace) / 1000;
  if (at >= last) {
    show(last);
    return start(0, REST);
  }
  if (!card || now - drawn > CARD) {
    drawn = now;
    show(Math.floor(at), at % 1);
  }
  requestAnimationFrame(tick);
}

// Play so many times faster than the page's own rate; after a change of the record, too.
export function setPace(value = pace) {
  const { facts: { times, rate }, shown, way } = page.record, last = times.length - 1;
  pace = Number(value);
  part("time").max = last;
  part("speed").value = pace;
  if (playing) [moment, begun] = [shown + way, performance.now()];
  const lapse = Number((((times[last] - times[0]) / (last || 1)) * rate * pace).toPrecision(2));
  part("lapse").textContent = lapse === 1 || !last ? "real time" : `${Number((lapse < 1 ? 1 / lapse : lapse).toPrecision(2))} times ${lapse < 1 ? "slower" : "faster"}`;
}

export function setTheme(value) {
  dark = value;
  root.dataset.theme = dark ? "dark" : "light";
  part("theme").textContent = dark ? "Light" : "Dark";
  page.themed();
}

// Names [name, colour, hidden] beside the title.
export function legend(entries) {
  part("legend").replaceChildren(...entries.map(([name, paint, hidden]) => {
    const entry = Object.assign(document.createElement("li"), { hidden }), swatch = document.createElement("i");
    swatch.style.background = paint;
    entry.append(swatch, name);
    return entry;
  }));
}

// Begin: of a page its record (facts, shown, way), what draws it and what a change of its theme or its size calls, how its
// view is reset, and the keys of its own.
export function opened(made, keys) {
  page = made;
  for (const name of ["poster", "needs"]) part(name).remove();
  if (card) root.dataset.card = "";
  if (within) root.dataset.within = "";
  part("speed").append(...PACES.map((value) => new Option(`${value} ×`, value)));
  part("speed").addEventListener("change", () => setPace(part("speed").value));
  part("time").addEventListener("input", () => go(part("time").value));
  part("play").addEventListener("click", () => play(!playing));
  part("theme").addEventListener("click", () => setTheme(!dark));
  part("all").addEventListener("click", page.reset);
  const by = (count) => () => go(page.record.shown + count), faster = (by) => () => setPace(PACES[Math.max(0, Math.min(4, PACES.indexOf(pace) + by))]);
  const all = {
    " ": () => play(!playing), ArrowRight: by(1), ArrowLeft: by(-1), PageDown: by(10), PageUp: by(-10), Home: () => go(0), End: () => go(page.record.facts.times.length - 1),
    ">": faster(1), "<": faster(-1), 0: page.reset, h: () => setTheme(!dark), ...keys,
  };
  document.addEventListener("keydown", (event) => {
    const act = all[event.key];
    if (!act || event.target.matches("#wipe, #values input") || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select") || (event.key === " " && event.target.matches("button, input[type=checkbox]") && event.target.matches(":focus-visible"))) return;
    event.preventDefault();
    act();
  });
  setPace();
  setTheme(page.record.facts.dark ?? matchMedia("(prefers-color-scheme: dark)").matches);
  new ResizeObserver(page.resized).observe(part("picture"));
  // It plays while it is in view, unless less motion is asked for.
  wanted = !still;
  new IntersectionObserver(([{ isIntersecting: seen }]) => {
    const on = wanted && seen;
    if (on === playing) return;
    if (on) play(true);
    else playing = false;
  }).observe(part("picture"));
  root.dataset.ready = "yes";
}
