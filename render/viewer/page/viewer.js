// The viewer in an element of a page: it shows what it is sent, and sends what the user does. How messages travel is
// the business of whoever makes it.

import { colourBar, colours, context, fitting, historyPlot, number, unitText } from "./plots.js";
import { OutlineReader } from "./outlines.js";
import { SolidStage } from "./solid_stage.js";
import { Stage } from "./stage.js";
import { Steering } from "./steering.js";

const ZOOM = 1.3, SHIFT = 0.12, TURN = 10, NARROW = 1000;
const CONTROLS = ["aside", ".transport", ".zoom"].flatMap((part) => ["input", "select", "button"].map((kind) => `${part} ${kind}`)).join();
let viewers = 0;

export class Viewer {
  constructor(root, send, keysOf) {
    this.root = root;
    this.id = ++viewers;
    this.transmit = send;
    this.part = (name) => root.querySelector(`[data-name="${name}"]`);
    this.button = (action) => root.querySelector(`[data-do="${action}"]`);
    this.stages = [];
    this.hello = null;
    this.status = null;
    this.asked = 0; // answers that are on their way
    this.found = []; // the values at the place, by pane
    this.place = null; // the point under the pointer, or kept: {pane, at, kept}
    this.histories = new Map();
    this.dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
    try {
      const kept = localStorage.getItem("tipfem-theme");
      if (kept) this.dark = kept === "dark";
    } catch { /* without storage the system's choice holds */ }
    this.followTheme();
    this.steering = new Steering(this);
    this.bind();
    this.setTheme();
    keysOf.addEventListener("keydown", (event) => this.key(event));
    this.letKeysGo();
    document.addEventListener("visibilitychange", () => this.send({ type: "visible", on: !document.hidden }));
    this.watching = new ResizeObserver(() => {
      root.toggleAttribute("data-narrow", root.clientWidth < NARROW);
      this.resize();
    });
    this.watching.observe(this.part("panes"));
    this.watching.observe(root);
  }

  send(message) {
    this.transmit(JSON.stringify(message));
  }

  on(action, handler) {
    this.button(action).addEventListener("click", handler);
  }

  // What comes in

  receive(data) {
    if (typeof data !== "string") return this.receiveBinary(data);
    if (this.ended) return; // the viewer has said goodbye; what it was still about to say counts no more
    const message = JSON.parse(data);
    const take = {
      hello: (m) => this.meet(m), status: (m) => this.update(m), picked: (m) => this.showPicked(m), history: (m) => this.showHistory(m),
      role: (m) => this.setRole(m.steers), series: (m) => this.showSeries(m.plots), error: (m) => this.note(m.text), bye: (m) => this.end(m.text),
    }[message.type];
    if (take) take(message);
  }

  receiveBinary(data) {
    const view = data instanceof DataView ? data : new DataView(data);
    const bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
    const length = view.getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const rest = bytes.subarray(4 + length);
    if (head.type === "file") return this.keep(head, rest);
    this.showFrame(head, rest);
  }

  showFrame(head, bytes) {
    this.send({ type: "ack", frame: head.frame });
    let at = 0;
    const take = (count) => bytes.slice(at, (at += count)).buffer;
    const { low, high, map } = head, look = { low, high, stops: map ? this.hello.maps[map] : ["#000000"] };
    head.panes.forEach((pane, k) => {
      if (this.solid) return this.stages[k]?.show(pane, take(pane.bytes));
      const first = at, cells = pane.cells && take(pane.cells.bytes), lines = pane.lines && take(pane.lines.bytes);
      const outlines = new OutlineReader(take(first + pane.bytes - at), pane, true);
      if (!this.stages[k]) return;
      const fluids = this.hello.panes[k].fluids.length - (pane.behind === null ? 0 : 1);
      this.stages[k].show(pane, outlines.state(fluids), cells, lines, look, head.moves);
    });
    this.steering.drag();
    this.frame = head;
    this.root.dataset.frame = head.frame;
    this.showLegend();
    if (this.place) this.ask(this.place);
    const what = head.field ? this.fieldLabel(head.field) : "Fluids";
    this.stages.forEach((stage, k) => stage.canvas.setAttribute("aria-label",
      `${what} of ${this.hello.panes[k].name} at t = ${number(head.panes[k].time)} s`));
  }

  meet(hello) {
    this.hello = hello;
    this.solid = Boolean(hello.panes[0].solid);
    this.note("");
    document.title = `${hello.panes.map((pane) => pane.name).join(" and ")} – tipfem`;
    this.part("title").textContent = hello.panes[0].title || hello.panes[0].name;
    this.part("subtitle").textContent = hello.panes.map((pane) => pane.name).join("  |  ");
    const events = {
      window: (window, pane) => this.setWindow(window, pane), hover: (at, pane) => this.hover(at, pane), pick: (at, pane) => this.pin(at, pane),
      reset: () => this.setWindow(null), tool: () => (this.steers ? this.root.dataset.tool || "look" : "look"),
      push: (from, to, stage) => this.steering.push(from, to, stage), release: (stage) => this.steering.release(stage),
      drop: (at, stage, quiet) => this.steering.drop(at, stage, quiet), hold: (at, stage, share) => this.steering.hold(at, stage, share), drag: (at) => this.steering.drag(at),
    };
    const several = hello.panes.length > 1;
    this.stages = hello.panes.map(({ name, solid, ...domain }, k) => (solid ? new SolidStage(this.root, k, several ? name : "", solid, (stage) => this.turned(stage))
      : new Stage(this.root, k, several ? name : "", domain, domain.fluids, events)));
    for (const element of this.root.querySelectorAll("[data-of]")) element.hidden = (element.dataset.of === "solid") !== this.solid;
    this.part("cut").value = 0;
    const heads = this.root.querySelectorAll(".values thead th");
    (hello.panes.length > 1 ? hello.panes.map(({ name }) => name) : ["here", "particle"]).forEach((text, k) => (heads[k + 1].textContent = heads[k + 1].title = text));
    this.part("panes").replaceChildren(...this.stages.map((stage) => stage.element));
    this.root.dataset.panes = this.stages.length;
    const { lower: [x0, y0], upper: [x1, y1] } = hello.panes[0];
    this.root.style.setProperty("--shape", this.solid ? 1.5 : (x1 - x0) / (y1 - y0));
    const options = hello.fields.map(({ name, label }) => new Option(label, name));
    this.part("field").replaceChildren(new Option("fluids", ""), ...options);
    this.part("contours").replaceChildren(new Option("none", ""), ...options.map((option) => option.cloneNode(true)));
    this.part("history-field").replaceChildren(...options.map((option) => option.cloneNode(true)));
    this.part("map").replaceChildren(new Option("automatic", ""), ...Object.keys(hello.maps).map((name) => new Option(name, name)));
    const names = hello.panes[0].fluids.map(({ name }) => name);
    this.part("follow").replaceChildren(new Option("nothing", ""), new Option("the front", "front"),
      ...names.map((name) => new Option(`front of ${name}`, `front:${name}`)), ...names.map((name) => new Option(`centre of ${name}`, name)));
    for (const element of this.root.querySelectorAll("[data-when]")) element.hidden = (element.dataset.when === "live") !== hello.live;
    this.steering.meet(hello);
    this.setRole(hello.steers);
    this.showValues();
    if (this.met) this.met();
    this.send({ type: "visible", on: !document.hidden });
    if (hello.steers) {
      this.send({ type: "theme", dark: this.dark });
      this.sized = "";
      requestAnimationFrame(() => this.resize());
    }
  }

  setRole(steers) {
    this.steers = steers;
    for (const control of this.root.querySelectorAll(CONTROLS)) {
      if (!["picture", "share", "keep", "history-field", "in", "out", "reset", "cut"].includes(control.dataset.do || control.dataset.name)) control.disabled = !steers;
    }
    if (steers) {
      this.send({ type: "theme", dark: this.dark });
      this.sized = "";
      this.resize();
    }
    if (this.status) this.showState();
  }

  update(status) {
    this.status = status;
    const part = this.part, { first, last, count, interval } = status.times;
    const scrub = part("scrub");
    Object.assign(scrub, { min: first, max: last });
    if (!this.scrubbing) scrub.value = status.time;
    const [factor, unit] = fitting(this.hello.live ? 1 : last - first || 1, "s");
    const decimals = Math.min(6, Math.max(3, Math.ceil(-Math.log10(interval || 1)) + 1)), fewer = Math.max(0, decimals - Math.log10(factor));
    part("clock").innerHTML = `t = ${(factor * status.time).toFixed(fewer)} ${unit} <span>${this.hello.live ? "" : `${status.index + 1}/${count}`}</span>`;
    scrub.setAttribute("aria-valuetext", `${status.time.toFixed(decimals)} seconds`);
    const play = this.button("play");
    play.setAttribute("aria-label", status.playing ? "Pause" : "Play");
    play.querySelector("use").setAttribute("href", status.playing ? "#tv-pause" : "#tv-play");
    this.showSpeeds(status.speed);
    part("field").value = status.field || "";
    part("range").value = status.range.mode;
    part("map").value = status.map || "";
    part("follow").value = status.follow || "";
    part("contours").value = status.layers.contours || "";
    for (const box of this.root.querySelectorAll("[data-layer]")) {
      const { layer } = box.dataset, fits = layer !== "smooth" || status.plain;
      const own = layer === this.chosen?.name && performance.now() - this.chosen.at < 500; // a status may be from before
      if (!own || !fits) box.checked = fits && Boolean(status.layers[layer]);
      box.disabled = !this.steers || !fits;
    }
    for (const element of this.root.querySelectorAll(".of-field")) element.hidden = !status.field;
    part("given").hidden = !status.field || status.range.mode !== "given";
    this.button("record").setAttribute("aria-pressed", status.recording);
    this.button("record").lastChild.textContent = status.recording ? "End recording" : "Record";
    part("command").value = status.command;
    if (this.steers && status.window === null) this.forgetWindow(status);
    this.steering.update(status.runs[0]);
    this.showState();
    this.plotHistory();
    this.plotSeries();
    if (this.told) this.told(status);
  }

  forgetWindow(status) {
    if (performance.now() - (this.moved || 0) < 500) return;
    for (const stage of this.stages) {
      if (stage.window && status.window === null) {
        stage.window = null;
        stage.paint();
      }
    }
  }

  showState() {
    const state = this.part("state"), runs = this.status.runs.map((run) => run.state);
    const live = runs.some((run) => run === "running");
    state.textContent = (this.steers ? "" : "watching · ") + [...new Set(runs)].join(", ");
    state.toggleAttribute("data-live", live);
  }

  showSpeeds(speed) {
    const select = this.part("speed");
    const known = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];
    const near = known.find((value) => Math.abs(value - speed) < 1e-9 * value);
    const values = near ? known : [...known, speed].sort((a, b) => a - b);
    if (select.dataset.values !== values.join()) {
      select.dataset.values = values.join();
      select.replaceChildren(...values.map((value) => new Option(`${number(value, 2)} × real time`, value)));
    }
    select.value = near || speed;
    this.speeds = values;
  }

  fieldOf(name) {
    return this.hello.fields.find((one) => one.name === name) || { label: name, unit: "" };
  }

  fieldLabel(name) {
    const field = this.fieldOf(name);
    return field.unit ? `${field.label} [${unitText(field.unit)}]` : field.label;
  }

  showLegend() {
    const legend = this.part("legend"), { field, low, high, map } = this.frame;
    const muted = this.frame.panes[0].muted;
    const key = JSON.stringify([field, low, high, map, muted, this.frame.panes[0].smooth, this.dark, legend.clientWidth]);
    if (legend.dataset.key === key) return;
    legend.dataset.key = key;
    const fluids = this.hello.panes[0].fluids;
    const entry = (name, drawn) => {
      const swatch = document.createElement("span");
      swatch.className = "swatch";
      swatch.innerHTML = `<svg viewBox="0 0 18 18" aria-hidden="true">${drawn}</svg>`;
      swatch.append(name);
      return swatch;
    };
    // Over a field: fluids that keep their own colour; and all of three, whose interfaces have stripes of their colours.
    const named = this.solid ? this.hello.panes[0].solid.fluids : fluids.filter(({ name }) => !field || fluids.length > 2 || muted.includes(name));
    const swatches = named.map(({ name, [this.root.dataset.theme]: [, , colour] }) => {
      const swatch = entry(muted.includes(name) ? `${name} (not coloured)` : name, '<rect x="1" y="1" width="16" height="16" rx="3"/>');
      swatch.querySelector("rect").setAttribute("fill", colour);
      return swatch;
    });
    if (!field) {
      const line = '<path class="edge" d="M0 9h18"/>';
      legend.replaceChildren(...swatches, ...(this.frame.panes[0].smooth ? [entry("smoothed outlines", line)] : []));
      return;
    }
    const label = document.createElement("span"), bar = document.createElement("canvas");
    label.textContent = this.fieldLabel(field);
    bar.className = "bar";
    bar.setAttribute("role", "img");
    bar.setAttribute("aria-label", `Colours from ${number(low)} to ${number(high)}`);
    const lines = fluids.length > 1 ? [entry("interface", '<path class="rim" d="M0 9h18"/><path class="line" d="M0 9h18"/>')] : [];
    legend.replaceChildren(label, bar, ...lines, ...swatches);
    colourBar(bar, this.hello.maps[map], low, high, colours(this.root), !this.fieldOf(field).positive || low !== 0);
  }

  // The window

  // The view of a flow in 3-D has changed: that of a run beside it changes, too.
  turned(stage) {
    for (const other of this.stages.filter((one) => one !== stage)) {
      other.solid.see(stage.solid);
      other.paint();
    }
    if (!this.steers || this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      const [azimuth, elevation] = stage.solid.angles;
      this.send({ type: "camera", azimuth, elevation });
    });
  }

  setWindow(window, pane = 0) {
    if (this.solid) return this.stages[0].act("reset");
    const panned = window && this.stages[pane] && this.sameSize(window, this.stages[pane].shown);
    if (this.status && this.status.follow && (panned || window === null)) this.send({ type: "follow", what: null });
    for (const stage of this.stages) {
      stage.window = window;
      stage.paint();
    }
    if (!this.steers) return; // each page has its own view
    this.moved = performance.now();
    this.wanted = window;
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.send({ type: "window", window: this.wanted });
    });
  }

  sameSize(one, other) {
    return Math.abs((one[2] - one[0]) / (other[2] - other[0]) - 1) < 1e-6;
  }

  resize() {
    if (!this.hello || !this.stages.length) return;
    const { width, height } = this.stages[0].box;
    const size = { type: "size", width: Math.min(4096, Math.round(width)), height: Math.min(4096, Math.round(height)) };
    for (const stage of this.stages) stage.paint();
    if (this.frame) this.showLegend();
    this.plotHistory();
    if (this.steers && JSON.stringify(size) !== this.sized) {
      this.sized = JSON.stringify(size);
      this.send(size);
    }
  }

  zoom(factor) {
    if (this.solid) return this.stages[0].act("zoom", factor);
    const stage = this.stages[0], box = stage.box;
    stage.zoom(factor, box.left + box.width / 2, box.top + box.height / 2);
  }

  // Values at a point

  hover(at, pane) {
    if (this.place && this.place.kept) return;
    this.place = at && { pane, at, kept: false };
    if (this.place) this.ask(this.place);
    else this.showValues();
  }

  // Ask for the values at a place in all panes; while an answer is on its way, only the last place is remembered.
  ask(place) {
    if (this.asked) {
      this.next = place;
      return;
    }
    this.asked = this.stages.length;
    for (const { number: pane } of this.stages) this.send({ type: "pick", pane, at: place.at });
    clearTimeout(this.late);
    this.late = setTimeout(() => (this.asked = 0), 2000);
  }

  pin(at, pane) {
    this.place = { pane, at, kept: true };
    this.announce = true;
    this.histories.clear();
    for (const stage of this.stages) {
      stage.marks.point = at;
      stage.paint();
      this.send({ type: "pick", pane: stage.number, at, history: true });
    }
    this.part("history").hidden = false;
    const field = this.part("history-field");
    if (!field.dataset.chosen && this.hello.fields.length) field.value = (this.status && this.status.field) || this.hello.fields[0].name;
    this.plotHistory();
  }

  unpin() {
    this.place = null;
    for (const stage of this.stages) {
      stage.marks.point = null;
      stage.paint();
    }
    this.part("history").hidden = true;
    this.showValues();
  }

  showPicked(message) {
    const place = this.place;
    if (place && (message.at[0] === place.at[0] || !place.kept)) {
      this.found[message.pane] = message;
      if (message.pane === this.stages.length - 1) this.showValues();
      if (this.hello.live && place.kept) this.addToHistory(message);
    }
    if (message.pinned) return;
    if (this.asked) this.asked--;
    if (!this.asked && this.next) {
      const next = this.next;
      this.next = null;
      this.ask(next);
    }
  }

  showValues() {
    if (!this.place) this.found = [];
    const kept = this.place && this.place.kept, [found, other] = this.found, two = this.stages.length > 1;
    const point = ([x, y]) => `x = ${number(x)} m, y = ${number(y)} m`;
    this.part("where").textContent = found ? `${kept ? "at " : ""}${point(found.at)}` : "under the pointer";
    const rows = [];
    const row = (label, ...texts) => {
      const line = document.createElement("tr"), head = document.createElement("th");
      head.scope = "row";
      head.textContent = label;
      line.append(head, ...texts.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
      rows.push(line);
    };
    const fluid = (one) => (one ? one.fluid || "none" : "–");
    const value = (one, name) => (one ? number(one.values[name] ?? null) : "–");
    row("fluid", fluid(found), two ? fluid(other) : found ? `no. ${found.particle.index}${found.particle.wall ? ", wall" : ""}` : "–");
    for (const { name } of this.hello.fields) row(this.fieldLabel(name), value(found, name), two ? value(other, name) : found ? number(found.particle.values[name]) : "–");
    this.part("values").replaceChildren(...rows);
    this.part("hint").hidden = Boolean(kept);
    if (found && kept && this.announce) {
      this.announce = false;
      this.part("said").textContent = `${point(found.at)}, t = ${number(found.time)} s: ${fluid(found)}; ` +
        this.hello.fields.filter(({ name }) => found.values[name] !== undefined).map(({ name }) => `${this.fieldLabel(name)} ${number(found.values[name])}`).join("; ");
    }
  }

  showHistory(message) {
    this.histories.set(message.pane, message);
    this.root.dataset.history = message.done;
    this.plotHistory();
  }

  addToHistory(message) {
    const own = this.histories.get(message.pane) || { times: [], values: {} };
    if (own.times.length && message.time <= own.times[own.times.length - 1]) return;
    own.times.push(message.time);
    for (const { name } of this.hello.fields) (own.values[name] ||= []).push(message.values[name] ?? null);
    this.showHistory({ ...own, pane: message.pane });
  }

  plotHistory() {
    if (this.part("history").hidden || !this.status) return;
    const field = this.part("history-field").value;
    const series = [...this.histories.values()].sort((a, b) => a.pane - b.pane).map(({ times, values }) => ({ times, values: values[field] || [] }));
    const label = this.fieldLabel(field);
    if (series.length) this.timeAt = historyPlot(this.part("plot"), series, this.status.time, label, colours(this.root));
    else historyPlot(this.part("plot"), [{ times: [], values: [] }], this.status.time, label, colours(this.root));
  }

  // What the run has recorded over time

  showSeries(plots) {
    this.plots = plots;
    this.part("over-time").hidden = !plots.length;
    const list = this.part("series");
    if (list.children.length !== plots.length) list.replaceChildren(...plots.map(({ name }) => {
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${name} over time`);
      canvas.addEventListener("click", (event) => this.hello.live || this.send({ type: "show", time: canvas.timeAt(event.offsetX) }));
      return canvas;
    }));
    this.plotSeries();
  }

  plotSeries() {
    if (!this.plots || !this.status) return;
    const shown = JSON.stringify([this.status.time, this.dark, this.root.clientWidth, this.plots.map(({ times }) => times.length)]);
    if (shown === this.plotted) return;
    this.plotted = shown;
    [...this.part("series").children].forEach((canvas, k) => {
      canvas.timeAt = historyPlot(canvas, [this.plots[k]], this.status.time, this.plots[k].name, colours(this.root));
    });
  }

  // The rest

  keep(head, bytes) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([bytes], { type: head.mime }));
    link.download = head.name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    this.root.dataset.kept = `${head.name} ${bytes.length}`;
  }

  note(text, stays = false) {
    const note = this.part("note");
    note.textContent = text;
    note.hidden = !text;
    clearTimeout(this.noted);
    if (text && !stays) this.noted = setTimeout(() => (note.hidden = true), 7000);
  }

  end(text) {
    this.ended = true;
    for (const control of this.root.querySelectorAll(CONTROLS)) control.disabled = true;
    this.note(text.charAt(0).toUpperCase() + text.slice(1) + ".", true);
    this.part("state").textContent = "ended";
    this.part("state").removeAttribute("data-live");
  }

  setTheme() {
    this.root.dataset.theme = this.dark ? "dark" : "light";
    if (this.hello && this.steers) this.send({ type: "theme", dark: this.dark });
    if (this.frame) this.showLegend();
    for (const stage of this.stages) stage.paint();
    if (this.hello) this.plotHistory();
    this.plotSeries();
  }

  bind() {
    const { part } = this;
    const choose = (name, message) => part(name).addEventListener("change", () => this.send(message(part(name).value)));
    this.on("play", () => this.play());
    this.on("back", () => this.send({ type: "step", count: -1 }));
    this.on("next", () => this.send({ type: "step", count: 1 }));
    this.on("in", () => this.zoom(1 / ZOOM));
    this.on("out", () => this.zoom(ZOOM));
    this.on("reset", () => this.setWindow(null));
    this.on("picture", () => this.send({ type: "picture" }));
    for (const action of ["share", "keep"]) this.on(action, () => this.send({ type: "share" }));
    this.on("record", () => this.send({ type: "record", on: !(this.status && this.status.recording) }));
    this.on("help", () => this.showKeys());
    this.on("theme", () => this.toggleTheme());
    choose("field", (value) => ({ type: "field", name: value || null }));
    choose("map", (value) => ({ type: "map", name: value || null }));
    choose("contours", (value) => ({ type: "layers", contours: value || null }));
    choose("follow", (value) => ({ type: "follow", what: value || null }));
    choose("speed", (value) => ({ type: "speed", value: Number(value) }));
    part("range").addEventListener("change", () => this.chooseRange(part("range").value));
    for (const name of ["low", "high"]) part(name).addEventListener("change", () => this.sendRange());
    part("history-field").addEventListener("change", () => {
      part("history-field").dataset.chosen = "yes";
      this.plotHistory();
    });
    for (const box of this.root.querySelectorAll("[data-layer]")) box.addEventListener("change", () => this.layer(box.dataset.layer, box.checked));
    const scrub = part("scrub");
    scrub.addEventListener("input", () => {
      this.scrubbing = true;
      this.send({ type: "show", time: Number(scrub.value) });
    });
    scrub.addEventListener("change", () => (this.scrubbing = false));
    part("plot").addEventListener("click", (event) => {
      if (this.timeAt && !this.hello.live) this.send({ type: "show", time: this.timeAt(event.offsetX) });
    });
    part("cut").addEventListener("input", () => this.stages[0].act("cutBy", Number(part("cut").value)));
    part("command").addEventListener("focus", () => part("command").select());
  }

  play() {
    if (this.hello.live) return this.steering.toggle();
    this.status.playing = !this.status.playing; // a second press means the opposite, whether or not the first was answered
    this.send({ type: "play", on: this.status.playing });
  }

  layer(name, on) {
    this.status.layers[name] = on;
    this.chosen = { name, at: performance.now() };
    this.root.querySelector(`[data-layer="${name}"]`).checked = on;
    this.send({ type: "layers", [name]: name === "tracers" ? (on ? 200 : 0) : on });
  }

  chooseRange(mode) {
    const { low, high } = this.frame;
    if (mode !== "given") return this.send({ type: "range", mode });
    this.part("low").value = Number(low.toPrecision(4));
    this.part("high").value = Number(high.toPrecision(4));
    this.sendRange();
  }

  sendRange() {
    const low = this.part("low").valueAsNumber, high = this.part("high").valueAsNumber;
    if (low < high) this.send({ type: "range", mode: "given", low, high });
    else this.note("The lower end of the colours must be below the upper one.");
  }

  // A notebook has a theme of its own, which may change: Jupyter's or that of VS Code.
  followTheme() {
    const { dataset } = document.body, theirs = () => (dataset.jpThemeLight ? dataset.jpThemeLight === "false" : dataset.vscodeThemeKind ? /dark|black/.test(dataset.vscodeThemeKind) : null);
    this.dark = theirs() ?? this.dark;
    this.themes = new MutationObserver(() => {
      this.dark = theirs() ?? this.dark;
      this.setTheme();
    });
    this.themes.observe(document.body, { attributeFilter: ["data-jp-theme-light", "data-vscode-theme-kind"] });
  }

  toggleTheme() {
    this.dark = !this.dark;
    try {
      localStorage.setItem("tipfem-theme", this.dark ? "dark" : "light");
    } catch { /* it holds for this page then */ }
    this.setTheme();
  }

  // Keys: [key, what it says, what it does]; a key of the simulation alone has a command's name as a fourth.
  keys() {
    const cycle = (name, by) => {
      const select = this.part(name), count = select.options.length;
      select.selectedIndex = (select.selectedIndex + by + count) % count;
      select.dispatchEvent(new Event("change"));
    };
    const layer = (name) => () => this.layer(name, !this.status.layers[name]);
    const speed = (by) => {
      const at = this.speeds.findIndex((value) => value >= this.status.speed * (1 - 1e-9));
      this.send({ type: "speed", value: this.speeds[Math.max(0, Math.min(this.speeds.length - 1, at + by))] });
    };
    const shift = (dx, dy) => () => (this.solid ? this.stages[0].act("turn", TURN * dx, TURN * dy) : this.stages[0].shift(dx * SHIFT, dy * SHIFT));
    const move = this.solid ? "turn" : "move", cut = (more) => () => (this.part("cut").stepUp(more), this.part("cut").dispatchEvent(new Event("input")));
    const middle = () => {
      const [x0, y0, x1, y1] = this.stages[0].shown;
      return this.place && this.place.kept ? this.place.at : [(x0 + x1) / 2, (y0 + y1) / 2];
    };
    const push = (x, y) => () => this.steering.nudge(middle(), [x, y], this.stages[0]);
    return [
      [" ", this.hello.live ? "pause, go on" : "play, pause", () => this.play()],
      ["ArrowRight", "next time", () => this.send({ type: "step", count: 1 }), "times"],
      ["ArrowLeft", "previous time", () => this.send({ type: "step", count: -1 }), "times"],
      ["PageDown", "ten times on", () => this.send({ type: "step", count: 10 }), "times"],
      ["PageUp", "ten times back", () => this.send({ type: "step", count: -10 }), "times"],
      ["Home", "first time", () => this.send({ type: "show", time: this.status.times.first }), "times"],
      ["End", "last time", () => this.send({ type: "show", time: this.status.times.last }), "times"],
      [">", "faster", () => speed(1), "times"],
      ["<", "slower", () => speed(-1), "times"],
      [".", "one step of the simulation", () => this.steering.command("step", { count: 1 }), "step"],
      ["[", "tilt gravity one way", () => this.steering.tilt(-1), "gravity"],
      ["]", "tilt gravity the other way", () => this.steering.tilt(1), "gravity"],
      ["J", "push to the left", push(-1, 0), "poke"],
      ["L", "push to the right", push(1, 0), "poke"],
      ["I", "push up", push(0, 1), "poke"],
      ["K", "push down", push(0, -1), "poke"],
      ["n", "add a drop at the point kept, or in the middle", () => this.steering.drop(middle()), "drop"],
      ["z", "undo the last push, drop or tilt", () => this.steering.command("undo"), "undo"],
      ["R", "start the simulation again", () => this.steering.command("again"), "again"],
      ["X", "stop the simulation", () => this.steering.command("stop"), "stop"],
      ["+", "zoom in", () => this.zoom(1 / ZOOM)],
      ["-", "zoom out", () => this.zoom(ZOOM)],
      ["w", `${move} up`, shift(0, 1)],
      ["a", `${move} left`, shift(-1, 0)],
      ["s", `${move} down`, shift(0, -1)],
      ["d", `${move} right`, shift(1, 0)],
      ["0", "show all", () => this.setWindow(null)],
      ["c", "cut deeper", cut(5), "solid"],
      ["v", "cut less", cut(-5), "solid"],
      ["y", "follow something else", () => cycle("follow", 1), "plane"],
      ["f", "next field", () => cycle("field", 1), "plane"],
      ["F", "previous field", () => cycle("field", -1), "plane"],
      ["u", "range of the colours", () => this.status.field && cycle("range", 1), "plane"],
      ["e", "colour map", () => this.status.field && cycle("map", 1), "plane"],
      ["m", "mesh", layer("mesh"), "plane"],
      ["p", "particles", layer("particles"), "plane"],
      ["v", "arrows", layer("arrows"), "plane"],
      ["l", "streamlines", layer("streamlines"), "plane"],
      ["t", "tracers", layer("tracers"), "plane"],
      ["x", "fill", layer("fill"), "plane"],
      ["o", "smooth outlines of the fluids", () => this.status.plain && layer("smooth")(), "plane"],
      ["b", "colour all fluids", layer("colour_all"), "plane"],
      ["c", "contours of the next field", () => cycle("contours", 1), "plane"],
      ["k", "keep the point in the middle", () => {
        const [x0, y0, x1, y1] = this.stages[0].shown;
        this.pin([(x0 + x1) / 2, (y0 + y1) / 2], 0);
      }, "plane"],
      ["Escape", "let the point go", () => this.unpin(), "plane"],
      ["g", "take a picture", () => this.send({ type: "picture" })],
      ["G", "keep all as one page that plays", () => this.send({ type: "share" })],
      ["r", "record, end recording", () => this.button("record").click()],
      ["h", "light or dark", () => this.toggleTheme()],
      ["?", "these keys", () => this.showKeys()],
    ].filter(([, , , needs]) => !needs || ({ times: !this.hello.live, solid: this.solid, plane: !this.solid }[needs] ?? this.steering.commands.has(needs)));
  }

  key(event) {
    if (!this.hello || event.ctrlKey || event.metaKey || event.altKey || this.part("keys").open) return;
    const target = event.target, typing = target.closest && target.closest("input:not([type=checkbox]):not([type=radio]), select, textarea");
    if (typing || (event.key === " " && target.closest && target.closest("button, input"))) return;
    const found = this.keys().find(([key]) => key === event.key || (key === "+" && event.key === "="));
    if (!found) return;
    event.preventDefault();
    event.stopPropagation();
    found[2]();
  }

  // A control that was reached by the pointer gives the keys back once it has been used; one reached by Tab keeps them.
  letKeysGo() {
    let pointed = null;
    const control = (event) => event.target.closest("select, button, input[type=range], input[type=checkbox], input[type=radio]");
    const free = (event) => {
      const used = control(event);
      if (!used || used !== pointed) return;
      pointed = null;
      used.blur(); // at once: a key may come before a timer does
    };
    this.root.addEventListener("pointerdown", (event) => {
      const label = event.target.closest("label");
      pointed = control(event) || (label && label.control);
    });
    this.root.addEventListener("keydown", (event) => (pointed = event.key === "Tab" ? null : pointed));
    this.root.addEventListener("change", free);
    this.root.addEventListener("click", (event) => control(event)?.matches("select") || free(event));
  }

  showKeys() {
    const names = { " ": "space", ArrowRight: "→", ArrowLeft: "←", PageDown: "page down", PageUp: "page up", Escape: "esc" };
    this.part("key-list").replaceChildren(...this.keys().map(([key, says]) => {
      const line = document.createElement("div"), term = document.createElement("dt"), key_ = document.createElement("kbd");
      key_.textContent = names[key] || (key.length === 1 && key !== key.toLowerCase() ? `shift ${key}` : key);
      term.append(key_);
      line.append(term, Object.assign(document.createElement("dd"), { textContent: says }));
      return line;
    }));
    this.part("keys").showModal();
  }

  close() {
    this.watching.disconnect();
    this.themes.disconnect();
  }
}
