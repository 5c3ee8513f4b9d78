// One axis for all panels of a group: drag selects, shift-drag or arrows move, ctrl-wheel or + and - zoom, 0 shows all.
class Axis {
  constructor(spec, place) {
    Object.assign(this, { span: spec.span, unit: spec.unit, marks: spec.marks, place, hover: null, grip: null, asked: false });
    [this.from, this.to] = spec.span;
    this.bar = place.parentElement.querySelector(".bar");
    this.bar.querySelector("button").addEventListener("click", () => this.whole());
    this.panels = spec.panels.map((panel) => new Panel(panel, this, place));
    this.panels.forEach((panel) => this.listen(panel));
    this.redraw();
  }

  redraw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.panels.forEach((panel) => panel.draw());
      const at = this.hover === null ? "" : ` · at ${this.tell(this.hover, 3)}`;
      const shown = this.unit ? `${this.from.toFixed(2)} – ${this.to.toFixed(2)} s` : `poses ${Math.ceil(this.from)} – ${Math.floor(this.to)}`;
      this.bar.querySelector("output").textContent = shown + at;
    });
  }

  /** A time, or the number of a pose where there is no unit. */
  tell(t, digits) { return this.unit ? `${t.toFixed(digits)} ${this.unit}` : `pose ${Math.round(t)}`; }

  look(from, to) {
    const [begin, end] = this.span;
    const width = Math.min(end - begin, Math.max(to - from, (end - begin) * 1e-5));
    this.from = Math.min(Math.max(from, begin), end - width);
    this.to = this.from + width;
    this.redraw();
  }

  whole() { this.look(...this.span); }
  zoom(t, factor) { this.look(t - (t - this.from) * factor, t + (this.to - t) * factor); }
  move(share) { this.look(this.from + (this.to - this.from) * share, this.to + (this.to - this.from) * share); }
  middle() { return this.hover === null ? (this.from + this.to) / 2 : this.hover; }

  listen(panel) {
    const canvas = panel.canvas;
    const under = (event) => panel.time(event.clientX - canvas.getBoundingClientRect().left);
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button > 1) return;
      canvas.setPointerCapture(event.pointerId);
      this.grip = { t: under(event), now: under(event), px: event.clientX, pan: event.shiftKey || event.button === 1 };
    });
    canvas.addEventListener("pointermove", (event) => {
      const grip = this.grip;
      current = this;
      this.hover = Math.min(Math.max(under(event), this.from), this.to);
      if (grip && grip.pan) this.look(this.from + grip.t - under(event), this.to + grip.t - under(event));
      else if (grip) grip.now = this.hover;
      this.redraw();
    });
    canvas.addEventListener("pointerup", (event) => {
      const done = this.grip;
      this.grip = null;
      if (done && !done.pan && Math.abs(event.clientX - done.px) > 4) this.look(Math.min(done.t, done.now), Math.max(done.t, done.now));
      this.redraw();
    });
    canvas.addEventListener("pointercancel", () => { this.grip = null; this.redraw(); });
    canvas.addEventListener("pointerleave", () => { this.hover = null; this.redraw(); });
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("wheel", (event) => {
      if (!(event.ctrlKey || event.metaKey)) return;
      event.preventDefault();
      this.zoom(under(event), Math.exp(Math.sign(event.deltaY) * 0.25));
    }, { passive: false });
  }
}

let current = null; // the axis the pointer was over last: what keys move
const data = JSON.parse(document.getElementById("data").textContent);
const places = document.querySelectorAll(".panels");
const axes = data.map((spec, k) => new Axis(spec, places[k]));
current = axes[0];

const keys = {
  ArrowLeft: () => current.move(-0.2), ArrowRight: () => current.move(0.2),
  "+": () => current.zoom(current.middle(), 0.6), "=": () => current.zoom(current.middle(), 0.6),
  "-": () => current.zoom(current.middle(), 1 / 0.6), 0: () => current.whole(), Escape: () => current.whole(),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || !Object.hasOwn(keys, event.key)) return;
  event.preventDefault();
  keys[event.key]();
});

/** #t=6,8 shows seconds 6 to 8: the tables link to moments. */
function follow() {
  const moment = /^#t=(-?[\d.]+),(-?[\d.]+)$/.exec(location.hash);
  if (!moment) return;
  axes[0].look(Number(moment[1]), Number(moment[2]));
  axes[0].place.scrollIntoView();
}
const redraw = () => axes.forEach((axis) => axis.redraw());
window.addEventListener("hashchange", follow);
window.addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
follow();
