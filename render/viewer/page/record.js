// A stored run in a shared page: its states, its fields, and the stage on which they are seen.

import { Film } from "./film.js";
import { between } from "./motion.js";
import { fluidAt, OutlineReader } from "./outlines.js";
import { Stage } from "./stage.js";

export class Record {
  // The facts of a run, the element with the theme, a box (lower x, y, upper x, y) [m], and what the pointer does.
  constructor(facts, root, [x0, y0, x1, y1], events) {
    [this.facts, this.films, this.film, this.last] = [facts, [], null, facts.times.length - 1];
    [this.shown, this.way] = [facts.best, 0]; // a time, and the share of the way to the next
    this.stage = new Stage(root, 0, "", { lower: [x0, y0], upper: [x1, y1], solids: facts.solids }, facts.fluids, events);
    this.stage.look = { stops: [] };
    this.stage.seen = (smooth, size) => (this.way && this.shown < this.last ? between(this.states[this.shown], this.states[this.shown + 1], this.way, smooth, size) : this.states[this.shown]);
  }

  // Its states and pictures, in bytes from some place on; returns where they end. Again draws anew.
  read(buffer, from, again) {
    const { facts } = this, reader = new OutlineReader(buffer, facts, false, from);
    this.states = facts.times.map(() => reader.state(facts.fluids.length - (facts.behind === null ? 0 : 1)));
    from += facts.outlines;
    this.films = facts.fields.map((field) => {
      const size = field.pictures.reduce((sum, [, , bytes]) => sum + bytes, 0);
      return new Film(field, new Uint8Array(buffer, (from += size) - size, size));
    });
    this.stage.field = (draw, X, Y) => {
      const picture = this.film && this.film.picture(this.shown, this.way, again);
      return picture && { plain: this.film.plain, fill: this.film.pattern(draw, X, Y, picture) };
    };
    return from;
  }

  // Time [s] that is seen.
  get time() {
    const { times } = this.facts, { shown, way } = this;
    return way && shown < this.last ? times[shown] + way * (times[shown + 1] - times[shown]) : times[shown];
  }

  // The last time that is not after another one [s].
  at(time) {
    const after = this.facts.times.findIndex((one) => one > time);
    return after < 0 ? this.last : Math.max(0, after - 1);
  }

  // Go to a time [s], or to the nearer end.
  goTo(time) {
    const { times } = this.facts, after = (this.shown = this.at(time)) + 1;
    this.way = after <= this.last && time > times[this.shown] ? (time - times[this.shown]) / (times[after] - times[this.shown]) : 0;
  }

  draw(smooth, card) {
    const { facts, stage, shown } = this;
    // Beside a picture that is as narrow as a phone there is no room for axes.
    stage.gutter = card ? { left: 0, right: 0, top: 0, bottom: 0 } : stage.canvas.clientWidth < 520 ? { left: 0, right: 0, top: 4, bottom: 4 } : { left: 70, right: 16, top: 12, bottom: 48 };
    stage.outlines = this.states[shown];
    stage.outlines.turns ||= [];
    stage.frame = { behind: facts.behind, smooth, openings: facts.openings[facts.gaps[shown]], marks: facts.marks, still: true, notes: [], time: facts.times[shown] };
    stage.paint();
  }

  // The value of the field at a place [m], null where no fluid is.
  value(at) {
    return this.film && fluidAt(this.states[this.shown], this.facts.behind, at) !== null ? this.film.value(at, this.shown, this.way) : null;
  }
}
