// Lines over the fluids, as the viewer packs them: particles, the mesh, contours, streamlines, arrows and paths of tracers.

const WIDTH = { mesh: 0.7, contours: 1.35, streamlines: 1.2, arrows: 1.5 }; // [px]
const HEADS = 135, TAIL = [0.7, 2.2], TRACER = 2.4; // heads along a streamline, tails of tracers from their old ends [px]

// Draw the sorts of lines of a frame: head tells of them, and their points are in the bytes.
export function drawLines(pen, X, Y, { origin, sorts }, bytes, spacing) {
  const all = new Float32Array(bytes);
  let at = 0;
  for (const { kind, line, rim, count, each, points } of sorts) {
    const lengths = points || Array(count).fill(each);
    const paths = lengths.map((length) => {
      const path = new Float32Array(2 * length);
      for (let k = 0; k < path.length; k += 2) [path[k], path[k + 1]] = [X(origin[0] + all[at++]), Y(origin[1] + all[at++])];
      return path;
    });
    if (kind === "particles") drawDots(pen, paths, line, Math.min(Math.max(0.27 * (X(spacing) - X(0)), 0.8), 5.4));
    else if (kind === "tracers") drawTails(pen, paths, line, rim);
    else if (kind === "arrows") drawArrows(pen, paths, line, rim);
    else {
      if (kind !== "mesh") stroke(pen, paths, rim, WIDTH[kind] + 1.3);
      stroke(pen, paths, line, WIDTH[kind]);
      if (kind === "streamlines") for (const heads of [headsOn(paths)]) for (const [colour, more] of [[rim, 0.6], [line, 0]]) drawHeads(pen, heads, colour, more);
    }
  }
}

function stroke(pen, paths, colour, width) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineCap = "round";
  pen.beginPath();
  for (const path of paths) {
    pen.moveTo(path[0], path[1]);
    for (let k = 2; k < path.length; k += 2) pen.lineTo(path[k], path[k + 1]);
  }
  pen.stroke();
  pen.lineCap = "butt";
}

function drawDots(pen, paths, colour, radius) {
  pen.fillStyle = colour;
  pen.beginPath();
  for (const [x, y] of paths) {
    if (radius < 1.3) pen.rect(x - radius, y - radius, 2 * radius, 2 * radius);
    else {
      pen.moveTo(x + radius, y);
      pen.arc(x, y, radius, 0, 7);
    }
  }
  pen.fill();
}

// Tips, directions and lengths of heads: [x, y, dx, dy, length].
function headsOn(paths) {
  return paths.flatMap((path) => {
    const last = path.length / 2 - 1, step = Math.hypot(path[2] - path[0], path[3] - path[1]) || 1;
    const count = Math.max(1, Math.round((last * step) / HEADS));
    return Array.from({ length: count }, (_, n) => {
      const k = 2 * Math.min(last, Math.max(1, Math.round(((n + 0.55) / count) * last)));
      return [path[k], path[k + 1], path[k] - path[k - 2], path[k + 1] - path[k - 1], 9];
    });
  });
}

function drawHeads(pen, heads, colour, rim) {
  pen.fillStyle = pen.strokeStyle = colour;
  pen.lineWidth = 2 * rim;
  pen.beginPath();
  for (const [x, y, dx, dy, length] of heads) {
    const size = Math.hypot(dx, dy) || 1, u = (length * dx) / size, v = (length * dy) / size;
    pen.moveTo(x, y);
    pen.lineTo(x - u - 0.4 * v, y - v + 0.4 * u);
    pen.lineTo(x - 0.72 * u, y - 0.72 * v);
    pen.lineTo(x - u + 0.4 * v, y - v - 0.4 * u);
    pen.closePath();
  }
  if (rim) pen.stroke();
  pen.fill();
}

function drawArrows(pen, paths, line, rim) {
  const heads = paths.map(([x, y, tx, ty]) => [tx, ty, tx - x, ty - y, Math.min(8, 0.6 * Math.hypot(tx - x, ty - y))]);
  const shafts = heads.map(([x, y, dx, dy, length]) => {
    const short = (0.7 * length) / (Math.hypot(dx, dy) || 1); // a shaft ends inside its head
    return [x - dx, y - dy, x - short * dx, y - short * dy];
  });
  for (const [colour, more] of [[rim, 0.7], [line, 0]]) {
    stroke(pen, shafts, colour, WIDTH.arrows + 2 * more);
    drawHeads(pen, heads, colour, more);
  }
}

// Tails that become thinner and paler with age, and a dot at the place of each tracer.
function drawTails(pen, paths, line, rim) {
  const steps = paths.length ? paths[0].length / 2 - 1 : 0;
  for (let k = 0; k < steps; k++) {
    const young = (k + 1) / steps;
    pen.globalAlpha = 0.4 + 0.6 * young;
    stroke(pen, paths.map((path) => path.subarray(2 * k, 2 * k + 4)), line, TAIL[0] + young * (TAIL[1] - TAIL[0]));
  }
  pen.globalAlpha = 1;
  const ends = paths.map((path) => path.subarray(-2));
  drawDots(pen, ends, rim, TRACER + 0.8);
  drawDots(pen, ends, line, TRACER);
}
