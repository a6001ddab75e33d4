// Plots over the window: the record that is shown is the line across all of them; a click shows the record there.

import uPlot from "./vendor/uplot/dist/uPlot.esm.js";
import { STAGES, segmentColour, styled } from "./colours.js";

const mm = (x) => (x === null || x === undefined ? null : 1000 * x);
const FONT = '11px system-ui, "Segoe UI", Roboto, sans-serif';

/** A line across the plot at a value, dashed, with a word. */
function bound(u, value, colour, word) {
  if (value === null || value === undefined) return;
  const y = Math.round(u.valToPos(value, "y", true));
  const { left, top, width, height } = u.bbox;
  if (y < top - 1 || y > top + height + 1) return;
  const c = u.ctx;
  c.save();
  c.strokeStyle = c.fillStyle = colour;
  c.lineWidth = devicePixelRatio;
  c.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
  c.beginPath();
  c.moveTo(left, y);
  c.lineTo(left + width, y);
  c.stroke();
  c.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  c.textAlign = "right";
  c.textBaseline = y < top + 16 * devicePixelRatio ? "top" : "bottom";
  c.fillText(word, left + width - 4 * devicePixelRatio, y + (c.textBaseline === "top" ? 2 : -2) * devicePixelRatio);
  c.restore();
}

class Plot {
  constructor(parent, name, title, unit, more = "") {
    this.element = document.createElement("div");
    this.element.className = `plot ${more}`;
    this.element.dataset.plot = name;
    this.element.innerHTML = '<h2><span class="title"></span><span class="key"></span><output></output></h2><div class="area"><div></div></div>';
    this.unit = unit;
    this.titled = this.element.querySelector(".title");
    this.key = this.element.querySelector(".key");
    this.value = this.element.querySelector("output");
    this.area = this.element.querySelector(".area > div");
    this.titled.textContent = title;
    parent.append(this.element);
    this.bounds = () => [];
    this.least = 0;
    this.span = [0, 1];
    this.mark = null;
  }

  make(series, options, seek) {
    const axis = { stroke: () => styled("quiet"), font: FONT, grid: { stroke: () => styled("line"), width: 1 }, ticks: { show: false } };
    this.plot = new uPlot(
      {
        width: 300,
        height: 80,
        pxAlign: 0,
        padding: [4, 6, 0, 0],
        legend: { show: false },
        cursor: { drag: { x: false, y: false }, points: { show: false }, y: false, sync: { key: "window", setSeries: false } },
        scales: { x: { time: false, range: () => this.span }, y: { range: (u, low, high) => this.range(low, high) } },
        axes: [
          { ...axis, size: options.times ? 20 : 4, values: options.times ? (u, ticks) => ticks.map((t) => `${+t.toFixed(2)} s`) : () => [] },
          { ...axis, size: 52, space: 26, values: (u, ticks) => ticks.map((v) => `${+v.toPrecision(6)}`) },
        ],
        series: [{}, ...series],
        bands: options.bands,
        hooks: {
          draw: [(u) => {
            for (const [value, name, word] of this.bounds()) bound(u, value, styled(name), word);
            if (this.mark !== null) {
              const x = u.valToPos(this.mark, "x", true);
              u.ctx.fillStyle = styled("accent");
              u.ctx.fillRect(x - devicePixelRatio / 2, u.bbox.top, 1.5 * devicePixelRatio, u.bbox.height);
            }
          }],
        },
      },
      [[], ...series.map(() => [])],
      this.area,
    );
    this.plot.over.addEventListener("click", () => seek(this.plot.posToVal(this.plot.cursor.left, "x")));
    new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = this.area;
      if (width > 60 && height > 30) this.plot.setSize({ width, height });
    }).observe(this.area);
    return this;
  }

  /** From 0, or from the least there is, to the largest, with the bounds in sight that are near. */
  range(low, high) {
    const seen = this.bounds().map(([value]) => value).filter((v) => v !== null && v !== undefined);
    const top = Math.max(high ?? 0, this.least, ...seen);
    const bottom = Math.min(0, low ?? 0);
    return [bottom, top * 1.06 || 1];
  }

  show(data, span, mark, value) {
    this.span = span;
    this.mark = mark;
    this.value.textContent = value;
    this.plot.setData(data);
  }
}

export class Plots {
  constructor(parent, scene, seek) {
    this.scene = scene;
    const line = (colour, more) => ({ stroke: colour, width: 1.4, points: { show: false }, spanGaps: false, ...more });
    this.error = new Plot(parent, "error", "Tip error", "mm").make([line(() => styled("accent"))], {}, seek);
    this.tension = new Plot(parent, "tension", "Tensions", "N", "high");
    this.distance = new Plot(parent, "distance", "Least distance", "mm").make(
      [line(() => styled("quiet"), { width: 1 }), line(() => styled("target"), { fill: () => `color-mix(in srgb, ${styled("target")} 10%, transparent)` })], {}, seek);
    this.distance.key.innerHTML = '<i style="background:var(--quiet)"></i>to what an obstacle is grown to<i style="background:var(--target)"></i>to its surface';
    this.distance.bounds = () => [[mm(scene.geometry?.clearance_m), "bad", "clearance"]];
    const stacked = STAGES.map(([, colour], i) => line(colour, { width: i === STAGES.length - 1 ? 1 : 0.5, fill: i === 0 ? colour : undefined }));
    // Each stage fills down to the one before it.
    const bands = STAGES.slice(1).map(([, colour], i) => ({ series: [i + 2, i + 1], fill: colour }));
    this.stages = new Plot(parent, "stages", "Times of a tick", "ms").make(stacked, { bands }, seek);
    this.stages.key.innerHTML = STAGES.map(([name, colour]) => `<i style="background:${colour}"></i>${name}`).join("");
    this.stages.bounds = () => [[this.period === null ? null : 1000 * this.period, "bad", "period"]];
    this.missed = new Plot(parent, "missed", scene.recording ? "Ticks left out" : "Missed deadlines", "", "low").make(
      [line(() => styled("bad"), { paths: uPlot.paths.stepped({ align: 1 }), fill: () => styled("bad-back") })], { times: true }, seek);
    this.missed.least = 1;
    this.seek = seek;
    this.line = line;
    this.period = scene.geometry?.period_s ?? null;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.all().forEach((p) => p.plot?.redraw()));
  }

  all() {
    return [this.error, this.tension, this.distance, this.stages, this.missed];
  }

  makeTension(count) {
    const cables = this.scene.geometry?.cables;
    const known = cables?.length === count ? cables : null;
    const series = Array.from({ length: count }, (_, c) => this.line(segmentColour(known ? known[c].segment : c), { width: 1 }));
    this.tension.make(series, {}, this.seek);
    if (!known) return;
    const low = Math.min(...known.map((c) => c.tension_n[0]));
    const high = Math.max(...known.map((c) => c.tension_n[1]));
    this.tension.bounds = () => [...(low > 0.02 * high ? [[low, "quiet", "least"]] : []), [high, "bad", "most"]];
    const segments = 1 + Math.max(...known.map((c) => c.segment));
    this.tension.key.innerHTML = "segment" + Array.from({ length: segments },
      (_, s) => `<i style="background:${segmentColour(s)}"></i>${s + 1}`).join("");
  }

  show(frames, shown, seconds, paused) {
    if (!this.tension.plot) this.makeTension(shown.command_n.length);
    const end = frames.at(-1).t;
    const begin = Math.max(frames[0].t, end - seconds);
    const span = [begin, Math.max(end, begin + 2)];
    const used = frames.filter((f) => f.t >= begin - 1);
    const x = used.map((f) => f.t);
    const mark = paused ? shown.t : null;
    const status = shown.status;
    this.period = status?.period_s ?? this.period;

    const bends = shown.error_m === null && shown.curvature_error_1pm !== null;
    this.error.titled.textContent = bends ? "Curvature error" : "Tip error";
    const error = (f) => (bends ? f.curvature_error_1pm : mm(f.error_m));
    this.error.show([x, used.map(error)], span, mark, number(error(shown), bends ? 3 : 2, bends ? "1/m" : "mm"));

    const tensions = shown.command_n.map((_, c) => used.map((f) => f.command_n[c] ?? null));
    const least = Math.min(...shown.command_n);
    const most = Math.max(...shown.command_n);
    this.tension.show([x, ...tensions], span, mark, shown.command_n.length ? `${least.toFixed(1)} to ${most.toFixed(1)} N` : "");

    this.distance.show([x, used.map((f) => mm(f.nearest_grown_m)), used.map((f) => mm(f.nearest_m))], span, mark, number(mm(shown.nearest_m), 1, "mm"));

    let below = used.map(() => 0);
    const stages = STAGES.map(([name]) => (below = below.map((sum, i) => sum + used[i].stages_us[name] / 1000)));
    const lockstep = status?.lockstep ? ", lockstep" : "";
    this.stages.show([x, ...stages], span, mark, `${(shown.stages_us.cycle / 1000).toFixed(2)} ms${lockstep}`);

    const missed = used.map((f) => f.left_out + (f.status?.overran ?? 0));
    const now = shown.left_out + (status?.overran ?? 0);
    const parts = status && now > 0 ? ` (${shown.left_out} left out, ${status.overran} overran)` : "";
    this.missed.show([x, missed], span, mark, `${now}${parts}`);
  }
}

function number(value, digits, unit) {
  return value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`;
}
