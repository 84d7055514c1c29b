// The surface of a fluid in 3-D: states read from bytes, and the tank with the fluid as WebGL 2 draws them.

import { turned } from "./numbers.js";

const FRONT = [-25, 18]; // azimuth and elevation [degrees]
const FLAT = 0, FREE = 1, EDGE = 2, CUT = 3, BLOCK = 4;

const VERTEX = `#version 300 es
precision highp float;
uniform mat4 view;
in vec3 place, normal;
out vec3 at, out_normal;
void main() {
  at = place;
  out_normal = normal;
  gl_Position = view * vec4(place, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 eye, up, tint, sky;
uniform vec4 cut; // its normal towards the reader, and its distance from the origin
uniform float opacity;
uniform int kind;
in vec3 at, out_normal;
out vec4 colour;
void main() {
  if (kind == ${EDGE}) {
    colour = vec4(tint * opacity, opacity);
    return;
  }
  if (kind == ${CUT}) {
    colour = vec4(tint, 1.0);
    return;
  }
  if (dot(cut.xyz, at) > cut.w) discard;
  vec3 ray = normalize(at - eye);
  if (kind == ${BLOCK}) {
    vec3 side = normalize(cross(dFdx(at), dFdy(at)));
    side *= -sign(dot(side, ray));
    colour = vec4(tint * (0.8 + 0.2 * dot(side, up)), 1.0);
    return;
  }
  vec3 n = kind == ${FLAT} ? normalize(cross(dFdx(at), dFdy(at))) : normalize(out_normal);
  if (dot(n, ray) > 0.0) n = -n;
  float facing = -dot(n, ray), mirror = 0.02 + 0.98 * pow(1.0 - facing, 5.0);
  if (kind == ${FLAT}) mirror *= 0.2;
  vec3 back = reflect(ray, n);
  float glint = kind == ${FLAT} ? 0.0 : pow(max(dot(back, normalize(up - 0.4 * ray)), 0.0), 60.0) * 0.5;
  vec3 body = tint * (0.62 + 0.38 * max(dot(n, up), 0.0));
  float whole = min(1.0, opacity + mirror + glint);
  colour = vec4(min(mix(body, sky, mirror) + glint, 1.0) * whole, whole);
}`;

// States of a page, from bytes of which solid_share.py tells; facts has the numbers of points and faces.
export function readStates(buffer, { counts, lower, upper }) {
  const bytes = new Uint8Array(buffer);
  let from = 0;
  const numbers = (count) => turned(bytes, (from += 4 * count) - 4 * count, count, 4);
  return counts.map(([points, faces, flat]) => {
    const places = new Float32Array(3 * points), corners = new Uint32Array(3 * faces);
    for (let axis = 0; axis < 3; axis++) {
      let sum = 0;
      numbers(points).forEach((move, k) => (places[3 * k + axis] = lower[axis] + ((sum += move) / 65535) * (upper[axis] - lower[axis])));
    }
    let first = 0;
    const firsts = numbers(faces).map((step) => (first += step));
    for (const [column, steps] of [[1, numbers(faces)], [2, numbers(faces)]]) steps.forEach((step, k) => (corners[3 * k + column] = firsts[k] + step));
    firsts.forEach((corner, k) => (corners[3 * k] = corner));
    return { places, corners, flat, normals: normalsOf(places, corners, flat) };
  });
}

// Means of the faces off the walls about each point.
function normalsOf(places, corners, flat) {
  const normals = new Float32Array(places.length);
  for (let k = 3 * flat; k < corners.length; k += 3) {
    const [a, b, c] = [0, 1, 2].map((corner) => 3 * corners[k + corner]);
    const u = [0, 1, 2].map((axis) => places[b + axis] - places[a + axis]), v = [0, 1, 2].map((axis) => places[c + axis] - places[a + axis]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const corner of [a, b, c]) for (let axis = 0; axis < 3; axis++) normals[corner + axis] += n[axis];
  }
  return normals;
}

const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);
const hex = (code) => [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16) / 255);

// Triangles of the sides of boxes, of whose edges the first four run round the floor and the next four round the top.
function sidesOf(edges, count) {
  const sides = [];
  for (let box = edges.length - 72 * count; box < edges.length; box += 72) {
    const corner = (k) => edges.slice(box + 6 * k, box + 6 * k + 3);
    for (const [a, b, c, d] of [[0, 1, 2, 3], [4, 5, 6, 7], ...[0, 1, 2, 3].map((k) => [k, (k + 1) % 4, ((k + 1) % 4) + 4, k + 4])]) {
      for (const k of [a, b, c, a, c, d]) sides.push(...corner(k));
    }
  }
  return new Float32Array(sides);
}

export class Solid {
  // Draws on a canvas; facts are those of the page.
  constructor(canvas, facts) {
    [this.canvas, this.facts, this.cut] = [canvas, facts, null];
    this.reset();
    this.gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true, stencil: true });
    if (this.gl) this.begin();
  }

  // Give the graphics card what stays the same from picture to picture.
  begin() {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "place");
    gl.bindAttribLocation(program, 1, "normal");
    gl.linkProgram(program);
    gl.useProgram(program);
    this.uniform = Object.fromEntries(["view", "eye", "up", "tint", "sky", "opacity", "kind", "cut"].map((name) => [name, gl.getUniformLocation(program, name)]));
    [this.places, this.normals, this.corners, this.ends] = [0, 1, 2, 3].map(() => gl.createBuffer());
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.polygonOffset(1, 8);
  }

  // See it from the front, as it is at first.
  reset() {
    [this.angles, this.near] = [[...FRONT], 1];
  }

  // See it as another one is seen.
  see({ angles, near, cut }) {
    [this.angles, this.near, this.cut] = [[...angles], near, cut && { ...cut }];
  }

  get moved() {
    return this.near !== 1 || this.angles.some((angle, k) => angle !== FRONT[k]);
  }

  turn(azimuth, elevation) {
    this.angles = [this.angles[0] + azimuth, Math.max(-90, Math.min(90, this.angles[1] + elevation))];
  }

  zoom(by) {
    this.near = Math.max(0.3, Math.min(2, this.near * by));
  }

  // Take away a share of the tank from the side that faced the reader when the cut began; 0 for nothing.
  cutBy(share) {
    const { lower, upper, up } = this.facts, [x, y, z] = [0, 1, 2];
    if (!share) return (this.cut = null);
    if (!this.cut) {
      const { ahead } = this.looking(this.angles, 1), axis = [[y, z], [x, z], [x, y]][up].reduce((a, b) => (Math.abs(ahead[b]) > Math.abs(ahead[a]) ? b : a));
      this.cut = { axis, side: ahead[axis] > 0 ? -1 : 1 };
    }
    const { axis, side } = this.cut, [near, far] = side > 0 ? [upper, lower] : [lower, upper];
    this.cut.at = near[axis] + share * (far[axis] - near[axis]);
  }

  // Corners of the cut, as a strip of triangles.
  get section() {
    const { lower, upper } = this.facts, { axis, at } = this.cut;
    return [0, 1, 2, 3].flatMap((corner) => [0, 1, 2].map((k) => (k === axis ? at : [lower, upper][(corner >> (k === (axis + 1) % 3 ? 0 : 1)) & 1][k])));
  }

  // Eye, and the matrix that takes places to the picture, by columns; the tank fills it.
  camera(width, height) {
    const { lower, upper } = this.facts, seen = this.looking(this.angles, 2.2), aspect = width / height;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((number) => lower.map((low, k) => ((number >> k) & 1 ? upper[k] : low) - seen.eye[k]));
    const reach = corners.map((corner) => {
      const [x, y, z] = seen.axes.map((axis) => dot(axis, corner));
      return Math.max(Math.abs(x / z) / aspect, Math.abs(y / z));
    });
    const focal = 0.94 / Math.max(...reach), { eye, axes: [side, top, ahead], above, size } = this.looking(this.angles, 2.2 * this.near);
    const [low, far] = [0.02 * size, 2.2 * this.near * size + 2 * size];
    const rows = [side.map((x) => (x * focal) / aspect), top.map((x) => x * focal), ahead.map((x) => (x * (far + low)) / (far - low)), ahead];
    const view = new Float32Array(16);
    rows.forEach((row, r) => {
      for (let k = 0; k < 3; k++) view[4 * k + r] = row[k];
      view[12 + r] = -dot(row, eye) - (r === 2 ? (2 * far * low) / (far - low) : 0);
    });
    return { eye, view, above };
  }

  // Eye and axes, to the right, upwards and ahead, from angles [degrees], as far away as so many diagonals of the tank.
  looking(angles, away) {
    const { lower, upper, up } = this.facts, [azimuth, elevation] = angles.map((angle) => (angle * Math.PI) / 180);
    const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [right, level, above] = [[y, z, x], [x, [0, 0, -1], y], [x, y, z]][up];
    const mix = (a, share, b, other) => a.map((value, k) => value * share + b[k] * other);
    const side = mix(right, Math.cos(azimuth), level, Math.sin(azimuth)), front = mix(level, Math.cos(azimuth), right, -Math.sin(azimuth));
    const ahead = mix(front, Math.cos(elevation), above, -Math.sin(elevation)), top = mix(front, Math.sin(elevation), above, Math.cos(elevation));
    const size = Math.hypot(...upper.map((value, k) => value - lower[k])), middle = upper.map((value, k) => (value + lower[k]) / 2);
    return { eye: mix(middle, 1, ahead, -away * size), axes: [side, top, ahead], ahead, above, size };
  }

  draw(state, edges, dark) {
    const { gl, canvas, uniform } = this;
    if (!gl || !canvas.clientWidth) return;
    const ratio = window.devicePixelRatio || 1, [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const { eye, view, above } = this.camera(width, height), fluid = this.facts.fluids[0][dark ? "dark" : "light"];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    const { cut } = this, normal = [0, 1, 2].map((axis) => (cut && axis === cut.axis ? cut.side : 0));
    gl.uniform4fv(uniform.cut, [...normal, cut ? cut.side * cut.at : 1]);
    gl.uniformMatrix4fv(uniform.view, false, view);
    gl.uniform3fv(uniform.eye, eye);
    gl.uniform3fv(uniform.up, above);
    gl.uniform3fv(uniform.sky, dark ? [0.35, 0.45, 0.55] : [0.93, 0.97, 1]);
    const load = (target, buffer, data, attribute) => {
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, data, gl.DYNAMIC_DRAW);
      if (attribute === undefined) return;
      gl.enableVertexAttribArray(attribute);
      gl.vertexAttribPointer(attribute, 3, gl.FLOAT, false, 0, 0);
    };
    const lines = (opacity) => {
      gl.disableVertexAttribArray(1);
      load(gl.ARRAY_BUFFER, this.ends, new Float32Array(edges), 0);
      gl.uniform1i(uniform.kind, EDGE);
      gl.uniform1f(uniform.opacity, opacity);
      gl.uniform3fv(uniform.tint, hex(dark ? "#8793a3" : "#3d4653"));
      gl.drawArrays(gl.LINES, 0, edges.length / 3);
    };
    if (this.facts.blocks) {
      const sides = sidesOf(edges, this.facts.blocks);
      gl.disableVertexAttribArray(1);
      gl.depthMask(true);
      gl.enable(gl.POLYGON_OFFSET_FILL); // behind the faces of fluids on them, and their own edges
      load(gl.ARRAY_BUFFER, this.ends, sides, 0);
      gl.uniform1i(uniform.kind, BLOCK);
      gl.uniform3fv(uniform.tint, hex(dark ? "#5a6472" : "#b4bcc6"));
      gl.drawArrays(gl.TRIANGLES, 0, sides.length / 3);
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    gl.depthMask(false);
    lines(0.5);
    load(gl.ARRAY_BUFFER, this.places, state.places, 0);
    load(gl.ARRAY_BUFFER, this.normals, state.normals, 1);
    load(gl.ELEMENT_ARRAY_BUFFER, this.corners, state.corners);
    gl.uniform3fv(uniform.tint, hex(fluid[dark ? 2 : 1]));
    const faces = (opacity) => {
      gl.uniform1f(uniform.opacity, opacity);
      for (const [kind, first, count] of [[FLAT, 0, state.flat], [FREE, state.flat, state.corners.length / 3 - state.flat]]) {
        gl.uniform1i(uniform.kind, kind);
        gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 12 * first);
      }
    };
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.FRONT);
    faces(0.45);
    gl.cullFace(gl.BACK);
    gl.depthMask(true); // the nearest front faces alone, each pixel once
    gl.colorMask(false, false, false, false);
    faces(1);
    gl.colorMask(true, true, true, true);
    faces(0.62);
    gl.disable(gl.CULL_FACE);
    if (cut) this.fillCut(faces, load, hex(fluid[1]));
    lines(0.8);
  }

  // Where a ray meets an odd number of the faces that are left, the cut is through the fluid.
  fillCut(faces, load, tint) {
    const { gl, uniform } = this;
    gl.enable(gl.STENCIL_TEST);
    gl.disable(gl.DEPTH_TEST);
    gl.colorMask(false, false, false, false);
    gl.stencilFunc(gl.ALWAYS, 0, 1);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INVERT);
    faces(1);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.DEPTH_TEST);
    gl.stencilFunc(gl.EQUAL, 1, 1);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.KEEP);
    gl.disableVertexAttribArray(1);
    load(gl.ARRAY_BUFFER, this.ends, new Float32Array(this.section), 0);
    gl.uniform1i(uniform.kind, CUT);
    gl.uniform3fv(uniform.tint, tint);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.disable(gl.STENCIL_TEST);
  }
}

// Let pointers turn and zoom what a canvas shows; `changed` is called after each move, `ignores` says when not to zoom.
export function orbit(canvas, solid, changed, ignores = () => false) {
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault()); // as phones do to pages in the background
  canvas.addEventListener("webglcontextrestored", () => (solid.begin(), changed()));
  const pointers = new Map(), apart = () => Math.hypot(...[0, 1].map((k) => [...pointers.values()].reduce((a, b) => a[k] - b[k])));
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const two = pointers.size === 2, was = two && apart();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (two) solid.zoom(was / Math.max(apart(), 1));
    else solid.turn(-0.4 * (event.clientX - before[0]), 0.4 * (event.clientY - before[1]));
    changed();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    if (ignores()) return;
    event.preventDefault();
    solid.zoom(event.deltaY > 0 ? 1.1 : 1 / 1.1);
    changed();
  }, { passive: false });
}
