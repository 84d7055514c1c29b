// Triangles coloured by a field or by their fluid, and the edges between them, on a canvas of its own: drawn by WebGL 2
// where a graphics card does it, else here, which is faster than a card that is emulated.

import { turned } from "./numbers.js";
import { addSides } from "./outlines.js";

const PLACE = `#version 300 es
in vec2 at; in float value; uniform vec2 origin, scale; uniform float size; out float v; out vec3 corner;
void main() {
  v = value;
  corner = vec3(gl_VertexID % 3 == 0, gl_VertexID % 3 == 1, gl_VertexID % 3 == 2);
  gl_Position = vec4((at - origin) * scale - 1.0, 0.0, 1.0);
  gl_PointSize = size;
}`;
const COLOUR = `#version 300 es
precision highp float;
in float v; in vec3 corner; uniform sampler2D map; uniform vec2 range; uniform vec4 flat_; uniform vec2 line; uniform float size; out vec4 colour;
void main() {
  if (size > 0.0 && length(gl_PointCoord - 0.5) > 0.5) discard;
  float stops = float(textureSize(map, 0).x), share = clamp((v - range.x) / (range.y - range.x), 0.0, 1.0);
  vec3 found = flat_.a > 0.0 ? flat_.rgb : texture(map, vec2((share * (stops - 1.0) + 0.5) / stops, 0.5)).rgb;
  if (line.y > 0.0) {
    vec3 far = corner / fwidth(corner);
    float near = clamp(line.x + 0.5 - min(far.x, min(far.y, far.z)), 0.0, 1.0);
    float light = dot(found, vec3(0.2126, 0.7152, 0.0722));
    found = mix(found, light > 0.45 ? 0.62 * found : mix(found, vec3(1.0), 0.38), near * line.y);
  }
  colour = vec4(found, 1.0);
}`;
const FINEST = [3, 7]; // lengths of edges [px] between which they appear: a finer mesh would only be a grey veil
const rgb = (code) => [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16) / 255);

// Whether WebGL 2 is there, and no processor stands in for its card.
function hasCard() {
  const gl = document.createElement("canvas").getContext("webgl2"), named = gl && gl.getExtension("WEBGL_debug_renderer_info");
  return Boolean(gl) && !/swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

export class Cells {
  constructor() {
    this.canvas = document.createElement("canvas");
    const gl = (this.gl = hasCard() ? this.canvas.getContext("webgl2", { antialias: false, depth: false }) : null);
    if (!gl) return;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, PLACE], [gl.FRAGMENT_SHADER, COLOUR]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    this.place = (name) => gl.getUniformLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    for (const [name, size, from] of [["at", 2, 0], ["value", 1, 8]]) {
      const attribute = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(attribute);
      gl.vertexAttribPointer(attribute, size, gl.FLOAT, false, 12, from);
    }
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
  }

  // Take the cells of a state: places, values and triangles, of which each gets corners of its own.
  show(buffer, head) {
    const { nodes, loose, by_cell: byCell, wide, parts, step, low, span } = head, count = parts.reduce((sum, [size]) => sum + size, 0);
    const bytes = new Uint8Array(buffer), dots = new Uint32Array(buffer, 0, loose), corners = new Uint32Array(3 * count), mask = wide ? -1 : 65535;
    const values = new Float32Array(byCell ? count : nodes).fill(low), at = step ? new Float32Array(2 * nodes) : new Float32Array(buffer, 4 * loose, 2 * nodes);
    let from = 4 * loose + (step ? 0 : 8 * nodes), sum = 0;
    const steps = (length, size) => turned(bytes, (from += size * length) - size * length, length, size);
    for (const axis of step ? [0, 1] : []) {
      sum = 0;
      steps(nodes, 2).forEach((move, k) => (at[2 * k + axis] = (sum = (sum + move) & 65535) * step[axis]));
    }
    sum = 0;
    steps(count, wide ? 4 : 2).forEach((move, k) => (corners[3 * k] = sum = (sum + move) & mask));
    for (const column of [1, 2]) steps(count, wide ? 4 : 2).forEach((move, k) => (corners[3 * k + column] = (corners[3 * k] + move) & mask));
    sum = 0;
    if (from < bytes.length) steps(values.length, 2).forEach((move, k) => (values[k] = low + ((sum = (sum + move) & 65535) * span) / 65535));
    this.head = head;
    this.state = { at, values, dots, corners };
    if (!this.gl) return;
    const all = new Float32Array(3 * (3 * count + loose));
    const put = (k, node, value) => {
      all[3 * k] = at[2 * node];
      all[3 * k + 1] = at[2 * node + 1];
      all[3 * k + 2] = value;
    };
    for (let k = 0; k < 3 * count; k++) put(k, corners[k], byCell ? values[(k / 3) | 0] : values[corners[k]]);
    for (let k = 0; k < loose; k++) put(3 * count + k, dots[k], byCell ? 0 : values[dots[k]]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, all, this.gl.DYNAMIC_DRAW);
  }

  // Draw a window [m] into a box [CSS px] of a canvas that lies on this one. look: stops of the colour map, low, high,
  // fills of the fluids, mesh, spacing.
  draw(over, box, shown, look) {
    const { gl, place, head } = this, [left, bottom] = head.origin, ratio = window.devicePixelRatio || 1, width = box.width * ratio;
    const [x0, y0, x1, y1] = shown, { stops, low, high, fills, mesh, spacing } = look;
    if (this.canvas.width !== over.width || this.canvas.height !== over.height) [this.canvas.width, this.canvas.height] = [over.width, over.height];
    const pixels = width / (x1 - x0), fine = Math.min(1, Math.max(0, (spacing * pixels - FINEST[0]) / (FINEST[1] - FINEST[0])));
    if (!gl) return this.paint(box, shown, look, ratio, mesh ? fine : 0);
    if (stops !== this.stops) {
      this.stops = stops;
      const texels = new Uint8Array(stops.flatMap((stop) => [...rgb(stop).map((part) => Math.round(255 * part)), 255]));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, stops.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    }
    gl.viewport(box.left * ratio, over.height - (box.top + box.height) * ratio, width, box.height * ratio);
    gl.uniform2f(place("origin"), x0 - left, y0 - bottom);
    gl.uniform2f(place("scale"), 2 / (x1 - x0), 2 / (y1 - y0));
    gl.uniform2f(place("range"), low, high);
    gl.uniform2f(place("line"), 0.45 * ratio, mesh ? fine : 0);
    gl.uniform1f(place("size"), 0);
    let first = 0;
    for (const [size, fluid] of head.parts) {
      gl.uniform4f(place("flat_"), ...(fluid < 0 ? [0, 0, 0, 0] : [...rgb(fills[fluid]), 1]));
      gl.drawArrays(gl.TRIANGLES, 3 * first, 3 * size);
      first += size;
    }
    if (head.loose && !head.by_cell && stops.length > 1) {
      gl.uniform4f(place("flat_"), 0, 0, 0, 0);
      gl.uniform2f(place("line"), 0, 0);
      gl.uniform1f(place("size"), Math.max(0.8 * spacing * pixels, 2));
      gl.drawArrays(gl.POINTS, 3 * first, head.loose);
    }
  }
  // The same without a graphics card: pixel by pixel, by the distances to the sides of each triangle.
  paint(box, [x0, y0, x1, y1], { stops, low, high, fills, spacing }, ratio, mesh) {
    const { at, values, dots, corners } = this.state, { origin, parts, by_cell: byCell } = this.head;
    const wide = Math.round(box.width * ratio), tall = Math.round(box.height * ratio), pen = (this.pen ||= this.canvas.getContext("2d"));
    if (!this.image || this.image.width !== wide || this.image.height !== tall) {
      this.image = pen.createImageData(wide, tall);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }
    const out = this.pixels.fill(0), sx = wide / (x1 - x0), sy = tall / (y1 - y0), ox = origin[0] - x0, oy = origin[1] - y0;
    const code = ([r, g, b]) => (255 << 24) | (Math.round(255 * b) << 16) | (Math.round(255 * g) << 8) | Math.round(255 * r);
    const table = new Uint32Array(256), colours = stops.map(rgb), far = stops.length - 1;
    for (let k = 0; k < 256; k++) {
      const n = Math.min(Math.floor((k / 255) * far), Math.max(far - 1, 0)), share = (k / 255) * far - n;
      table[k] = code(colours[n].map((part, c) => part + share * (colours[Math.min(n + 1, far)][c] - part)));
    }
    const scale = 255 / (high - low || 1), index = (value) => Math.max(0, Math.min(255, (value - low) * scale + 0.5)) | 0;
    const reach = 0.45 * ratio + 0.5;
    let t = 0;
    for (const [count, fluid] of parts) {
      const flat = fluid < 0 ? 0 : code(rgb(fills[fluid]));
      for (const end = t + count; t < end; t++) {
        const a = corners[3 * t];
        let b = corners[3 * t + 2], c = corners[3 * t + 1]; // pixels count downwards
        const ax = (at[2 * a] + ox) * sx, ay = tall - (at[2 * a + 1] + oy) * sy;
        let bx = (at[2 * b] + ox) * sx, by = tall - (at[2 * b + 1] + oy) * sy, cx = (at[2 * c] + ox) * sx, cy = tall - (at[2 * c + 1] + oy) * sy;
        let area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
        if (area < 0) [b, c, bx, by, cx, cy, area] = [c, b, cx, cy, bx, by, -area];
        const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), right = Math.min(wide - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
        const top = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), bottom = Math.min(tall - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
        if (!area || left > right || top > bottom) continue;
        const va = byCell ? values[t] : values[a], vb = byCell ? va : values[b], vc = byCell ? va : values[c];
        // Distances to the sides times their lengths, and the place in the table of colours, are linear.
        const ux = by - cy, uy = cx - bx, vx = cy - ay, vy = ax - cx, wx = -ux - vx, wy = -uy - vy;
        const ka = (va * scale) / area, kb = (vb * scale) / area, kc = (vc * scale) / area, sx_ = ux * ka + vx * kb + wx * kc;
        const ia = 1 / Math.sqrt(ux * ux + uy * uy), ib = 1 / Math.sqrt(vx * vx + vy * vy), ic = 1 / Math.sqrt(wx * wx + wy * wy);
        for (let y = top; y <= bottom; y++) {
          let u = (left + 0.5 - bx) * ux + (y + 0.5 - by) * uy, v = (left + 0.5 - cx) * vx + (y + 0.5 - cy) * vy, w = area - u - v;
          let s = u * ka + v * kb + w * kc - low * scale + 0.5;
          for (let n = y * wide + left, end_ = y * wide + right; n <= end_; n++, u += ux, v += vx, w += wx, s += sx_) {
            if (u < 0 || v < 0 || w < 0) continue;
            const found = flat || table[s < 0 ? 0 : s > 255 ? 255 : s | 0];
            const far_ = mesh ? Math.min(u * ia, v * ib, w * ic) : reach;
            out[n] = far_ < reach ? toned(found, Math.min(1, reach - far_) * mesh) : found;
          }
        }
      }
    }
    const radius = Math.max(0.4 * spacing * sx, 1);
    for (const k of !byCell && stops.length > 1 ? dots : []) {
      const px = (at[2 * k] + ox) * sx, py = tall - (at[2 * k + 1] + oy) * sy, colour = table[index(values[k])];
      for (let y = Math.max(0, Math.ceil(py - radius)); y <= Math.min(tall - 1, py + radius); y++) {
        const half = Math.sqrt(Math.max(0, radius ** 2 - (y - py) ** 2));
        for (let x = Math.max(0, Math.ceil(px - half)); x <= Math.min(wide - 1, px + half); x++) out[y * wide + x] = colour;
      }
    }
    pen.putImageData(this.image, Math.round(box.left * ratio), Math.round(box.top * ratio));
  }
}

// A colour of a pixel where a line of the mesh passes: darker on light ones, lighter on dark ones, as the shader has it.
function toned(colour, near) {
  const r = colour & 255, g = (colour >> 8) & 255, b = (colour >> 16) & 255;
  const light = 0.2126 * r + 0.7152 * g + 0.0722 * b > 114.75, kept = 1 - 0.38 * near, more = light ? 0 : 255 * (1 - kept);
  return (255 << 24) | ((kept * b + more) << 16) | ((kept * g + more) << 8) | (kept * r + more);
}

// Lines between fluids over a field, with a pale rim that is seen on every colour; where the colours do not tell fluids
// apart, sided: with stripes of their fills, and that of the fluid behind.
export function drawInterfaces(pen, X, Y, state, { fills, behind, sided, drops }) {
  const isDrop = ({ fixed }) => fixed.length === 4 && !fixed.some(Boolean);
  const between = (loops, whole) => {
    pen.beginPath();
    for (const { points, fixed } of loops.filter((loop) => !isDrop(loop))) addSides(pen, X, Y, points, fixed, whole);
  };
  const stroke = (colour, width, chosen = fills.map((_, k) => k)) => {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    for (const k of chosen) {
      between(state[k], false);
      pen.stroke();
    }
  };
  pen.lineJoin = "round";
  if (drops) fills.forEach((fill, k) => {
    pen.fillStyle = fill;
    for (const { points } of state[k].filter(isDrop)) {
      pen.beginPath();
      pen.arc((X(points[0]) + X(points[4])) / 2, (Y(points[1]) + Y(points[5])) / 2, Math.abs(X(points[0]) - X(points[4])) / 2, 0, 7);
      pen.fill();
    }
  });
  if (sided && behind) stroke(behind, 11);
  if (sided) fills.forEach((fill, k) => {
    pen.save();
    between(state[k], true);
    pen.clip("evenodd");
    stroke(fill, 11, [k]);
    pen.restore();
  });
  stroke("#ffffff", 4.2);
  stroke("#061528", 2);
}
