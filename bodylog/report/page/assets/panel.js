"use strict";
// One panel: a canvas that draws its traces over the part of the time axis it shares with its neighbours (see view.js).
const box = { left: 58, right: 16, top: 6, bottom: 20 };
const sheet = getComputedStyle(document.documentElement);
const ink = (name) => sheet.getPropertyValue("--" + name);

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const times = (text, [begin, end]) => Float64Array.from(new Uint32Array(bytes(text)), (k) => begin + ((end - begin) * k) / 4294967295);
const values = (text) => new Float32Array(bytes(text));

/** Index of the first sample at or after t. */
function search(t, x) {
  let low = 0, high = t.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] < x) low = middle + 1; else high = middle;
  }
  return low;
}

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= raw * 0.999);
  const digits = Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)));
  const marks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) marks.push([k * step, (k * step).toFixed(digits)]);
  return marks;
}

function short(x) {
  if (!Number.isFinite(x)) return "–";
  return x !== 0 && (Math.abs(x) < 1e-3 || Math.abs(x) >= 1e5) ? x.toExponential(2) : x.toPrecision(4);
}

class Panel {
  constructor(spec, axis, place) {
    Object.assign(this, spec);
    this.axis = axis;
    for (const trace of this.traces) {
      trace.t = times(trace.t, axis.span);
      trace.y = values(trace.y);
      if (trace.high) trace.high = values(trace.high);
    }
    const element = document.createElement("section");
    element.className = spec.half ? "panel half" : "panel";
    const head = document.createElement("header"), title = document.createElement("b"), key = document.createElement("span");
    title.textContent = spec.title;
    key.className = "key";
    this.labels = this.traces.concat(this.rows).map((item) => this.label(item, key));
    head.append(title, key);
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", spec.title + " over time");
    element.append(head, this.canvas);
    place.append(element);
    this.pen = this.canvas.getContext("2d");
  }

  label(item, key) {
    const entry = document.createElement("span"), swatch = document.createElement("i"), text = document.createElement("span");
    swatch.style.background = `var(--${item.ink})`;
    if (item.kind === "band") swatch.style.opacity = 0.3;
    text.textContent = item.name;
    entry.append(swatch, text);
    key.append(entry);
    return { item, text };
  }

  x(t) { return box.left + ((t - this.axis.from) / (this.axis.to - this.axis.from)) * this.width; }
  y(v) { return box.top + (1 - (v - this.low) / (this.high - this.low)) * this.height; }
  time(px) { return this.axis.from + ((px - box.left) / this.width) * (this.axis.to - this.axis.from); }

  /** First and last sample to draw: what is in view and one neighbour on either side. */
  visible(trace) { return [Math.max(0, search(trace.t, this.axis.from) - 1), Math.min(trace.t.length, search(trace.t, this.axis.to) + 1)]; }

  scale() {
    if (this.limits) return ([this.low, this.high] = this.limits);
    let low = this.floor ?? Infinity, high = this.floor ?? -Infinity;
    for (const trace of this.traces) {
      const [a, b] = this.visible(trace), top = trace.high || trace.y;
      for (let i = a; i < b; i++) { if (trace.y[i] < low) low = trace.y[i]; if (top[i] > high) high = top[i]; }
    }
    if (!(low <= high)) [low, high] = [0, 1];
    const margin = (high - low) * 0.06 || Math.abs(high) * 0.05 || 0.5;
    [this.low, this.high] = [low - margin, high + margin];
  }

  draw() {
    const dense = window.devicePixelRatio || 1, wide = this.canvas.clientWidth, tall = this.canvas.clientHeight;
    this.canvas.width = Math.round(wide * dense);
    this.canvas.height = Math.round(tall * dense);
    [this.width, this.height] = [wide - box.left - box.right, tall - box.top - box.bottom];
    this.canvas.dataset.from = this.axis.from;
    this.canvas.dataset.to = this.axis.to;
    this.pen.setTransform(dense, 0, 0, dense, 0, 0);
    this.pen.font = "11px system-ui, sans-serif";
    this.scale();
    this.grid();
    this.pen.save();
    this.pen.beginPath();
    this.pen.rect(box.left, box.top, this.width, this.height);
    this.pen.clip();
    this.marks();
    this.traces.forEach((trace) => this[trace.kind](trace));
    this.bars();
    this.cursor();
    this.pen.restore();
    this.readout();
  }

  grid() {
    const pen = this.pen, rows = this.rows.map((row, i) => [i + 0.5, row.name]);
    if (this.shade) this.fill(box.left, this.y(this.shade[1]), this.width, this.y(this.shade[0]) - this.y(this.shade[1]), "shade", 1);
    pen.fillStyle = ink("soft");
    pen.strokeStyle = ink("rule");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const [v, text] of rows.length ? rows : ticks(this.low, this.high, 6)) {
      const y = Math.round(this.y(v)) + 0.5;
      pen.fillText(text, box.left - 6, y, box.left - 8);
      if (!rows.length) { pen.moveTo(box.left, y); pen.lineTo(box.left + this.width, y); }
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const [t, text] of ticks(this.axis.from, this.axis.to, this.width / 90)) {
      const x = Math.round(this.x(t)) + 0.5;
      pen.fillText(text, x, box.top + this.height + 5);
      pen.moveTo(x, box.top);
      pen.lineTo(x, box.top + this.height);
    }
    pen.stroke();
  }

  fill(x, y, width, height, name, alpha) {
    this.pen.globalAlpha = alpha;
    this.pen.fillStyle = ink(name);
    this.pen.fillRect(x, y, width, height);
    this.pen.globalAlpha = 1;
  }

  marks() {
    for (const mark of this.axis.marks) {
      const x = this.x(mark.from), width = Math.max(1, this.x(mark.to) - x);
      this.fill(x, box.top, width, this.height, mark.ink, mark.ink === "fault" ? 0.9 : 0.07);
    }
  }

  stroke(trace, dash) {
    this.pen.strokeStyle = ink(trace.ink);
    this.pen.lineWidth = 1.3;
    this.pen.setLineDash(dash);
    this.pen.beginPath();
    const [a, b] = this.visible(trace);
    for (let i = a, up = true; i < b; i++) {
      if (Number.isNaN(trace.y[i])) { up = true; continue; }
      if (up) this.pen.moveTo(this.x(trace.t[i]), this.y(trace.y[i]));
      else this.pen.lineTo(this.x(trace.t[i]), this.y(trace.y[i]));
      up = false;
    }
    this.pen.stroke();
    this.pen.setLineDash([]);
  }

  line(trace) { this.stroke(trace, []); }
  dashes(trace) { this.stroke(trace, [5, 3]); }

  band(trace) {
    const pen = this.pen, [a, b] = this.visible(trace);
    pen.globalAlpha = 0.25;
    pen.fillStyle = ink(trace.ink);
    pen.beginPath();
    for (let i = a; i < b; i++) pen.lineTo(this.x(trace.t[i]), this.y(trace.high[i]));
    for (let i = b - 1; i >= a; i--) pen.lineTo(this.x(trace.t[i]), this.y(trace.y[i]));
    pen.fill();
    pen.globalAlpha = 1;
  }

  /** A bar from y to high at each sample: nothing lies between samples. */
  whiskers(trace) {
    const [a, b] = this.visible(trace);
    for (let i = a; i < b; i++) {
      const top = this.y(trace.high[i]), end = this.y(trace.y[i]);
      if (!Number.isNaN(top + end)) this.fill(this.x(trace.t[i]) - 1.5, top, 3, Math.max(1, end - top), trace.ink, 0.35);
    }
  }

  dots(trace) {
    const [a, b] = this.visible(trace), size = b - a > this.width / 2 ? 2 : 3;
    this.pen.fillStyle = ink(trace.ink);
    for (let i = a; i < b; i++) {
      if (Number.isNaN(trace.y[i])) continue;
      this.pen.fillRect(this.x(trace.t[i]) - size / 2, this.y(trace.y[i]) - size / 2, size, size);
    }
  }

  stems(trace) {
    const [a, b] = this.visible(trace), ground = this.y(0);
    for (let i = a; i < b; i++) {
      const top = this.y(trace.y[i]);
      if (!Number.isNaN(top)) this.fill(this.x(trace.t[i]) - 1.5, Math.min(top, ground), 3, Math.abs(ground - top) + 1, trace.ink, 1);
    }
  }

  bars() {
    this.rows.forEach((row, i) => {
      for (const [from, to] of row.spans) {
        const left = this.x(from), width = Math.max(1.5, this.x(to) - left);
        this.fill(left, this.y(i + 0.85), width, this.y(0) - this.y(0.7), row.ink, 0.9);
      }
    });
  }

  cursor() {
    const { hover, grip } = this.axis;
    if (hover !== null) this.fill(this.x(hover) - 0.5, box.top, 1, this.height, "soft", 0.8);
    if (!grip || grip.pan) return;
    const [a, b] = [this.x(grip.t), this.x(grip.now)];
    this.fill(Math.min(a, b), box.top, Math.abs(b - a), this.height, "c0", 0.18);
  }

  /** The value nearest the cursor beside each name. */
  readout() {
    for (const { item, text } of this.labels) text.textContent = item.name + (this.axis.hover === null || !item.t ? "" : " " + this.at(item));
  }

  at(trace) {
    const now = this.axis.hover;
    let i = Math.min(search(trace.t, now), trace.t.length - 1);
    if (i > 0 && now - trace.t[i - 1] < trace.t[i] - now) i -= 1;
    return trace.high ? `${short(trace.y[i])} … ${short(trace.high[i])}` : short(trace.y[i]);
  }
}
