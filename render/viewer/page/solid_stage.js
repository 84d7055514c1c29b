// The picture of a flow in 3-D in the viewer: the surface of its densest fluid, as shared pages have it.

import { orbit, readStates, Solid } from "./solid.js";

export class SolidStage {
  // For the arguments see Stage; `turned` is called with the angles once the pointer has turned it.
  constructor(root, number, label, space, turned) {
    Object.assign(this, { root, number, space, turned, window: null, marks: {}, state: null });
    this.element = Object.assign(document.createElement("figure"), { className: "pane" });
    this.canvas = Object.assign(document.createElement("canvas"), { tabIndex: 0, role: "img" });
    this.canvas.setAttribute("role", "img");
    this.solid = new Solid(this.canvas, space);
    this.element.append(this.canvas, Object.assign(document.createElement("figcaption"), { textContent: this.solid.gl ? label : "This needs WebGL 2." }));
    orbit(this.canvas, this.solid, () => this.changed());
    this.canvas.addEventListener("dblclick", () => this.act("reset"));
  }

  get box() {
    return { left: 0, top: 0, width: Math.max(this.canvas.clientWidth, 64), height: Math.max(this.canvas.clientHeight, 64) };
  }

  // Take a frame and the bytes of its surface.
  show(frame, bytes) {
    this.frame = frame;
    [this.state] = readStates(bytes, { ...this.space, counts: [frame.counts] });
    this.paint();
  }

  paint() {
    this.due ||= requestAnimationFrame(() => {
      this.due = 0;
      if (this.state) this.solid.draw(this.state, this.frame.edges, this.root.dataset.theme === "dark");
    });
  }

  // Turn, zoom, cut or reset it.
  act(action, ...values) {
    this.solid[action](...values);
    this.changed();
  }

  changed() {
    this.paint();
    this.turned(this);
  }
}
