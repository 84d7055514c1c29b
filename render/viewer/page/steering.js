// The controls of a simulation that is going on; shown as far as it takes commands.

import { fluidAt, roomAt } from "./outlines.js";
import { number } from "./plots.js";

const TILT = 5; // degrees a key
const ROOM = 1.6; // spacings between a drop and all else
const TOLD = 1800; // [ms] for which the picture says why something was not done
const AIMED = 3000; // [ms] after which what is refused is not what the pointer did
const PULL = 7; // of the spring by which bodies are dragged: its frequency [1/s]

// The middle of a loop, and how far its points are from it.
function extent(points) {
  const count = points.length / 2, centre = [0, 0];
  points.forEach((value, k) => (centre[k % 2] += value / count));
  return { centre, reach: Math.max(...Array.from({ length: count }, (_, k) => Math.hypot(points[2 * k] - centre[0], points[2 * k + 1] - centre[1]))) };
}

// A row with a slider that gives what it is set to.
function slider(name, unit, range, give) {
  const row = document.createElement("label"), input = document.createElement("input"), shown = document.createElement("output");
  const say = () => (shown.textContent = `${number(Number(input.value), 2)} ${unit}`);
  Object.assign(input, { type: "range", ...range });
  input.addEventListener("input", () => {
    give(Number(input.value));
    say();
  });
  say();
  row.append(name, input, shown);
  return row;
}

export class Steering {
  constructor(viewer) {
    this.viewer = viewer;
    this.gravity = [0, -9.81];
    this.full = 9.81; // length of gravity [m/s^2] that the pendulum's bob is drawn for
    this.sent = -Infinity;
    this.commands = new Set();
    const part = viewer.part;
    viewer.on("go", () => this.toggle());
    viewer.on("single", () => this.command("step", { count: 1 }));
    viewer.on("stop", () => this.command("stop"));
    viewer.on("undo", () => this.command("undo"));
    viewer.on("again", () => this.command("again"));
    viewer.on("upright", () => this.tiltTo(-90));
    for (const radio of viewer.root.querySelectorAll('[name="tool"]')) {
      radio.name = `tool-${viewer.id}`;
      radio.addEventListener("change", () => (viewer.root.dataset.tool = radio.value));
      radio.dataset.tool = radio.value;
    }
    for (const name of ["strength", "radius", "drop"]) part(name).addEventListener("input", () => this.say());
    part("viscous").addEventListener("change", () => this.say());
    part("viscosity").addEventListener("input", () => {
      const fluid = part("viscous").value;
      this.viscosities[fluid] = 10 ** Number(part("viscosity").value);
      this.command("viscosity", { fluid, value: this.viscosities[fluid] });
      this.say();
    });
    const bob = part("pendulum");
    const follow = (event) => {
      const area = bob.getBoundingClientRect();
      const x = event.clientX - area.left - area.width / 2, y = event.clientY - area.top - area.height / 2;
      if (Math.hypot(x, y) > 4) this.tiltTo((Math.atan2(-y, x) * 180) / Math.PI);
    };
    bob.addEventListener("pointerdown", (event) => {
      bob.setPointerCapture(event.pointerId);
      follow(event);
    });
    bob.addEventListener("pointermove", (event) => bob.hasPointerCapture(event.pointerId) && follow(event));
    bob.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: -1, ArrowUp: 1, ArrowRight: 1, ArrowDown: -1 }[event.key];
      if (turn) {
        event.preventDefault();
        event.stopPropagation();
        this.tilt(turn);
      }
    });
  }

  get running() {
    return this.state === "running";
  }

  meet(hello) {
    const { viewer } = this, part = viewer.part;
    this.commands = new Set(hello.commands);
    this.floating = this.commands.has("poke") ? hello.floating : [];
    if (this.floating.length) this.commands.add("drag");
    this.limits = hello.limits;
    this.spacing = hello.panes[0].spacing;
    part("steering").hidden = !["gravity", "poke", "drop", "valve", "tension", "wall"].some((name) => this.commands.has(name));
    for (const element of viewer.root.querySelectorAll("[data-needs]")) element.hidden = !this.commands.has(element.dataset.needs);
    part("tools").hidden = !(this.commands.has("poke") || this.commands.has("drop"));
    for (const [action, name] of [["go", "pause"], ["single", "step"], ["stop", "stop"]]) viewer.button(action).hidden = !this.commands.has(name);
    for (const list of ["drop-fluid", "viscous"]) part(list).replaceChildren(...hello.panes[0].fluids.map(({ name }) => new Option(name, name)));
    this.viscosities = Object.fromEntries(hello.panes[0].fluids.map(({ name }, k) => [name, hello.viscosities[k]]));
    if (!viewer.root.dataset.tool && this.commands.has(hello.tool)) viewer.root.querySelector(`[data-tool="${hello.tool}"]`).click();
    part("openings").replaceChildren(...(hello.openings ?? []).map((opening) => this.opening(opening)));
    part("walls").replaceChildren(...(hello.walls ?? []).map((wall) => this.wall(wall)));
    part("tensions").replaceChildren(...(hello.tensions ?? []).map((tension) => this.tension(tension)));
    this.say();
  }

  // The control of a wall that moves: its place, or its speed along itself.
  wall({ name, value, slides }) {
    const most = Math.max(this.limits[slides ? "wall_speed" : "wall_place"], Math.abs(value));
    const range = { min: -most, max: most, step: most / 50, value };
    return slider(`Wall ${name}`, slides ? "m/s" : "m", range, (given) => this.command("wall", { wall: name, value: given }));
  }

  // That of a surface tension, up to twice what it is at the start.
  tension({ between, value }) {
    const most = 2 * value || 0.1, range = { min: 0, max: most, step: most / 50, value };
    return slider(`Tension, ${between.join(" and ")}`, "N/m", range, (given) => this.command("tension", { between, value: given }));
  }

  // The controls of an opening: whether it is open, and what an inlet lets in.
  opening({ name, kind }) {
    const row = document.createElement("label"), valve = document.createElement("input");
    Object.assign(valve, { type: "checkbox", checked: true });
    valve.addEventListener("change", () => this.command("valve", { opening: name, open: valve.checked }));
    row.append(valve, ` ${name} is open`);
    if (kind !== "inlet") return row;
    const both = document.createElement("div"), rate = document.createElement("input"), given = document.createElement("label");
    Object.assign(rate, { type: "number", step: "any", placeholder: "as given" });
    rate.addEventListener("change", () => rate.value !== "" && this.command("discharge", { opening: name, value: Number(rate.value) }));
    given.append("lets in ", rate, " m²/s");
    both.append(row, given);
    return both;
  }

  update(run) {
    this.state = run.state;
    const button = this.viewer.button("go");
    button.querySelector("use").setAttribute("href", this.running ? "#tv-pause" : "#tv-play");
    button.querySelector("span").textContent = this.running ? "Pause" : "Go on";
    const facts = [];
    if (this.running && run.pace) facts.push(`${number(run.pace, 2)} × real time`);
    if (run.step !== undefined) facts.push(`step ${run.step}`);
    if (this.running && run.steps_per_second) facts.push(`${number(run.steps_per_second, 3)} steps/s`);
    if (run.message && this.told !== undefined && run.message !== this.told) this.complain(run.message);
    else if (!run.message && this.told) this.viewer.note("");
    this.told = run.message || "";
    this.viewer.part("progress").textContent = facts.join(" · ");
    if (run.gravity && performance.now() - this.sent > 800) this.drawGravity(run.gravity);
  }

  command(name, values = {}) {
    if (this.commands.has(name)) this.viewer.send({ type: "command", name, ...values });
  }

  toggle() {
    this.command(this.running ? "pause" : "go");
  }

  // What a slider stands for: a share of the largest that the run takes, no less than the smallest.
  value(name) {
    const limit = { strength: "poke_acceleration", radius: "poke_radius", drop: "drop_radius" }[name];
    return Math.max(Number(this.viewer.part(name).value) * this.limits[limit], this.limits[`least_${limit}`] ?? 0);
  }

  say() {
    const part = this.viewer.part;
    part("strength-is").textContent = `${number(this.value("strength"), 3)} m/s²`;
    part("radius-is").textContent = `${number(this.value("radius"), 3)} m`;
    part("drop-is").textContent = `${number(this.value("drop"), 3)} m`;
    if (!this.commands.has("viscosity")) return;
    const viscosity = this.viscosities[part("viscous").value];
    part("viscosity").value = Math.log10(viscosity);
    part("viscosity-is").textContent = `${number(viscosity, 2)} Pa s`;
  }

  // Push from a place to another; the farther, the harder, up to what is set.
  push(from, to, stage) {
    const [x0, , x1] = stage.shown, reach = 0.15 * (x1 - x0);
    const dx = to[0] - from[0], dy = to[1] - from[1], length = Math.hypot(dx, dy);
    const hard = this.value("strength") * Math.min(1, length / reach);
    const along = length > 0 ? [dx / length, dy / length] : [0, 0];
    this.aim(from, stage, "There is nothing to push here.");
    this.command("poke", { at: from, acceleration: along.map((part) => part * hard), radius: this.value("radius") });
    stage.marks.push = { at: from, to, radius: this.value("radius") };
    stage.paint();
  }

  // Take hold of the body that floats at a place, within a share of its radius; returns whether there is one.
  hold(at, stage, share) {
    this.held = null;
    for (const body of this.floating) {
      const { centre, reach } = extent(stage.outlines[stage.outlines.length - 2][body].points);
      const off = [at[0] - centre[0], at[1] - centre[1]];
      if (Math.hypot(...off) < share * reach) this.held = { body, stage, off, reach, to: at, before: null };
    }
    return Boolean(this.held);
  }

  // Draw the body that is held to the pointer, as a damped spring does: by a push about it, which it follows by its mean.
  drag(to = this.held?.to) {
    const { held } = this;
    if (!held) return;
    const { stage, before, off } = held, { time } = stage.frame, { centre } = extent(stage.outlines[stage.outlines.length - 2][held.body].points);
    if (!before || time > before.time) {
      held.speed = centre.map((value, k) => (before ? (value - before.centre[k]) / (time - before.time) : 0));
      held.before = { centre, time };
    }
    held.to = to;
    const goal = [to[0] - off[0], to[1] - off[1]], wanted = centre.map((value, k) => PULL * (PULL * (goal[k] - value) - 1.4 * held.speed[k]));
    const share = Math.min(1, this.limits.poke_acceleration / (Math.hypot(...wanted) || 1));
    this.aim(centre, stage, "");
    this.command("poke", { at: centre, acceleration: wanted.map((value) => share * value), radius: 1.6 * held.reach });
    stage.marks.push = { at: centre, to: goal, radius: held.reach };
    stage.paint();
  }

  release(stage) {
    this.held = null;
    this.command("poke", { at: null });
    stage.marks.push = null;
    stage.paint();
  }

  // A short push from a place by keys.
  nudge(at, along, stage) {
    if (!this.commands.has("poke")) return;
    const [x0, , x1] = stage.shown, reach = 0.15 * (x1 - x0);
    this.push(at, [at[0] + along[0] * reach, at[1] + along[1] * reach], stage);
    clearTimeout(this.nudged);
    this.nudged = setTimeout(() => this.release(stage), 400);
  }

  // Add a drop as large as was chosen, or as there is room for; returns whether there was. Quiet: say nothing if not.
  drop(at, stage = this.viewer.stages[0], quiet = false) {
    const fluid = this.viewer.part("drop-fluid").value, there = fluidAt(stage.outlines, stage.frame.behind, at);
    const radius = Math.min(this.value("drop"), roomAt(stage.outlines, at) - ROOM * this.spacing), now = performance.now();
    if (this.poured && this.poured.frame === stage.frame && now - this.poured.when < 1000) return false; // it is not seen yet
    const why = there !== null && stage.fluids[there].name === fluid ? `This is ${fluid} already.` : radius < this.limits.least_drop_radius ? "There is no room for a drop here." : "";
    if (why) {
      if (!quiet) this.refuse(at, stage, why);
      return false;
    }
    this.poured = { frame: stage.frame, when: now };
    this.aim(at, stage, quiet ? "" : "There is no room for a drop here.");
    this.command("drop", { at, radius, fluid });
    return true;
  }

  // Remember what the pointer did, and what to say should the run refuse it.
  aim(at, stage, why) {
    this.aimed = { at, stage, why, when: performance.now() };
  }

  // A ring around a place, and a sentence why nothing was done there.
  refuse(at, stage, text) {
    stage.marks.refused = { at, text };
    stage.paint();
    this.viewer.part("said").textContent = text;
    clearTimeout(this.saying);
    this.saying = setTimeout(() => {
      stage.marks.refused = null;
      stage.paint();
    }, TOLD);
  }

  // What the run says about a command that it refused.
  complain(text) {
    const { aimed } = this;
    if (aimed && performance.now() - aimed.when < AIMED) return aimed.why && this.refuse(aimed.at, aimed.stage, aimed.why);
    const plain = text.replace(/^\w+: /, "");
    this.viewer.note(`${plain.charAt(0).toUpperCase()}${plain.slice(1)}.`);
  }

  tilt(steps) {
    const [x, y] = this.gravity;
    this.tiltTo((Math.atan2(y, x) * 180) / Math.PI + steps * TILT);
  }

  tiltTo(degrees) {
    const angle = (degrees * Math.PI) / 180, length = Math.hypot(...this.gravity) || this.full;
    const round = (value) => Math.round(value * 1e4) / 1e4;
    this.sent = performance.now();
    this.drawGravity([round(length * Math.cos(angle)), round(length * Math.sin(angle))]);
    this.command("gravity", { value: this.gravity });
  }

  drawGravity(value) {
    this.gravity = value;
    const part = this.viewer.part, bob = part("pendulum"), length = Math.hypot(...value);
    this.full = Math.max(this.full, length);
    const x = (30 * value[0]) / this.full, y = (-30 * value[1]) / this.full;
    bob.querySelector(".rod").setAttribute("x2", x);
    bob.querySelector(".rod").setAttribute("y2", y);
    bob.querySelector(".bob").setAttribute("cx", x);
    bob.querySelector(".bob").setAttribute("cy", y);
    const angle = Math.round((Math.atan2(value[0], -value[1]) * 180) / Math.PI);
    bob.setAttribute("aria-valuenow", angle);
    bob.setAttribute("aria-valuetext", `${number(length, 3)} metres per second squared, ${angle} degrees from straight down`);
    part("gravity-is").textContent = `${number(length, 3)} m/s², ${angle}°`.replace("-", "−");
  }
}
