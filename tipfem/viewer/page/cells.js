// Triangles coloured by a field or by their fluid, and the edges between them: drawn by WebGL 2 on a canvas of its own.

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

export class Cells {
  constructor() {
    this.canvas = document.createElement("canvas");
    const gl = (this.gl = this.canvas.getContext("webgl2", { antialias: false, depth: false }));
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

  get there() {
    return Boolean(this.gl) && !this.gl.isContextLost();
  }

  // Take the cells of a state: places, values and triangles, of which each gets corners of its own.
  show(buffer, head) {
    const { nodes, loose, by_cell: byCell, wide, parts } = head, count = parts.reduce((sum, [size]) => sum + size, 0);
    const at = new Float32Array(buffer, 0, 2 * nodes), values = new Float32Array(buffer, 8 * nodes, byCell ? count : nodes);
    const dots = new Uint32Array(buffer, 8 * nodes + 4 * values.length, loose);
    const corners = new (wide ? Uint32Array : Uint16Array)(buffer, 8 * nodes + 4 * (values.length + loose), 3 * count);
    const all = new Float32Array(3 * (3 * count + loose));
    const put = (k, node, value) => {
      all[3 * k] = at[2 * node];
      all[3 * k + 1] = at[2 * node + 1];
      all[3 * k + 2] = value;
    };
    for (let k = 0; k < 3 * count; k++) put(k, corners[k], byCell ? values[(k / 3) | 0] : values[corners[k]]);
    for (let k = 0; k < loose; k++) put(3 * count + k, dots[k], byCell ? 0 : values[dots[k]]);
    this.head = head;
    this.gl.bufferData(this.gl.ARRAY_BUFFER, all, this.gl.DYNAMIC_DRAW);
  }

  // Draw a window [m] into a box [CSS px] of a canvas that lies on this one. look: stops of the colour map, low, high,
  // fills of the fluids, mesh, spacing.
  draw(over, box, [x0, y0, x1, y1], { stops, low, high, fills, mesh, spacing }) {
    const { gl, place, head } = this, [left, bottom] = head.origin, ratio = window.devicePixelRatio || 1, width = box.width * ratio;
    if (this.canvas.width !== over.width || this.canvas.height !== over.height) [this.canvas.width, this.canvas.height] = [over.width, over.height];
    if (stops !== this.stops) {
      this.stops = stops;
      const texels = new Uint8Array(stops.flatMap((stop) => [...rgb(stop).map((part) => Math.round(255 * part)), 255]));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, stops.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    }
    const pixels = width / (x1 - x0), fine = Math.min(1, Math.max(0, (spacing * pixels - FINEST[0]) / (FINEST[1] - FINEST[0])));
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
}

// Lines between fluids over a field, with a pale rim that is seen on every colour; where the colours do not tell fluids
// apart, sided: with stripes of their fills, and that of the fluid behind.
export function drawInterfaces(pen, X, Y, state, { fills, behind, sided, drops }) {
  const isDrop = ({ fixed }) => fixed.length === 4 && !fixed.some(Boolean);
  const between = (loops, whole) => {
    pen.beginPath();
    for (const { points, fixed } of loops.filter((loop) => !isDrop(loop))) {
      const count = fixed.length;
      for (let k = 0, joined = false; k < count; k++) {
        const next = (k + 1) % count, seen = whole || !(fixed[k] && fixed[next]);
        if (seen && !joined) pen.moveTo(X(points[2 * k]), Y(points[2 * k + 1]));
        if (seen) pen.lineTo(X(points[2 * next]), Y(points[2 * next + 1]));
        joined = seen;
      }
    }
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
  stroke("#0b2239", 2);
}
