// The page of a flow in 3-D, which turns under the pointer. `told` are its facts, `data` its bytes.

import { legend, opened, part, root, tell, unpacked, within } from "./player.js";
import { orbit, readStates, Solid } from "./solid.js";

const [facts] = told, canvas = document.createElement("canvas"), solid = new Solid(canvas, facts);
const record = { facts, shown: facts.best, way: 0 };
let states = [], due = 0;

function draw() {
  due ||= requestAnimationFrame(() => {
    due = 0;
    solid.draw(states[record.shown], facts.edges[Math.min(record.shown, facts.edges.length - 1)], root.dataset.theme === "dark");
  });
  part("all").hidden = !solid.moved;
  tell();
}

if (!solid.gl) part("needs").textContent = "This page plays with WebGL 2.";
else unpacked(data).then((buffer) => {
  states = readStates(buffer, facts);
  for (const name of ["side", "sides", "seen", "value", "plain"]) part(name).remove();
  Object.assign(canvas, { tabIndex: 0, role: "img", ariaLabel: "The flow; drag to turn it, arrow keys go from time to time" });
  const pane = Object.assign(document.createElement("figure"), { className: "pane" }), label = document.createElement("label");
  const cut = Object.assign(document.createElement("input"), { type: "range", id: "cut", min: 0, max: 0.98, step: 0.01, value: 0, title: "c and v" });
  pane.append(canvas);
  part("picture").append(pane);
  label.append("cut ", cut);
  part("theme").before(label);
  part("all").textContent = "From the front";
  orbit(canvas, solid, draw, () => within && document.activeElement !== canvas); // within another page the wheel scrolls, until a click
  const by = (action, ...values) => () => (solid[action](...values), draw()), cutBy = (more) => () => (cut.stepUp(more), cut.dispatchEvent(new Event("input")));
  cut.addEventListener("input", () => by("cutBy", Number(cut.value))());
  const themed = () => (legend(facts.fluids.map(({ name, [root.dataset.theme]: shades }) => [name, shades[2]])), draw());
  opened({ record, draw, themed, resized: draw, reset: by("reset") }, {
    a: by("turn", -10, 0), d: by("turn", 10, 0), w: by("turn", 0, 10), s: by("turn", 0, -10), "+": by("zoom", 1 / 1.2), "=": by("zoom", 1 / 1.2), "-": by("zoom", 1.2),
    c: cutBy(5), v: cutBy(-5),
  });
});
