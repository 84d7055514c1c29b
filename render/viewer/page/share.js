// The page of runs in 2-D: one, two with a border between them, or those of a study. `told` are their facts, `data` their bytes.

import { Grid, tablePlot } from "./grid.js";
import { asked, card, go, legend, opened, part, root, setPace, tell, unpacked, within } from "./player.js";
import { colours, historyPlot, number } from "./plots.js";
import { Record } from "./record.js";

const THUMB = 16; // of the bar between two runs [px]
const study = "values" in told[0]; // many runs of one case, of which one is seen
let under = null;

const [x0, y0, x1, y1] = [Math.min, Math.min, Math.max, Math.max].map((end, k) => end(...told.map(({ box }) => box[k])));
// The run, and the one beside it if there are two.
const records = told.map((one) => new Record(one, root, [x0, y0, x1, y1], {
  window: (window) => look(window), reset: () => look(null), tool: () => "look", hover: (at) => point(at), pick: (at) => (stage.canvas.focus(), point(at)),
  ignores: () => within && !records.some((each) => document.activeElement === each.stage.canvas), // within another page the wheel scrolls, until a click
}));
let [record, beside] = study ? [records[0]] : records, { stage, facts } = record;

const grid = study && new Grid(records, (run) => choose(run));

function draw() {
  if (beside) beside.goTo(record.time);
  for (const each of study ? [record] : records) each.draw(part("smooth").checked, card);
  part("all").hidden = !stage.window;
  readOff();
  if (tell()) plotAll();
}

// The border between two runs; the thumb of the bar stands on it.
function wipe() {
  const wide = part("picture").clientWidth, at = THUMB / 2 + (part("wipe").value / 1000) * (wide - THUMB);
  record.stage.element.style.clipPath = `inset(0 ${wide - at}px 0 0)`;
  beside.stage.element.style.clipPath = `inset(0 0 0 ${at}px)`;
  part("border").style.left = `${at}px`;
}

function colour(which) {
  const film = record.film = record.films[which] || null;
  if (beside) beside.film = beside.films[which] || null;
  part("field").value = film ? which : -1;
  // In the colours of a field fluids need no others.
  legend([...facts.fluids.map(({ name, [root.dataset.theme]: shades }, k) => [name, shades[2], film && !film.plain.includes(k)]), ...Object.entries(facts.marks)]);
  part("bar").replaceChildren();
  if (film) {
    const bar = document.createElement("i");
    bar.style.background = `linear-gradient(90deg, ${film.stops.join()})`;
    part("bar").append(`${number(film.low)} `, bar, ` ${number(film.high)}`);
  }
  draw();
}

// Another run of a study, at the time that is seen.
function choose(other) {
  const { time } = record, which = record.films.indexOf(record.film);
  record.stage.element.hidden = true;
  [record, stage, facts] = [other, other.stage, other.facts];
  stage.element.hidden = false;
  for (const each of grid.near(record)) for (const film of each.films.slice(which, which + 1)) film.between(each.at(time), 0, () => {});
  record.goTo(time);
  setPace();
  part("clock").textContent = ""; // its plots are others
  colour(which);
}

// The value under the pointer, where a fluid is.
function point(at) {
  under = at;
  readOff();
}
function readOff() {
  const seen = beside && under && stage.toPixels(under)[0] > parseFloat(part("border").style.left) ? beside : record;
  const value = under ? seen.value(under) : null;
  part("value").textContent = value === null ? "" : number(value, 3);
}

function plotAll() {
  for (const canvas of part("plots").querySelectorAll("canvas")) {
    const paint = colours(root);
    if (!canvas.clientWidth) continue;
    if (canvas.matches(".table")) canvas.at = tablePlot(canvas, grid.points(canvas.of), paint);
    else canvas.at = historyPlot(canvas, (study ? [...records.filter((each) => each !== record), record] : records).flatMap((each) => each.facts.plots.filter(({ name }) => name === canvas.of).map((plot) => ({ ...plot, colour: study && each !== record ? paint.subtle : null }))), record.time, "", paint);
  }
}

function look(window) {
  for (const each of records) each.stage.window = window;
  draw();
}

unpacked(data).then((buffer) => {
  let from = 0;
  for (const each of records) from = each.read(buffer, from, draw);
  for (const { stage: { element, canvas } } of records) {
    part("picture").append(element);
    canvas.setAttribute("aria-label", "The flow; arrow keys go from time to time");
  }
  if (beside) {
    part("sides").hidden = false;
    part("picture").append(part("sides"));
    told.forEach(({ name }, k) => (part("sides").querySelectorAll("span")[k].textContent = name));
    part("wipe").addEventListener("input", wipe);
  }
  record.films.forEach((_, k) => { // the same colours for all
    const alike = records.map(({ films }) => films[k]), low = Math.min(...alike.map((film) => film.low)), high = Math.max(...alike.map((film) => film.high));
    for (const film of alike) Object.assign(film, { low, high });
  });
  records.slice(1).forEach(({ stage: { element } }) => (element.hidden = study));
  if (study) part("values").append(...grid.rows);
  root.style.setProperty("--shape", (x1 - x0) / (y1 - y0));
  const plotted = (name, kind, label, click) => {
    const figure = document.createElement("figure"), canvas = Object.assign(document.createElement("canvas"), { of: name, className: kind });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", label);
    canvas.addEventListener("click", (event) => click(canvas.at(event.offsetX, event.offsetY)));
    figure.append(Object.assign(document.createElement("figcaption"), { textContent: label }), canvas);
    part("plots").append(figure);
  };
  for (const name of study ? grid.figures : []) plotted(name, "table", `${name}, of all runs`, (run) => grid.show(run));
  for (const { name } of facts.plots) plotted(name, "series", name, (at) => go(facts.times.reduce((best, time, k) => (Math.abs(time - at) < Math.abs(facts.times[best] - at) ? k : best), 0)));
  part("seen").hidden = !record.films.length;
  part("field").append(new Option("fluids", -1), ...record.films.map(({ name }, k) => new Option(name, k)));
  part("field").addEventListener("change", () => colour(Number(part("field").value)));
  part("smooth").addEventListener("change", draw);
  const zoom = (by) => () => stage.zoom(by, stage.box.left + stage.box.width / 2, stage.box.top + stage.box.height / 2);
  const move = (x, y) => () => stage.shift(0.12 * x, 0.12 * y);
  part("field").value = asked.includes("fluids") || !record.films.length ? -1 : facts.opens ?? 0;
  const themed = () => (colour(Number(part("field").value)), plotAll()), resized = () => (beside && wipe(), draw(), plotAll());
  opened({ get record() { return record; }, draw, themed, resized, reset: () => look(null) }, {
    "+": zoom(1 / 1.3), "=": zoom(1 / 1.3), "-": zoom(1.3), w: move(0, 1), a: move(-1, 0), s: move(0, -1), d: move(1, 0),
    o: () => part("smooth").click(), f: () => colour((record.films.indexOf(record.film) + 2) % (record.films.length + 1) - 1),
  });
});
