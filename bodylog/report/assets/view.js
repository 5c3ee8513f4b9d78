// One view for all panels: drag selects, shift-drag or arrows move, ctrl-wheel or + and - zoom, 0 shows all.
let asked = false;
const shown = document.getElementById("shown");
const place = document.getElementById("panels");
const panels = data.panels.map((spec) => new Panel(spec, place));

function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    panels.forEach((panel) => panel.draw());
    const at = view.hover === null ? "" : ` · at ${view.hover.toFixed(3)} s`;
    shown.textContent = `${view.from.toFixed(2)} – ${view.to.toFixed(2)} s${at}`;
  });
}

function look(from, to) {
  const width = Math.min(end - begin, Math.max(to - from, (end - begin) * 1e-5));
  view.from = Math.min(Math.max(from, begin), end - width);
  view.to = view.from + width;
  redraw();
}

function zoom(t, factor) { look(t - (t - view.from) * factor, t + (view.to - t) * factor); }
function move(share) { look(view.from + (view.to - view.from) * share, view.to + (view.to - view.from) * share); }

for (const panel of panels) {
  const canvas = panel.canvas;
  const under = (event) => panel.time(event.clientX - canvas.getBoundingClientRect().left);
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    canvas.setPointerCapture(event.pointerId);
    grip = { t: under(event), now: under(event), px: event.clientX, pan: event.shiftKey || event.button === 1 };
  });
  canvas.addEventListener("pointermove", (event) => {
    view.hover = Math.min(Math.max(under(event), view.from), view.to);
    if (grip && grip.pan) look(view.from + grip.t - under(event), view.to + grip.t - under(event));
    else if (grip) grip.now = view.hover;
    redraw();
  });
  canvas.addEventListener("pointerup", (event) => {
    const done = grip;
    grip = null;
    if (done && !done.pan && Math.abs(event.clientX - done.px) > 4) look(Math.min(done.t, done.now), Math.max(done.t, done.now));
    redraw();
  });
  canvas.addEventListener("pointercancel", () => { grip = null; redraw(); });
  canvas.addEventListener("pointerleave", () => { view.hover = null; redraw(); });
  canvas.addEventListener("dblclick", () => look(begin, end));
  canvas.addEventListener("wheel", (event) => {
    if (!(event.ctrlKey || event.metaKey)) return;
    event.preventDefault();
    zoom(under(event), Math.exp(Math.sign(event.deltaY) * 0.25));
  }, { passive: false });
}

const middle = () => (view.hover === null ? (view.from + view.to) / 2 : view.hover);
const keys = {
  ArrowLeft: () => move(-0.2), ArrowRight: () => move(0.2), "+": () => zoom(middle(), 0.6), "=": () => zoom(middle(), 0.6),
  "-": () => zoom(middle(), 1 / 0.6), 0: () => look(begin, end), Escape: () => look(begin, end),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || !Object.hasOwn(keys, event.key)) return;
  event.preventDefault();
  keys[event.key]();
});
document.getElementById("all").addEventListener("click", () => look(begin, end));

/** #t=6,8 shows seconds 6 to 8: the tables link to moments. */
function follow() {
  const moment = /^#t=(-?[\d.]+),(-?[\d.]+)$/.exec(location.hash);
  if (!moment) return;
  look(Number(moment[1]), Number(moment[2]));
  place.scrollIntoView();
}
window.addEventListener("hashchange", follow);
window.addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
redraw();
follow();
