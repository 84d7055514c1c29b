// The runs of a study by their values: a slider for each, and the figures of its table.

import { context, levels, number } from "./plots.js";

const shown = (value) => (value === undefined ? "as in the case" : typeof value === "number" ? number(value) : value);

// A figure of many runs against one of their values, see `Grid.points`; returns the run nearest to a place in CSS pixels.
export function tablePlot(canvas, { points, ticks: marks, label }, paint) {
  const { draw, width, height } = context(canvas), box = { left: 48, top: 8, width: width - 62, height: height - 40 };
  const there = points.filter((point) => point.y !== null), all = marks.map((mark) => mark.x), [low, high] = [Math.min(...all), Math.max(...all)];
  draw.font = `11px ${paint.font}`;
  draw.fillStyle = paint.subtle;
  const x = (at) => box.left + 8 + ((at - low) / (high - low || 1)) * (box.width - 16), y = levels(draw, box, there.map((point) => point.y), paint);
  draw.textAlign = "center";
  let end = -Infinity;
  for (const mark of marks) {
    const half = draw.measureText(mark.text).width / 2, at = Math.min(x(mark.x), width - half);
    if (at - half > end) draw.fillText(mark.text, at, box.top + box.height + 10);
    end = Math.max(end, at + half + 6);
  }
  draw.textAlign = "right";
  draw.fillText(label, box.left + box.width, box.top + box.height + 24);
  draw.strokeStyle = paint.accent;
  draw.lineWidth = 1.6;
  draw.beginPath();
  for (const point of there.filter((one) => one.line).sort((a, b) => a.x - b.x)) draw.lineTo(x(point.x), y(point.y));
  draw.stroke();
  for (const point of [...there].sort((a, b) => a.seen - b.seen)) {
    draw.fillStyle = point.seen ? paint.mark : point.line ? paint.accent : paint.subtle;
    draw.beginPath();
    draw.arc(x(point.x), y(point.y), point.seen ? 5 : 3.5, 0, 2 * Math.PI);
    draw.fill();
  }
  const far = (point, px, py) => Math.hypot(x(point.x) - px, y(point.y) - py);
  return (px, py) => there.reduce((best, point) => (far(point, px, py) < far(best, px, py) ? point : best), there[0]).run;
}

export class Grid {
  // The records of the runs, and what is done when one of them is chosen.
  constructor(records, choose) {
    [this.records, this.run, this.choose] = [records, records[0], choose];
    const all = [...new Set(records.flatMap(({ facts }) => Object.keys(facts.values)))];
    this.keys = all.map((key) => {
      const values = [...new Set(records.map(({ facts }) => facts.values[key]))].sort((a, b) => (a === undefined) - (b === undefined) || (typeof a === "number" && typeof b === "number" ? a - b : 0));
      const ends = (count) => key.split(".").slice(-count).join(" "); // as much of its name as tells it from others
      const least = [1, 2, 3].find((count) => all.every((other) => other === key || other.split(".").slice(-count).join(" ") !== ends(count)));
      return { key, values, name: least ? ends(least) : key };
    }).filter(({ values }) => values.length > 1);
    this.along = this.keys[0]; // what figures are plotted against
    this.figures = [...new Set(records.flatMap(({ facts }) => Object.keys(facts.figures)))];
    this.rows = this.keys.map((axis) => this.slider(axis));
    this.place();
  }

  slider(axis) {
    const row = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output");
    Object.assign(input, { type: "range", min: 0, max: axis.values.length - 1, step: 1 });
    input.addEventListener("input", () => {
      this.along = axis;
      this.show(this.nearest(axis.key, axis.values[input.value]));
    });
    row.append(axis.name, input, output);
    Object.assign(axis, { input, output });
    return row;
  }

  // The run with a value whose others differ least from those of the one that is seen.
  nearest(key, value) {
    const { values } = this.run.facts, alike = (run) => this.keys.filter((axis) => run.facts.values[axis.key] === values[axis.key]).length;
    const there = this.records.filter((run) => run.facts.values[key] === value);
    return there.reduce((best, run) => (alike(run) > alike(best) ? run : best), there[0]);
  }

  show(run) {
    if (run && run !== this.run) {
      this.run = run;
      this.choose(run);
    }
    this.place();
  }

  // Sliders as the run that is seen has its values.
  place() {
    for (const { key, values, input, output } of this.keys) {
      const value = this.run.facts.values[key];
      input.value = values.indexOf(value);
      output.textContent = shown(value);
      input.setAttribute("aria-valuetext", shown(value));
    }
  }

  // Runs to which one step of a slider leads.
  near(run) {
    return this.records.filter((other) => other !== run && this.keys.filter(({ key }) => other.facts.values[key] !== run.facts.values[key]).length === 1);
  }

  // What `tablePlot` draws of a figure: each run, where it stands along a value, whether it is seen, and whether it is in line.
  points(name) {
    const { key, values, name: label } = this.along, numbers = values.every((value) => typeof value === "number");
    const far = numbers && values[0] > 0 && values.at(-1) / values[0] > 20, at = (value) => (!numbers ? values.indexOf(value) : far ? Math.log(value) : value);
    const line = [this.run, ...this.near(this.run)].filter((run) => this.keys.every((axis) => axis.key === key || run.facts.values[axis.key] === this.run.facts.values[axis.key]));
    const points = this.records.map((run) => ({ run, x: at(run.facts.values[key]), y: run.facts.figures[name] ?? null, seen: run === this.run, line: line.includes(run) }));
    return { points, ticks: values.map((value) => ({ x: at(value), text: shown(value) })), label };
  }
}
