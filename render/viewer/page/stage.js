// One picture with its axes: it draws the last frame in the window that is to be seen, and turns what the pointer does
// into places in metres.

import { Cells, drawInterfaces } from "./cells.js";
import { drawLines } from "./lines.js";
import { Motion } from "./motion.js";
import { drawOutlines } from "./outlines.js";
import { axes, colours, context, mixed } from "./plots.js";

const MARGIN = 0.035; // of the domain, kept free around it when all of it is shown
const LINE = "#061528", RIM = "#ffffff"; // of interfaces over a field
const POUR = 150; // between tries to add a drop [ms]
const GUTTER = { left: 66, right: 16, top: 8, bottom: 46 };

// The part that a picture of a shape shows when a window is asked for.
export function fit(window, width, height) {
  const [x0, y0, x1, y1] = window;
  const scale = Math.min(width / (x1 - x0), height / (y1 - y0));
  const x = (x0 + x1) / 2, y = (y0 + y1) / 2, w = width / scale / 2, h = height / scale / 2;
  return [x - w, y - h, x + w, y + h];
}

export class Stage {
  // The label stands above pictures that are compared; "" for a single one.
  constructor(root, number, label, domain, fluids, events) {
    this.fluids = fluids;
    this.outlines = null; // of the frame
    this.motion = new Motion(); // from frame to frame
    this.cells = null; // with them, once a field or the mesh is seen
    this.gutter = GUTTER;
    this.label = label;
    this.domain = domain;
    this.root = root;
    this.number = number;
    this.events = events;
    this.frame = null; // what is shown
    this.window = null; // what is to be seen [m]; null for all, or for what follows the flow
    this.marks = { point: null, push: null, refused: null };
    this.element = document.createElement("figure");
    this.element.className = "pane";
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.element.append(this.canvas);
    this.pointers = new Map();
    this.listen();
  }

  get box() {
    const { left, right, bottom, top: above } = this.gutter, top = this.label ? 26 : above;
    return { left, top, width: Math.max(this.canvas.clientWidth - left - right, 64), height: Math.max(this.canvas.clientHeight - top - bottom, 64) };
  }

  get shown() {
    const { width, height } = this.box;
    return fit((this.frame && this.frame.window) || this.window || this.whole, width, height);
  }

  get whole() {
    const { lower: [x0, y0], upper: [x1, y1] } = this.domain, margin = MARGIN * Math.max(x1 - x0, y1 - y0);
    return [x0 - margin, y0 - margin, x1 + margin, y1 + margin];
  }

  toPixels([x, y]) {
    const box = this.box, [x0, y0, x1, y1] = this.shown;
    return [box.left + ((x - x0) / (x1 - x0)) * box.width, box.top + ((y1 - y) / (y1 - y0)) * box.height];
  }

  toMetres(px, py) {
    const box = this.box, [x0, y0, x1, y1] = this.shown;
    return [x0 + ((px - box.left) / box.width) * (x1 - x0), y1 - ((py - box.top) / box.height) * (y1 - y0)];
  }

  inside(px, py) {
    const box = this.box;
    return px >= box.left && px <= box.left + box.width && py >= box.top && py <= box.top + box.height;
  }

  // Take a frame: its outlines, the bytes of its cells and of its lines, its colours, and whether time goes on.
  show(frame, outlines, cells, lines, look, moves) {
    if (cells && !this.cells) {
      this.cells = new Cells();
      this.cells.canvas.className = "cells";
      this.element.prepend(this.cells.canvas);
    }
    if (cells) this.cells.show(cells, frame.cells);
    outlines.turns = frame.turns;
    this.motion.take(outlines, frame.time, moves && !cells && !lines, performance.now());
    Object.assign(this, { frame, outlines, lines, look });
    this.paint();
  }

  paint() {
    if (!this.outlines) return;
    const { draw } = context(this.canvas);
    const paint = colours(this.root), box = this.box, shown = this.shown;
    draw.save();
    draw.beginPath();
    draw.rect(box.left, box.top, box.width, box.height);
    draw.clip();
    this.paintFlow(draw, paint, box, shown);
    this.paintMarks(draw, paint, box);
    draw.restore();
    if (!this.motion.rests && !this.due) this.due = requestAnimationFrame(() => {
      this.due = 0;
      this.paint();
    });
    if (this.gutter.left) axes(draw, box, shown, (at) => this.toPixels(at), paint, this.frame.notes.join(", "), this.domain);
    if (this.label) {
      draw.font = `600 13px ${paint.font}`;
      draw.textAlign = "left";
      draw.fillStyle = paint.text;
      draw.fillText(this.label, box.left, box.top - 11);
    }
  }

  paintFlow(draw, paint, box, [x0, y0, x1, y1]) {
    const across = box.width / (x1 - x0), up = box.height / (y1 - y0), { behind, smooth, openings, marks } = this.frame;
    const X = (x) => box.left + (x - x0) * across, Y = (y) => box.top + (y1 - y) * up;
    const theme = this.root.dataset.theme, { lower, upper } = this.domain, { cells, fade = 0 } = this.frame, byField = this.look.stops.length > 1;
    // Lit from above: each fluid from its colour at the top of the tank to that at the bottom; of one colour beside cells.
    const field = this.field && this.field(draw, X, Y);
    const all = this.fluids.map(({ [theme]: [top, bottom, mean] }, k) => {
      if (field && !field.plain.includes(k)) return field.fill;
      if (cells || fade) return mixed(mean, paint.stage, fade);
      const shade = draw.createLinearGradient(0, Y(upper[1]), 0, Y(lower[1]));
      shade.addColorStop(0, top);
      shade.addColorStop(1, bottom);
      return shade;
    });
    const fills = all.filter((_, k) => k !== behind), rest = behind === null ? null : all[behind];
    const seen = this.seen(smooth, Math.hypot(upper[0] - lower[0], upper[1] - lower[1]));
    if (this.cells) this.cells.canvas.hidden = !cells;
    if (cells) {
      draw.fillStyle = paint.stage; // beyond periodic sides
      draw.fillRect(box.left, box.top, box.width, box.height);
      this.cells.draw(this.canvas, box, [x0, y0, x1, y1], { ...this.look, fills: all, mesh: cells.mesh, spacing: this.domain.spacing });
    }
    drawOutlines(draw, X, Y, seen, {
      wall: paint.wall, body: paint.body, ground: paint.stage, line: field ? LINE : paint.edge, rim: field && RIM,
      fills, behind: rest, smooth, openings, marks, solids: this.frame.still ? this.domain.solids : [],
      over: cells && (() => drawInterfaces(draw, X, Y, this.outlines, { fills, behind: rest, sided: byField && this.fluids.length > 2, drops: !byField })),
    });
    if (this.frame.lines) drawLines(draw, X, Y, this.frame.lines, this.lines, this.domain.spacing);
    draw.strokeStyle = draw.fillStyle = "#3d4653";
    draw.lineWidth = 2.6;
    for (const [[ax, ay], [bx, by]] of seen.turns) {
      draw.beginPath();
      draw.moveTo(X(ax), Y(ay));
      draw.lineTo(X(bx), Y(by));
      draw.stroke();
      draw.beginPath();
      draw.arc(X(ax), Y(ay), 4, 0, 7);
      draw.fill();
    }
  }

  // The state that is seen now: on the way from one frame to the next.
  seen(smooth, size) {
    return this.motion.at(performance.now(), smooth, size);
  }

  paintMarks(draw, paint, box) {
    const ring = ([x, y], radius) => {
      for (const [colour, width] of [["#ffffff", 4], [paint.mark === "#ef8fc4" ? "#8a1f62" : paint.mark, 2]]) {
        draw.strokeStyle = colour;
        draw.lineWidth = width;
        draw.beginPath();
        draw.arc(x, y, radius, 0, 2 * Math.PI);
        draw.moveTo(x - radius - 5, y);
        draw.lineTo(x - radius + 2, y);
        draw.moveTo(x + radius - 2, y);
        draw.lineTo(x + radius + 5, y);
        draw.stroke();
      }
    };
    if (this.marks.point) ring(this.toPixels(this.marks.point), 6);
    const { push, refused } = this.marks;
    if (refused) { // a soft ring, and why
      const [x, y] = this.toPixels(refused.at);
      draw.globalAlpha = 0.75;
      ring([x, y], 16);
      draw.globalAlpha = 1;
      draw.font = `13px ${paint.font}`;
      draw.textAlign = "center";
      const half = draw.measureText(refused.text).width / 2 + 8, middle = Math.max(box.left + half, Math.min(box.left + box.width - half, x));
      const below = y + 58 < box.top + box.height ? y + 40 : y - 40;
      draw.fillStyle = paint.stage;
      draw.beginPath();
      draw.roundRect(middle - half, below - 13, 2 * half, 26, 13);
      draw.fill();
      draw.fillStyle = paint.text;
      draw.fillText(refused.text, middle, below);
    }
    if (push) {
      const at = this.toPixels(push.at), to = this.toPixels(push.to);
      const radius = Math.abs(this.toPixels([push.at[0] + push.radius, 0])[0] - at[0]);
      const dx = to[0] - at[0], dy = to[1] - at[1], length = Math.hypot(dx, dy) || 1, head = Math.min(14, length);
      const ux = dx / length, uy = dy / length, foot = [to[0] - head * ux, to[1] - head * uy];
      for (const [colour, more] of [["#ffffff", 3], ["#8a1f62", 0]]) {
        draw.strokeStyle = draw.fillStyle = colour;
        draw.lineWidth = 1.4 + more / 1.5;
        draw.beginPath();
        draw.arc(at[0], at[1], radius, 0, 2 * Math.PI);
        draw.stroke();
        draw.lineWidth = 3 + more;
        draw.beginPath();
        draw.moveTo(...at);
        draw.lineTo(...foot);
        draw.moveTo(foot[0] - 6 * uy, foot[1] + 6 * ux);
        draw.lineTo(...to);
        draw.lineTo(foot[0] + 6 * uy, foot[1] - 6 * ux);
        draw.closePath();
        draw.stroke();
        draw.fill();
      }
    }
  }

  // Zoom about a point in CSS pixels; factors below 1 show less.
  zoom(factor, px, py) {
    const [x, y] = this.toMetres(px, py), [x0, y0, x1, y1] = this.shown;
    this.move([x + (x0 - x) * factor, y + (y0 - y) * factor, x + (x1 - x) * factor, y + (y1 - y) * factor]);
  }

  // Zoom and pan about the middle of the picture; dx and dy are shares of it.
  shift(dx, dy) {
    const [x0, y0, x1, y1] = this.shown, w = (x1 - x0) * dx, h = (y1 - y0) * dy;
    this.move([x0 + w, y0 + h, x1 + w, y1 + h]);
  }

  // Whether a place in CSS pixels is in the box of the tank.
  inTank(px, py) {
    const { lower, upper } = this.domain;
    return this.toMetres(px, py).every((value, axis) => value >= lower[axis] && value <= upper[axis]);
  }

  // Drops where a pointer is, as long as it is held: the next as soon as there is room. Only the first may be refused.
  pour(id) {
    let poured = false;
    const drop = () => {
      const at = this.pointers.get(id);
      if (at && this.inTank(...at)) poured = this.events.drop(this.toMetres(...at), this, poured) || poured;
    };
    drop();
    clearInterval(this.pouring);
    this.pouring = setInterval(drop, POUR);
  }

  // See a window [m], whose middle stays in the tank.
  move(window) {
    const { lower, upper } = this.domain, middle = [0, 1].map((axis) => (window[axis] + window[axis + 2]) / 2);
    const back = middle.map((at, axis) => Math.max(lower[axis], Math.min(upper[axis], at)) - at);
    this.events.window(window.map((value, k) => value + back[k % 2]), this.number);
  }

  listen() {
    const canvas = this.canvas;
    const place = (event) => {
      const area = canvas.getBoundingClientRect();
      return [event.clientX - area.left, event.clientY - area.top];
    };
    canvas.addEventListener("wheel", (event) => {
      if (this.events.ignores && this.events.ignores()) return;
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : event.deltaMode === 2 ? 300 : 1;
      this.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY * lines * 0.0016))), ...place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      const at = place(event);
      this.pointers.set(event.pointerId, at);
      this.began = { at, window: this.shown, moved: false, tool: this.pointers.size === 1 && this.inside(...at) && this.inTank(...at) ? this.events.tool() : "look" };
      // A push that begins on a body drags it.
      if (this.began.tool === "poke" && this.events.hold(this.toMetres(...at), this, 0.7)) this.began.tool = "drag";
      else if (this.began.tool === "drag" && !this.events.hold(this.toMetres(...at), this, 1)) this.began.tool = "look";
      if (this.began.tool === "poke") this.events.push(this.toMetres(...at), this.toMetres(...at), this);
      if (this.began.tool === "drop") this.pour(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = place(event), held = this.pointers.get(event.pointerId);
      if (!held) {
        if (this.inside(...at)) this.events.hover(this.toMetres(...at), this.number);
        return;
      }
      if (this.pointers.size === 2) { // two fingers: zoom about their middle
        const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
        const before = Math.hypot(held[0] - other[0], held[1] - other[1]), now = Math.hypot(at[0] - other[0], at[1] - other[1]);
        if (now > 10 && before > 10) this.zoom(before / now, (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
      } else if (this.began.tool === "poke") {
        this.events.push(this.toMetres(...this.began.at), this.toMetres(...at), this);
      } else if (this.began.tool === "drag") {
        this.events.drag(this.toMetres(...at));
      } else if (Math.hypot(at[0] - this.began.at[0], at[1] - this.began.at[1]) > 3 || this.began.moved) {
        this.began.moved = true;
        if (this.began.tool === "look") {
          const [x0, y0, x1, y1] = this.began.window, box = this.box;
          const dx = ((this.began.at[0] - at[0]) / box.width) * (x1 - x0), dy = ((at[1] - this.began.at[1]) / box.height) * (y1 - y0);
          this.move([x0 + dx, y0 + dy, x1 + dx, y1 + dy]);
        }
      }
      this.pointers.set(event.pointerId, at);
    });
    const end = (event) => {
      if (!this.pointers.delete(event.pointerId)) return;
      clearInterval(this.pouring);
      if (["poke", "drag"].includes(this.began.tool)) this.events.release(this);
      else if (event.type === "pointerup" && !this.began.moved && this.pointers.size === 0 && this.inside(...this.began.at)) {
        if (this.began.tool === "look") this.events.pick(this.toMetres(...this.began.at), this.number);
      }
      this.began = { ...this.began, moved: true };
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => this.events.hover(null, this.number));
    canvas.addEventListener("dblclick", () => this.events.reset());
  }
}
