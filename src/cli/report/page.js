"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const story = data.story, grid = story.grid;
  const byId = (id) => document.getElementById(id);
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const make = (name, text, parent, kind) => {
    const node = document.createElement(name);
    if (text !== undefined && text !== null) node.textContent = text;
    if (kind) node.className = kind;
    if (parent) parent.appendChild(node);
    return node;
  };
  const seconds = (t) => t.toFixed(grid.width_s < 0.01 ? 3 : 2) + " s";

  byId("title").textContent = data.title;
  const began = story.began_utc ? ", began " + story.began_utc : "";
  byId("about").textContent = data.file + began + ", written by " + data.software;
  if (!story.whole) {
    byId("warning").hidden = false;
    byId("warning").textContent = "The file ends in the middle: its writer was killed, its disk was full, or it was cut. "
      + "What follows is up to there.";
  }
  byId("width").textContent = grid.width_s < 1 ? (1e3 * grid.width_s).toPrecision(3) + " ms" : grid.width_s.toPrecision(3) + " s";
  for (const [name, value] of story.statistics) {
    const row = make("tr", null, byId("statistics"));
    make("th", name, row);
    make("td", value, row);
  }
  for (const [name, value] of Object.entries(data.facts)) {
    const row = make("tr", null, byId("facts"));
    make("th", name, row);
    make("td", value, row);
  }
  for (const [name, text] of Object.entries(data.attachments)) {
    const details = make("details", null, byId("attachments"));
    make("summary", name, details);
    make("pre", text, details);
  }
  byId("left_out").textContent = story.events_left_out > 0 ? story.events_left_out + " more events found no room." : "";
  const head = make("tr", null, byId("spans"));
  ["", "times", "together"].forEach((text) => make("th", text, head));
  for (const row of story.rows) {
    const line = make("tr", null, byId("spans"));
    make("td", row.name, line);
    make("td", row.times, line, "number");
    make("td", seconds(row.total_s), line, "number");
  }

  // One range of time for everything.
  const all = [grid.from_s, Math.max(story.to_s, grid.from_s + grid.width_s)];
  let range = all.slice();
  const followers = [];
  let moving = false;
  const show = (from, to) => {
    if (moving) return;
    const least = Math.min(4 * grid.width_s, all[1] - all[0]);
    if (to - from < least) { const middle = (from + to) / 2; from = middle - least / 2; to = middle + least / 2; }
    if (to - from >= all[1] - all[0]) { from = all[0]; to = all[1]; }
    if (from < all[0]) { to += all[0] - from; from = all[0]; }
    if (to > all[1]) { from -= to - all[1]; to = all[1]; }
    range = [from, to];
    moving = true;
    followers.forEach((follow) => follow());
    moving = false;
  };
  const zoom = (at, factor) => show(at + (range[0] - at) * factor, at + (range[1] - at) * factor);

  for (const event of story.events) {
    const row = make("tr", null, byId("events"), "go " + event.severity);
    make("td", seconds(event.at_s), row, "number");
    const text = make("td", event.text, row);
    if (event.remedy) make("div", "To clear it: " + event.remedy, text);
    row.onclick = () => { const half = (range[1] - range[0] < 10 ? range[1] - range[0] : 10) / 2; show(event.at_s - half, event.at_s + half); };
  }
  if (story.events.length === 0) make("td", "None is recorded.", make("tr", null, byId("events")));

  // The time line.
  const MODES = { disarmed: "#8a949e", arming: "#b39ddb", holding: "#e0a100", tracking: "#2e9e5b", homing: "#3b82c4",
    stopping: "#c77d3a", faulted: "#d32f2f" };
  const KINDS = { limit: "#e0a100", source: "#8e44ad", fault: "#d32f2f" };
  const AXIS = 64, LEFT = 210, HIGH = 20;
  const order = ["fault", "source", "limit"];
  const rows = story.rows.slice().sort((a, b) => order.indexOf(a.kind) - order.indexOf(b.kind));
  const canvas = document.querySelector("#timeline canvas"), context = canvas.getContext("2d");
  const place = (t, wide) => LEFT + (t - range[0]) / (range[1] - range[0]) * (wide - LEFT);
  const draw = () => {
    const wide = canvas.clientWidth, high = (rows.length + 1) * HIGH + 22, ratio = window.devicePixelRatio || 1;
    canvas.width = wide * ratio; canvas.height = high * ratio; canvas.style.height = high + "px";
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.font = "12px system-ui, sans-serif";
    context.textBaseline = "middle";
    const bar = (span, line, fill) => {
      const from = Math.max(place(span.from_s, wide), LEFT), to = Math.min(place(span.to_s, wide), wide);
      if (to < LEFT || from > wide) return;
      context.fillStyle = fill;
      context.fillRect(from, line * HIGH + 3, Math.max(to - from, 1.5), HIGH - 6);
    };
    const label = (text, line) => {
      context.fillStyle = colour("--text");
      context.fillText(text.length > 36 ? text.slice(0, 35) + "…" : text, 0, line * HIGH + HIGH / 2, LEFT - 8);
    };
    label("mode", 0);
    for (const mode of story.modes) bar(mode, 0, MODES[mode.name] || "#8a949e");
    rows.forEach((row, index) => {
      label(row.name, index + 1);
      for (const span of row.spans) bar(span, index + 1, KINDS[row.kind]);
    });
    context.strokeStyle = colour("--red");
    for (const event of story.events) {
      if (event.severity !== "error") continue;
      const x = place(event.at_s, wide);
      if (x < LEFT || x > wide) continue;
      context.beginPath(); context.moveTo(x, 0); context.lineTo(x, high - 20); context.stroke();
    }
    context.fillStyle = colour("--soft");
    const step = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120, 300, 600, 1800, 3600, 7200, 18000]
      .find((s) => (range[1] - range[0]) / s <= 8) || 36000;
    for (let t = Math.ceil(range[0] / step) * step; t <= range[1]; t += step) {
      const x = place(t, wide);
      context.fillRect(x, 0, 0.5, high - 20);
      context.fillText(+t.toFixed(3) + " s", Math.min(x + 2, wide - 50), high - 9);
    }
  };
  const timeAt = (event) => {
    const box = canvas.getBoundingClientRect();
    return range[0] + (event.clientX - box.left - LEFT) / (box.width - LEFT) * (range[1] - range[0]);
  };
  canvas.onmousemove = (event) => {
    const box = canvas.getBoundingClientRect(), t = timeAt(event), tip = byId("tip");
    const line = Math.floor((event.clientY - box.top) / HIGH), near = 3 * (range[1] - range[0]) / (box.width - LEFT);
    const within = (span) => t >= span.from_s - near && t <= span.to_s + near;
    let text = null;
    if (line === 0) {
      const mode = story.modes.find((span) => t >= span.from_s && t < span.to_s);
      if (mode) text = mode.name + (mode.why ? ": " + mode.why : "") + ", " + seconds(mode.from_s) + " to " + seconds(mode.to_s);
    } else if (rows[line - 1]) {
      const span = rows[line - 1].spans.find(within);
      if (span) text = rows[line - 1].name + ", " + seconds(span.from_s) + " to " + seconds(span.to_s)
        + (span.times > 1 ? ", " + span.times + " times" : "");
    }
    tip.hidden = text === null;
    tip.textContent = text;
    tip.style.left = Math.min(event.clientX - box.left + 12, box.width - 300) + "px";
    tip.style.top = event.clientY - box.top + 14 + "px";
  };
  canvas.onmouseleave = () => { byId("tip").hidden = true; };
  canvas.ondblclick = () => show(all[0], all[1]);
  canvas.onmousedown = (event) => {
    const begin = event.clientX, from = range.slice(), t = timeAt(event), pan = event.shiftKey;
    const box = canvas.getBoundingClientRect();
    event.preventDefault();
    const move = (next) => {
      if (!pan) return;
      const shift = (begin - next.clientX) / (box.width - LEFT) * (from[1] - from[0]);
      show(from[0] + shift, from[1] + shift);
    };
    const up = (last) => {
      window.removeEventListener("mousemove", move);
      window.removeEventListener("mouseup", up);
      const end = timeAt(last);
      if (!pan && Math.abs(last.clientX - begin) > 5) show(Math.min(t, end), Math.max(t, end));
    };
    window.addEventListener("mousemove", move);
    window.addEventListener("mouseup", up);
  };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(timeAt(event), event.deltaY > 0 ? 1.25 : 0.8);
  }, { passive: false });
  followers.push(draw);

  // The plots.
  const most = Math.max(1, ...story.plots.flatMap((plot) => plot.curves.map((curve) => curve.low.length)));
  const times = Array.from({ length: most }, (_, index) => grid.from_s + (index + 0.5) * grid.width_s);
  const fill = (values) => values.length === most ? values : values.concat(new Array(most - values.length).fill(null));
  const hue = (index, count) => "hsl(" + Math.round((210 + 360 * index / Math.max(count, 3)) % 360) + " 65% 50%)";
  const width = () => Math.min(document.body.clientWidth - 32, 1168);
  const sized = [];
  for (const plot of story.plots) {
    const box = make("div", null, byId("plots"));
    make("h3", plot.title + (plot.unit ? " (" + plot.unit + ")" : ""), box);
    if (plot.note) make("p", plot.note, box, "hint");
    const legend = document.createElement("div");
    legend.className = "legend";
    const series = [{}], columns = [times], bands = [], values = [];
    plot.curves.forEach((curve, index) => {
      const stroke = hue(index, plot.curves.length), from = series.length;
      const flat = curve.low.every((value, at) => value === curve.high[at]);
      columns.push(fill(curve.high));
      series.push({ label: curve.name, stroke, width: 1, points: { show: false } });
      if (!flat) {
        columns.push(fill(curve.low));
        series.push({ label: curve.name + " (least)", stroke, width: 1, points: { show: false } });
        bands.push({ series: [from, from + 1], fill: stroke.replace("hsl(", "hsla(").replace(")", " / 0.25)") });
      }
      const button = make("button", null, legend);
      make("i", null, button).style.background = stroke;
      make("span", curve.name + " ", button);
      values.push([make("b", "", button), from, flat ? from : from + 1]);
      button.onclick = () => {
        const on = button.classList.toggle("off");
        chart.setSeries(from, { show: !on });
        if (!flat) chart.setSeries(from + 1, { show: !on });
      };
    });
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
    const short = (value) => Math.abs(value) >= 1e5 ? value.toExponential(1) : +value.toPrecision(5);
    const chart = new uPlot({
      width: width(), height: 220, legend: { show: false },
      scales: { x: { time: false, range: (u, from, to) => from === null ? all : [from, to] } },
      axes: [Object.assign({ values: (u, ticks) => ticks.map((t) => +t.toFixed(4) + " s") }, axis),
        Object.assign({ size: AXIS, values: (u, ticks) => ticks.map(short) }, axis)],
      // Others follow the pointer, and not what it selects: they would zoom within what was zoomed.
      cursor: { sync: { key: "time", filters: { pub: (type) => type !== "mousedown" && type !== "mouseup" } }, drag: { x: true, y: false, setScale: false }, points: { show: false },
        bind: { mousedown: (u, target, handler) => (event) => {
          if (!event.shiftKey) return handler(event);
          event.preventDefault();
          const begin = event.clientX, from = range.slice(), wide = u.over.clientWidth;
          const move = (next) => { const shift = (begin - next.clientX) / wide * (from[1] - from[0]); show(from[0] + shift, from[1] + shift); };
          const up = () => { window.removeEventListener("mousemove", move); window.removeEventListener("mouseup", up); };
          window.addEventListener("mousemove", move);
          window.addEventListener("mouseup", up);
          return null;
        }, dblclick: () => () => { show(all[0], all[1]); return null; } } },
      series, bands,
      hooks: {
        setSelect: [(u) => {
          const { left, width: wide } = u.select;
          const at = (place) => range[0] + place / u.over.clientWidth * (range[1] - range[0]);
          if (wide > 4) show(at(left), at(left + wide));
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
        setCursor: [(u) => {
          const at = u.cursor.idx;
          for (const [node, high, low] of values) {
            const top = at === null || at === undefined ? null : u.data[high][at], bottom = top === null ? null : u.data[low][at];
            node.textContent = top === null || top === undefined ? "" : bottom === top ? short(top) : short(bottom) + " … " + short(top);
          }
        }],
      },
    }, columns, box);
    box.appendChild(legend);
    chart.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = chart.over.getBoundingClientRect();
      zoom(range[0] + (event.clientX - box.left) / box.width * (range[1] - range[0]), event.deltaY > 0 ? 1.25 : 0.8);
    }, { passive: false });
    chart.setScale("x", { min: all[0], max: all[1] });
    followers.push(() => chart.setScale("x", { min: range[0], max: range[1] }));
    sized.push(chart);
  }
  const resize = () => { draw(); sized.forEach((chart) => chart.setSize({ width: width(), height: 220 })); };
  window.addEventListener("resize", resize);
  draw();
  window.sinewReport = { story, show, range: () => range };
})();
