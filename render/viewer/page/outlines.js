// Outlines of fluids, bodies and walls: read from bytes, smoothed, and drawn on a canvas.

import { turned } from "./numbers.js";

const WALL = 9; // thickness of the walls' lines [px], of which the inner half is hidden

// Loops as `packing.packed` writes them: whole numbers of two or four bytes; places by their second differences.
export class OutlineReader {
  constructor(buffer, { lower, scale }, wide = false, from = 0) {
    [this.view, this.bytes] = [new DataView(buffer, from), new Uint8Array(buffer, from)];
    [this.lower, this.scale, this.wide, this.at] = [lower, scale, wide, 0];
  }

  whole() {
    const at = this.at;
    this.at += this.wide ? 4 : 2;
    return this.wide ? this.view.getUint32(at, true) : this.view.getUint16(at, true);
  }

  loop() {
    const count = this.whole(), points = new Float64Array(2 * count), fixed = new Uint8Array(count);
    const size = this.wide ? 4 : 2, mask = this.wide ? -1 : 65535;
    for (let axis = 0; axis < 2; axis++) {
      let step = 0, place = 0;
      turned(this.bytes, this.at, count, size).forEach((second, k) => {
        step = (step + second) & mask;
        place = (place + step) & mask;
        points[2 * k + axis] = this.lower[axis] + this.scale[axis] * (place >>> 0);
      });
      this.at += size * count;
    }
    for (let k = 0; k < count; k++) fixed[k] = (this.bytes[this.at + (k >> 3)] >> (7 - (k & 7))) & 1;
    this.at += (count + 7) >> 3;
    return { points, fixed };
  }

  // The layers of a state: the fluids that are drawn, the bodies, the walls.
  state(fluids) {
    return Array.from({ length: fluids + 2 }, () => Array.from({ length: this.whole() }, () => this.loop()));
  }
}

// Two passes of Taubin's filter, then corners cut three times by Chaikin's rule; points on walls stay. Kept with the loop.
export function smoothed(loop) {
  if (loop.smooth) return loop.smooth;
  if (loop.fixed.length < 4) return loop.points;
  let now = loop.points, held = loop.fixed, count = held.length;
  for (const share of [0.5, -0.53, 0.5, -0.53]) {
    const next = now.slice();
    for (let k = 0; k < count; k++) {
      if (held[k]) continue;
      const a = 2 * ((k + count - 1) % count), b = 2 * ((k + 1) % count);
      for (let axis = 0; axis < 2; axis++) next[2 * k + axis] += share * ((now[a + axis] + now[b + axis]) / 2 - now[2 * k + axis]);
    }
    now = next;
  }
  for (let cut = 0; cut < 3; cut++) {
    const next = new Float64Array(4 * count), keep = new Uint8Array(2 * count);
    for (let k = 0; k < count; k++) {
      const after = (k + 1) % count, one = held[k] ? 1 : 0.75, other = held[after] ? 0 : 0.25;
      for (let axis = 0; axis < 2; axis++) {
        const p = now[2 * k + axis], q = now[2 * after + axis];
        next[4 * k + axis] = one * p + (1 - one) * q;
        next[4 * k + 2 + axis] = other * p + (1 - other) * q;
      }
      keep[2 * k] = held[k];
      keep[2 * k + 1] = held[after];
    }
    [now, held, count] = [next, keep, 2 * count];
  }
  loop.held = held;
  return (loop.smooth = now);
}

// The number of the fluid of a state at a place: that within whose outlines it is, or the one behind all; null for none.
export function fluidAt(state, behind, [x, y]) {
  const within = (loops) => loops.reduce((inside, { points }) => {
    for (let k = 0, last = points.length - 2; k < points.length; last = k, k += 2) {
      const [ax, ay, bx, by] = [points[last], points[last + 1], points[k], points[k + 1]];
      if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) inside = !inside;
    }
    return inside;
  }, false);
  const count = state.length - 2, found = state.slice(0, count).findIndex(within);
  if (!within(state[count + 1]) || within(state[count])) return null;
  return found < 0 ? behind : found + (behind !== null && found >= behind);
}

// Distance from a place to the outlines of a state.
export function roomAt(state, [x, y]) {
  let least = Infinity;
  for (const { points } of state.flat()) for (let k = 0, last = points.length - 2; k < points.length; last = k, k += 2) {
    const [ax, ay, bx, by] = [points[last], points[last + 1], points[k] - points[last], points[k + 1] - points[last + 1]];
    const part = Math.max(0, Math.min(1, ((x - ax) * bx + (y - ay) * by) / (bx * bx + by * by || 1)));
    least = Math.min(least, Math.hypot(ax + part * bx - x, ay + part * by - y));
  }
  return least;
}

// Add the sides of a line to the path of a pen: those that are not along walls, or all.
export function addSides(pen, X, Y, points, fixed, whole = false) {
  const count = fixed.length;
  for (let k = 0, joined = false; k < count; k++) {
    const next = (k + 1) % count, seen = whole || !(fixed[k] && fixed[next]);
    if (seen && !joined) pen.moveTo(X(points[2 * k]), Y(points[2 * k + 1]));
    if (seen) pen.lineTo(X(points[2 * next]), Y(points[2 * next + 1]));
    joined = seen;
  }
}

// Draw a state. X and Y take metres to pixels; look has the colours wall, body, ground, line and its rim or null; the fills of the fluids
// that are drawn, and behind: that of the fluid that fills the rest or null; whether lines are smooth; openings with the
// colours of their marks; solids: radius and corners of those that are filled while that is thin; and over: what is drawn
// over fluids beneath the canvas, if they are there.
export function drawOutlines(pen, X, Y, state, look) {
  const trace = (loops, lines) => {
    pen.beginPath();
    for (const loop of loops) {
      const points = lines(loop);
      pen.moveTo(X(points[0]), Y(points[1]));
      for (let k = 2; k < points.length; k += 2) pen.lineTo(X(points[k]), Y(points[k + 1]));
      pen.closePath();
    }
  };
  const plain = (loop) => loop.points, count = look.fills.length, walls = state[count + 1], bodies = state[count];
  pen.lineJoin = "round";
  trace(walls, plain);
  pen.strokeStyle = look.wall;
  pen.lineWidth = WALL;
  pen.stroke();
  pen.fillStyle = look.wall;
  for (const [radius, ...corners] of look.solids || []) {
    if (X(radius) - X(0) > 1.5 * WALL) continue;
    pen.beginPath();
    for (let k = 0; k < corners.length; k += 2) pen.lineTo(X(corners[k]), Y(corners[k + 1]));
    pen.closePath();
    pen.fill();
    pen.lineWidth = corners.length === 4 ? WALL : 1; // a gap in the walls, or a triangle with its seams
    pen.stroke();
  }
  trace(walls, plain);
  pen.save();
  pen.clip("evenodd");
  if (look.over) pen.globalCompositeOperation = "destination-out";
  pen.fillStyle = look.behind || look.ground;
  pen.fill("evenodd");
  pen.globalCompositeOperation = "source-over";
  if (look.over) look.over();
  else look.fills.forEach((fill, k) => {
    trace(state[k], look.smooth ? smoothed : plain);
    pen.fillStyle = fill;
    pen.fill("evenodd");
    pen.beginPath();
    for (const loop of state[k]) {
      const points = look.smooth ? smoothed(loop) : loop.points;
      addSides(pen, X, Y, points, points === loop.smooth ? loop.held : loop.fixed);
    }
    const width = look.behind ? 1.6 : 0.9;
    for (const [colour, wide] of look.rim ? [[look.rim, width + 2], [look.line, width]] : [[look.line, width]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = wide;
      pen.stroke();
    }
  });
  pen.restore();
  drawOpenings(pen, X, Y, look);
  trace(bodies, plain);
  pen.fillStyle = look.body;
  pen.fill("evenodd");
  pen.strokeStyle = look.wall;
  pen.lineWidth = 2;
  pen.stroke();
}

// Arrows through the openings in walls, each [kind, x0, y0, x1, y1, inwards x, y, whether fluid comes in].
function drawOpenings(pen, X, Y, { openings = [], marks = {}, ground }) {
  pen.lineWidth = 2;
  for (const [kind, x0, y0, x1, y1, u, v, enters] of openings) {
    const count = Math.max(1, Math.round(Math.hypot(X(x1) - X(x0), Y(y1) - Y(y0)) / 26));
    pen.beginPath();
    for (const [px, py] of [[X(x0), Y(y0)], [X(x1), Y(y1)], [X(x1) - 5 * u, Y(y1) + 5 * v], [X(x0) - 5 * u, Y(y0) + 5 * v]]) pen.lineTo(px, py);
    pen.fillStyle = ground;
    pen.fill();
    pen.fillStyle = marks[kind];
    for (let k = 0; k < count; k++) {
      const part = (k + 0.5) / count, px = X(x0 + part * (x1 - x0)), py = Y(y0 + part * (y1 - y0));
      const [from, to] = enters ? [-5, 13] : [13, -5], way = Math.sign(to - from);
      const at = (along, aside) => [px + along * u - aside * v, py - along * v - aside * u];
      pen.beginPath();
      for (const [along, aside] of [[from, 1], [to - 8 * way, 1], [to - 8 * way, 4], [to, 0], [to - 8 * way, -4], [to - 8 * way, -1], [from, -1]]) pen.lineTo(...at(along, aside));
      pen.closePath();
      pen.strokeStyle = "#ffffff";
      pen.stroke();
      pen.fill();
    }
  }
}
