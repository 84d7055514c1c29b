// Numbers, ticks, axes, colour bars and the plot of a history: what is drawn around the pictures.

export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-4) {
    const [mantissa, power] = value.toExponential(digits - 1).split("e");
    const raised = [...String(Number(power))].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
    return `${mantissa.replace("-", "−")}·10${raised}`;
  }
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}

export function unitText(unit) {
  return unit.replace("^2", "²").replace("^3", "³");
}

export function ticks(low, high, most) {
  const rough = (high - low) / Math.max(most - 1, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough * (1 - 1e-9));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const values = [];
  for (let n = Math.ceil(low / step - 1e-6); n * step <= high + 1e-6 * step; n++) values.push(n * step);
  const large = Math.max(...values.map(Math.abs), 0);
  const write = (v) => (large >= 1e6 || (large > 0 && large < 1e-3) ? number(Math.abs(v) < 1e-9 * large ? 0 : v, 3)
    : (Math.abs(v) < step / 2 ? 0 : v).toFixed(decimals).replace("-", "−"));
  return values.map((value) => ({ value, label: write(value) }));
}

// The factor and the name of a unit in which lengths or times of some size are easy to read: 24 mm rather than 0.024 m.
export function fitting(size, unit) {
  return size >= 0.1 ? [1, unit] : size >= 1e-4 ? [1e3, `m${unit}`] : [1e6, `µ${unit}`];
}

// A colour between two, "#rrggbb".
export function mixed(one, other, share) {
  const part = (at) => Math.round((1 - share) * parseInt(one.slice(at, at + 2), 16) + share * parseInt(other.slice(at, at + 2), 16));
  return `#${[1, 3, 5].map((at) => part(at).toString(16).padStart(2, "0")).join("")}`;
}

// A canvas whose units are CSS pixels, cleared.
export function context(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const draw = canvas.getContext("2d");
  draw.setTransform(ratio, 0, 0, ratio, 0, 0);
  draw.clearRect(0, 0, width, height);
  draw.textBaseline = "middle";
  return { draw, width, height };
}

export function colours(root) {
  const style = getComputedStyle(root);
  const named = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: named("text"), subtle: named("subtle"), line: named("line"), accent: named("accent"), mark: named("mark"),
    stage: named("stage"), wall: named("wall"), body: named("body"), edge: named("edge"), font: style.fontFamily };
}

// Ticks and labels left of what is seen of a domain, its lower and upper corner, and below it; map takes metres to CSS pixels.
export function axes(draw, box, shown, map, paint, notes, domain) {
  const [factor, unit] = fitting(Math.max(shown[2] - shown[0], shown[3] - shown[1]), "m"), off = 8;
  const low = map(domain.lower), high = map(domain.upper), right = Math.min(box.left + box.width, high[0] + off), top = Math.max(box.top, high[1] - off);
  const left = Math.max(box.left, low[0] - off), bottom = Math.min(box.top + box.height, low[1] + off);
  const along = (axis, most) => {
    const from = Math.max(shown[axis], domain.lower[axis]), to = Math.min(shown[axis + 2], domain.upper[axis]);
    return ticks(factor * from, factor * to, most).map(({ value, label }) => ({ value: value / factor, label }));
  };
  draw.fillStyle = draw.strokeStyle = paint.subtle;
  draw.lineWidth = 1;
  draw.font = `12px ${paint.font}`;
  draw.textAlign = "center";
  for (const { value, label } of along(0, (right - left) / 80 + 1)) {
    const x = Math.round(map([value, 0])[0]) + 0.5;
    line(draw, x, bottom + 1, x, bottom + 6);
    draw.fillText(label, x, bottom + 15);
  }
  const room = (right - left) / 2 - draw.measureText(notes).width - 30;
  draw.fillText(`x [${unit}]`, room > 0 ? (left + right) / 2 : left + 20, bottom + 32);
  draw.textAlign = "right";
  let widest = 0;
  for (const { value, label } of along(1, (bottom - top) / 56 + 1)) {
    widest = Math.max(widest, draw.measureText(label).width);
    const y = Math.round(map([0, value])[1]) + 0.5;
    line(draw, left - 6, y, left - 1, y);
    draw.fillText(label, left - 10, y);
  }
  if (room > 0) draw.fillText(notes, right, bottom + 32);
  draw.save();
  draw.translate(Math.max(8, left - widest - 22), (top + bottom) / 2);
  draw.rotate(-Math.PI / 2);
  draw.textAlign = "center";
  draw.fillText(`y [${unit}]`, 0, 0);
  draw.restore();
}

function line(draw, x0, y0, x1, y1) {
  draw.beginPath();
  draw.moveTo(x0, y0);
  draw.lineTo(x1, y1);
  draw.stroke();
}

// A level colour bar with its ticks; stops are colours at equal steps; below: whether values may lie below it.
export function colourBar(canvas, stops, low, high, paint, below = true) {
  const { draw, width } = context(canvas);
  const left = 14, right = width - 26, tip = 7, thick = 13;
  const gradient = draw.createLinearGradient(left, 0, right, 0);
  stops.forEach((stop, k) => gradient.addColorStop(k / (stops.length - 1), stop));
  draw.fillStyle = gradient;
  draw.beginPath();
  draw.moveTo(left - (below ? tip : 0), 2 + thick / 2);
  for (const [x, y] of [[left, 2], [right, 2], [right + tip, 2 + thick / 2], [right, 2 + thick], [left, 2 + thick]]) draw.lineTo(x, y);
  draw.fill();
  draw.font = `12px ${paint.font}`;
  draw.textAlign = "center";
  draw.fillStyle = paint.text;
  draw.strokeStyle = paint.subtle;
  for (const { value, label } of ticks(low, high, Math.max(3, width / 70))) { // with both ends of the colours on a phone
    const x = Math.round(left + ((value - low) / (high - low)) * (right - left)) + 0.5;
    line(draw, x, 2 + thick, x, 7 + thick);
    draw.fillText(label, x, 15 + thick);
  }
}

// Level lines and labels of values beside a plot; returns the function from a value to its height.
export function levels(draw, box, values, paint) {
  let low = Math.min(...values), high = Math.max(...values);
  const room = 0.06 * (high - low) || Math.abs(high) * 0.05 || 1;
  low -= room;
  high += room;
  const y = (v) => box.top + box.height - ((v - low) / (high - low)) * box.height;
  draw.lineWidth = 1;
  draw.textAlign = "right";
  for (const { value, label } of ticks(low, high, 4)) {
    draw.strokeStyle = paint.line;
    line(draw, box.left, Math.round(y(value)) + 0.5, box.left + box.width, Math.round(y(value)) + 0.5);
    draw.fillText(label, box.left - 5, y(value));
  }
  return y;
}

// Values over time, of one or more series, with a mark at the present time; returns the time at a CSS pixel.
export function historyPlot(canvas, series, now, label, paint) {
  const { draw, width, height } = context(canvas);
  const finite = series.flatMap((one) => one.values.filter((v) => v !== null));
  const box = { left: 48, top: 20, width: width - 62, height: height - 50 };
  const times = series.flatMap((one) => one.times);
  const first = Math.min(...times), last = Math.max(...times, first + 1e-12); // infinite until there is a time
  const at = (x) => first + ((x - box.left) / box.width) * (last - first);
  draw.font = `11px ${paint.font}`;
  draw.fillStyle = paint.subtle;
  draw.textAlign = "left";
  draw.fillText(label, 2, 8);
  if (!finite.length || times.length < 2) {
    draw.fillText(times.length < 2 ? "…" : "no fluid is at this point", box.left, box.top + box.height / 2);
    return at;
  }
  const x = (t) => box.left + ((t - first) / (last - first)) * box.width;
  const y = levels(draw, box, finite, paint);
  const [factor, unit] = fitting(last - first, "s");
  for (const { value, label: text } of ticks(factor * first, factor * last, box.width / 55)) {
    const half = draw.measureText(text).width / 2; // within the canvas to its last letter
    draw.fillText(text, Math.min(x(value / factor) + half, width), box.top + box.height + 10);
  }
  draw.fillText(`t [${unit}]`, box.left + box.width, box.top + box.height + 22);
  series.forEach((one, k) => {
    draw.strokeStyle = one.colour || (k && !series[0].colour ? paint.mark : paint.accent);
    draw.lineWidth = 1.6;
    draw.beginPath();
    let drawing = false;
    one.values.forEach((value, n) => {
      if (value === null) drawing = false;
      else if (drawing) draw.lineTo(x(one.times[n]), y(value));
      else {
        draw.moveTo(x(one.times[n]), y(value));
        drawing = true;
      }
    });
    draw.stroke();
  });
  draw.strokeStyle = paint.mark;
  draw.lineWidth = 1;
  const slack = 1e-6 * (last - first);
  if (now >= first - slack && now <= last + slack) line(draw, x(now), box.top - 4, x(now), box.top + box.height);
  return at;
}
