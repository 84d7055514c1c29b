// A field at all times: small grey pictures, from the lowest value of their time to its highest, coloured here.

import { mixed } from "./plots.js";

const AHEAD = 3; // pictures that are read before they are seen
const APART = 12; // times between two pictures from which those between are blended

export class Film {
  // A field as the page's facts have it, and the bytes of its pictures.
  constructor(facts, bytes) {
    Object.assign(this, facts);
    let from = 0;
    this.parts = facts.pictures.map(([low, high, size]) => ({ low, step: (high - low) / 255, bytes: bytes.subarray(from, (from += size)) }));
    this.canvas = document.createElement("canvas");
    const last = this.stops.length - 1, words = new Uint32Array(256).map((_, k) => {
      const at = Math.min((k / 255) * last, last - 1e-9), place = Math.floor(at), colour = mixed(this.stops[place], this.stops[place + 1], at - place);
      return 0xff000000 | (parseInt(colour.slice(5), 16) << 16) | (parseInt(colour.slice(3, 5), 16) << 8) | parseInt(colour.slice(1, 3), 16);
    });
    this.colours = words;
  }

  async read(k) {
    const part = this.parts[k];
    if (!part || !part.bytes.length) return;
    await (part.coming ||= createImageBitmap(new Blob([part.bytes], { type: "image/webp" })).then((image) => {
      const pen = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height }).getContext("2d", { willReadFrequently: true });
      pen.drawImage(image, 0, 0);
      const { data } = pen.getImageData(0, 0, image.width, image.height);
      [part.wide, part.tall, part.grey] = [image.width, image.height, new Uint8Array(data.length / 4)];
      for (let n = 0; n < part.grey.length; n++) part.grey[n] = data[4 * n];
    }));
  }

  // The pictures at or around a share of the way from a time to the next, and the way between them; null until they are
  // read, after which `again` is called, and where there are none.
  between(k, share, again) {
    let one = k, other = share ? k + 1 : k;
    while (one >= 0 && !this.parts[one].bytes.length) one--;
    while (other < this.parts.length && !this.parts[other].bytes.length) other++;
    if (one < 0 || other === this.parts.length || other - one > APART) return null;
    const ends = [this.parts[one], this.parts[other]];
    for (let next = one; next <= other + AHEAD; next++) this.read(next % this.parts.length); // after the last comes the first
    if (ends.every((part) => part.grey)) return [...ends, other > one ? (k + share - one) / (other - one) : 0];
    Promise.all([this.read(one), this.read(other)]).then(again);
    return null;
  }

  // The coloured picture at a share of the way from a time to the next; while it is read one of about that time, null for none.
  picture(k, share, again) {
    const ends = this.between(k, share, again);
    if (!ends) return this.parts[k].bytes.length && Math.abs(k - this.seen) <= APART ? this.canvas : null;
    this.seen = k;
    const [one, other, way] = ends, canvas = this.canvas, pen = canvas.getContext("2d");
    if (!this.image || canvas.width !== one.wide || canvas.height !== one.tall) {
      [canvas.width, canvas.height] = [one.wide, one.tall];
      this.image = pen.createImageData(one.wide, one.tall);
    }
    const out = new Uint32Array(this.image.data.buffer), scale = 255 / (this.high - this.low), { grey: a } = one, { grey: b } = other, { colours } = this;
    const first = (1 - way) * one.step * scale, second = way * other.step * scale, low = ((1 - way) * one.low + way * other.low - this.low) * scale + 0.5;
    for (let n = 0; n < out.length; n++) out[n] = colours[Math.max(0, Math.min(255, low + first * a[n] + second * b[n])) | 0];
    pen.putImageData(this.image, 0, 0);
    return canvas;
  }

  // What fluids are filled with, on a canvas whose X and Y take metres to pixels.
  pattern(draw, X, Y, canvas) {
    const [x0, y0, x1, y1] = this.box, pattern = draw.createPattern(canvas, "no-repeat");
    pattern.setTransform(new DOMMatrix([(X(x1) - X(x0)) / canvas.width, 0, 0, (Y(y0) - Y(y1)) / canvas.height, X(x0), Y(y1)]));
    return pattern;
  }

  // The value at a place [m], or null where it is not known yet.
  value([x, y], k, share) {
    const ends = this.between(k, share, () => {}), [x0, y0, x1, y1] = this.box;
    if (!ends) return null;
    const [from, to] = ends.slice(0, 2).map(({ low, step, grey, wide, tall }) => {
      const column = Math.floor(((x - x0) / (x1 - x0)) * wide), row = Math.floor(((y1 - y) / (y1 - y0)) * tall);
      return low + step * grey[Math.max(0, Math.min(tall - 1, row)) * wide + Math.max(0, Math.min(wide - 1, column))];
    });
    return from + ends[2] * (to - from);
  }
}
