// The picture between two states: bodies and walls by their poses, outlines of fluids point by point; what has no like in
// the other state, as a drop that has just come off, appears half-way.

import { smoothed } from "./outlines.js";

const SLACK = 48; // points by which places along two outlines may differ, besides the difference of their numbers
const FAR = 0.04; // of the picture: a part of an outline that is twice as far away has changed its shape, not moved
const LONGEST = 250, MEMORY = 1000; // [ms] for the way from one state to the next; of what the pace is taken from
const UNEVEN = 4; // times the usual time between states, from which on a state is another one, not the next

function box(loop) {
  if (loop.box) return loop.box;
  const found = [Infinity, Infinity, -Infinity, -Infinity];
  loop.points.forEach((value, k) => {
    found[k % 2] = Math.min(found[k % 2], value);
    found[2 + (k % 2)] = Math.max(found[2 + (k % 2)], value);
  });
  return (loop.box = found);
}

// Loops of two states that are the nearest to each other, and those that are left over.
function paired(before, after, most) {
  const best = (loops, others) => loops.map((loop) => {
    const own = box(loop);
    let found = -1, least = most;
    others.forEach((other, k) => {
      const their = box(other), far = Math.abs(own[0] - their[0]) + Math.abs(own[1] - their[1]) + Math.abs(own[2] - their[2]) + Math.abs(own[3] - their[3]);
      if (far < least) [found, least] = [k, far];
    });
    return found;
  });
  const onwards = best(before, after), back = best(after, before), mutual = (k) => onwards[k] >= 0 && back[onwards[k]] === k;
  const pairs = before.flatMap((loop, k) => (mutual(k) ? [{ a: loop, b: after[onwards[k]], path: matched(loop, after[onwards[k]]) }] : []));
  return { pairs, gone: before.filter((_, k) => !mutual(k)), come: after.filter((_, k) => back[k] < 0 || onwards[back[k]] !== k) };
}

// Points of two loops that belong together: the pairs in order along both of them whose distances are least in squares
// (dynamic time warping), in a band about equal numbers. It begins at a point on a wall, which moves little.
function matched(a, b) {
  const n = a.fixed.length, m = b.fixed.length, p = a.points, q = b.points, first = Math.max(0, a.fixed.indexOf(1));
  const held = a.fixed[first] && b.fixed.includes(1), shift = held ? [0, 0] : [0, 1].map((k) => (box(b)[k] + box(b)[k + 2] - box(a)[k] - box(a)[k + 2]) / 2);
  const gap = (i, j, dx = 0, dy = 0) => (q[2 * j] - p[2 * i] - dx) ** 2 + (q[2 * j + 1] - p[2 * i + 1] - dy) ** 2;
  let start = 0, least = Infinity;
  for (let j = 0; j < m; j++) {
    const far = held && !b.fixed[j] ? Infinity : gap(first, j, ...shift);
    if (far < least) [start, least] = [j, far];
  }
  const low = Math.min(0, m - n) - SLACK, width = Math.max(0, m - n) + SLACK - low + 1, from = new Uint8Array((n + 1) * width);
  let row = new Float64Array(width + 1).fill(Infinity), last = row.slice();
  for (let i = 0; i <= n; i++) {
    [row, last] = [last.fill(Infinity), row];
    const x = p[2 * ((first + i) % n)], y = p[2 * ((first + i) % n) + 1];
    for (let c = Math.max(0, -low - i); c < width && i + low + c <= m; c++) {
      const their = 2 * ((start + i + low + c) % m), far = (q[their] - x) ** 2 + (q[their + 1] - y) ** 2, both = last[c], one = last[c + 1], other = c ? row[c - 1] : Infinity;
      const way = both <= one && both <= other ? 0 : one <= other ? 1 : 2, before = way ? (way === 1 ? one : other) : both;
      row[c] = far + (before < Infinity ? before : i + c + low ? Infinity : 0);
      from[i * width + c] = way;
    }
  }
  const path = [];
  for (let i = n, j = m; i > 0 || j > 0; ) {
    const way = from[i * width + j - i - low];
    if (way < 2) i--;
    if (way !== 1) j--;
    const own = (first + i) % n, other = (start + j) % m; // where a piece begins, which goes on along both, or one alone
    path.push([own, other, way, Math.sqrt(gap(own, other))]);
  }
  return path.reverse();
}

function blended({ a, b, path }, share, smooth, most) {
  const p = smooth ? smoothed(a) : a.points, q = smooth ? smoothed(b) : b.points;
  const fine = p.length / a.points.length, other = q.length / b.points.length, pieces = Math.max(fine, other);
  const points = new Float64Array(2 * pieces * path.length), held = smooth && a.held ? a.held : a.fixed, fixed = new Uint8Array(pieces * path.length);
  let at = 0;
  for (const [i, j, way, far] of path) {
    const moved = Math.min(1, Math.max(0, 2 - far / most)), part = share * moved + Math.round(share) * (1 - moved);
    for (let k = 0; k < pieces; k++) {
      const own = 2 * (i * fine + (way === 2 ? 0 : Math.floor((k * fine) / pieces))), their = 2 * (j * other + (way === 1 ? 0 : Math.floor((k * other) / pieces)));
      fixed[at / 2] = held[own / 2];
      points[at++] = p[own] + part * (q[their] - p[own]);
      points[at++] = p[own + 1] + part * (q[their + 1] - p[own + 1]);
    }
  }
  return { points, fixed, smooth: points, held: fixed };
}

// What is rigid, or nearly so, turned and moved a share of the way.
function posed(a, b, share) {
  const p = a.points, q = b.points, count = p.length / 2, middle = (points, axis) => points.reduce((sum, value, k) => sum + (k % 2 === axis ? value : 0), 0) / count;
  const [px, py, qx, qy] = [middle(p, 0), middle(p, 1), middle(q, 0), middle(q, 1)];
  let across = 0, along = 0;
  for (let k = 0; k < 2 * count; k += 2) {
    across += (p[k] - px) * (q[k + 1] - qy) - (p[k + 1] - py) * (q[k] - qx);
    along += (p[k] - px) * (q[k] - qx) + (p[k + 1] - py) * (q[k + 1] - qy);
  }
  const angle = Math.atan2(across, along), turn = (x, y, by) => [x * Math.cos(by) - y * Math.sin(by), x * Math.sin(by) + y * Math.cos(by)];
  const points = new Float64Array(2 * count);
  for (let k = 0; k < 2 * count; k += 2) {
    const one = turn(p[k] - px, p[k + 1] - py, share * angle), other = turn(q[k] - qx, q[k + 1] - qy, (share - 1) * angle);
    points[k] = px + share * (qx - px) + one[0] + share * (other[0] - one[0]);
    points[k + 1] = py + share * (qy - py) + one[1] + share * (other[1] - one[1]);
  }
  return { points, fixed: a.fixed };
}

// The state at a share of the way from one to another, of a picture of some size [m].
export function between(before, after, share, smooth, size) {
  if (share <= 0 || share >= 1) return share <= 0 ? before : after;
  const fluids = before.length - 2;
  if (after.before !== before) {
    after.before = before;
    after.layers = before.slice(0, fluids).map((loops, k) => paired(loops, after[k], 4 * FAR * size));
  }
  const nearer = (one, other) => (share < 0.5 ? one : other);
  const state = after.layers.map(({ pairs, gone, come }) => [
    ...pairs.map((pair) => blended(pair, share, smooth, FAR * size)), ...nearer(gone, come),
  ]);
  for (const k of [fluids, fluids + 1]) {
    const like = before[k].length === after[k].length && before[k].every(({ points }, n) => points.length === after[k][n].points.length);
    state.push(like ? before[k].map((loop, n) => posed(loop, after[k][n], share)) : nearer(before[k], after[k]));
  }
  const turns = before.turns || [], other = after.turns || [], mix = (one, two) => one.map((value, k) => (Array.isArray(value) ? mix(value, two[k]) : value + share * (two[k] - value)));
  state.turns = turns.length === other.length ? mix(turns, other) : other;
  return state;
}

// States that come one after another at a pace of their own, seen one step later without jerks.
export class Motion {
  constructor() {
    this.states = [];
    this.time = 0; // of what is seen [s]
  }

  get last() {
    return this.states[this.states.length - 1];
  }

  get rests() {
    return !this.last || this.time >= this.last.time;
  }

  // Take a state; where it does not go on from the last one, it is seen at once.
  take(state, time, moves, now) {
    const { last } = this, usual = this.pace ? this.step * UNEVEN : Infinity;
    if (moves && last && time === last.time) return (last.state = state); // of what else is seen beside it
    if (!moves || !last || time <= last.time || time - last.time > usual || now - last.come > 2 * MEMORY) {
      [this.states, this.come, this.time, this.pace, this.now] = [[], [], time, 0, now];
    }
    this.states.push({ state, time, come: now });
    this.come = [...this.come.filter((one) => now - one.now < MEMORY), { now, time }].slice(-30);
    const first = this.come[0], count = this.come.length - 1;
    if (!count) return;
    this.step = (time - first.time) / count;
    this.pace = Math.max((time - first.time) / Math.max(now - first.now, 1), this.step / LONGEST); // [s] a millisecond
    if (this.time >= last.time) this.now = now; // it has waited for this state
  }

  // What is seen now.
  at(now, smooth, size) {
    const { last } = this;
    if (!this.rests) {
      const late = (last.time - this.step - this.time) / this.step; // in states
      this.time = Math.min(last.time, this.time + this.pace * Math.max(0, now - this.now) * Math.max(0.5, 1 + 0.3 * late));
    }
    this.now = now;
    while (this.states.length > 1 && this.states[1].time <= this.time) this.states.shift();
    const [before, after] = this.states;
    return after ? between(before.state, after.state, (this.time - before.time) / (after.time - before.time), smooth, size) : before.state;
  }
}
