// The page of a flow in 3-D, which turns under the pointer. `told` are its facts, `data` its bytes.

import { legend, opened, part, root, tell, unpacked, within } from "./player.js";
import { readStates, Solid } from "./solid.js";

const [facts] = told, canvas = document.createElement("canvas"), solid = new Solid(canvas, facts);
const record = { facts, shown: facts.best, way: 0 }, front = [...solid.angles];
let states = [], due = 0;

function draw() {
  due ||= requestAnimationFrame(() => {
    due = 0;
    solid.draw(states[record.shown], facts.edges[Math.min(record.shown, facts.edges.length - 1)], root.dataset.theme === "dark");
  });
  part("all").hidden = solid.near === 1 && solid.angles.every((angle, k) => angle === front[k]);
  tell();
}
function turn(azimuth, elevation) {
  const [before, above] = solid.angles;
  solid.angles = [before + azimuth, Math.max(-90, Math.min(90, above + elevation))];
  draw();
}
function zoom(by) {
  solid.near = Math.max(0.3, Math.min(2, solid.near * by));
  draw();
}

if (!solid.gl) part("needs").textContent = "This page plays with WebGL 2.";
else unpacked(data).then((buffer) => {
  states = readStates(buffer, facts);
  for (const name of ["side", "sides", "seen", "value", "plain"]) part(name).remove();
  Object.assign(canvas, { tabIndex: 0, role: "img", ariaLabel: "The flow; drag to turn it, arrow keys go from time to time" });
  const pane = Object.assign(document.createElement("figure"), { className: "pane" }), pointers = new Map();
  pane.append(canvas);
  part("picture").append(pane);
  part("all").textContent = "From the front";
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const apart = () => Math.hypot(...[0, 1].map((k) => [...pointers.values()].reduce((a, b) => a[k] - b[k]))), two = pointers.size === 2, was = two && apart();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (two) zoom(was / Math.max(apart(), 1));
    else turn(-0.4 * (event.clientX - before[0]), 0.4 * (event.clientY - before[1]));
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    if (within && document.activeElement !== canvas) return; // within another page the wheel scrolls, until a click
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.1 : 1 / 1.1);
  }, { passive: false });
  const themed = () => (legend(facts.fluids.map(({ name, [root.dataset.theme]: shades }) => [name, shades[2]])), draw());
  const reset = () => (([solid.angles, solid.near] = [[...front], 1]), draw());
  opened({ record, draw, themed, resized: draw, reset }, {
    a: () => turn(-10, 0), d: () => turn(10, 0), w: () => turn(0, 10), s: () => turn(0, -10), "+": () => zoom(1 / 1.2), "=": () => zoom(1 / 1.2), "-": () => zoom(1.2),
  });
});
