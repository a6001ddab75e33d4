// Words and numbers: mode, faults with cause and remedy, alarms, sources, drives.

import { css, modeColour, ramp } from "./colours.js";

const $ = (id) => document.getElementById(id);
const mm = (x, digits = 1) => (x === null || x === undefined ? "–" : `${(1000 * x).toFixed(digits)} mm`);

/** An element with text, which is never taken for HTML. */
function make(tag, text, name) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (name) element.className = name;
  return element;
}

/** A sentence: it begins with a capital, and what stands between backticks is code. */
function sentence(text, tag = "span") {
  const element = document.createElement(tag);
  const begun = text.charAt(0).toUpperCase() + text.slice(1);
  begun.split("`").forEach((part, i) => element.append(i % 2 ? make("code", part) : part));
  return element;
}

/** Replaces what an element holds, where it is not the same already: what was unfolded or selected stays. */
function fill(parent, key, build) {
  if (parent.dataset.key === key) return;
  parent.dataset.key = key;
  parent.replaceChildren(...build());
}

export class Panels {
  constructor(scene) {
    this.scene = scene;
    $("arm-name").textContent = scene.arm;
    document.title = `${scene.arm} · sinew`;
    this.legend();
    if (!scene.source) $("note").textContent = "Give the daemon's files with --config to see disks and cables.";
    else if (scene.source.includes("built-in")) $("note").textContent = `Disks and cables: ${scene.source.replaceAll("`", "")}`;
  }

  legend() {
    const canvas = $("ramp");
    const c = canvas.getContext("2d");
    for (let x = 0; x < canvas.width; x++) {
      c.fillStyle = css(ramp(x / (canvas.width - 1)));
      c.fillRect(x, 0, 1, canvas.height);
    }
    const cables = this.scene.geometry?.cables ?? [];
    $("legend").hidden = cables.length === 0;
    if (cables.length === 0) return;
    $("ramp-low").textContent = `${+Math.min(...cables.map((k) => k.tension_n[0])).toPrecision(4)} N`;
    $("ramp-high").textContent = `${+Math.max(...cables.map((k) => k.tension_n[1])).toPrecision(4)} N`;
  }

  link(connected, why) {
    const element = $("link");
    element.className = `link ${connected ? "on" : "off"}`;
    element.textContent = connected ? "live" : (why ?? "no connection");
    element.title = why ?? "";
    if (why && why.length > 60) element.textContent = `${why.slice(0, 57)}...`;
  }

  show(frame) {
    const words = this.scene.words;
    const status = frame.status;
    const mode = $("mode");
    mode.textContent = words.modes[frame.mode] ?? `mode ${frame.mode}`;
    mode.style.background = modeColour(frame.mode);
    fill($("limits"), frame.limits.join(), () => frame.limits.map((code) => make("span", words.limits[code] ?? `limit ${code}`)));
    this.facts(frame, status);
    $("tip").textContent = `${frame.tip.map((v) => (1000 * v).toFixed(1).replace(/^-(0\.0)$/, "$1")).join(", ")} mm`;
    const bends = frame.error_m === null && frame.curvature_error_1pm !== null;
    $("error-label").textContent = bends ? "Curvature error" : "Tip error";
    $("error").textContent = bends ? `${frame.curvature_error_1pm.toFixed(4)} 1/m` : mm(frame.error_m, 2);
    $("nearest").textContent = mm(frame.nearest_m);
    this.alarms(frame, status);
    this.sources(frame, status);
    this.drives(status);
  }

  facts(frame, status) {
    const facts = [["time", `${frame.t.toFixed(2)} s`], ["speed", `${+(100 * frame.speed).toFixed(1)} %`]];
    if (status) facts.push(["period", `${+(1000 * status.period_s).toPrecision(4)} ms${status.lockstep ? ", lockstep" : ""}`]);
    facts.push(["planner", `${this.scene.words.planner[frame.planner] ?? "?"}`]);
    const rows = facts.map(([name, value]) => {
      const row = make("div");
      row.append(make("dt", name), make("dd", value));
      return row;
    });
    $("facts").replaceChildren(...rows);
  }

  alarms(frame, status) {
    const words = this.scene.words;
    const about = (code) => words.alarms[code] ?? words.limits[code] ?? `alarm ${code}`;
    let list = frame.alarms.filter(([code]) => code !== frame.fault?.code)
      .map(([code, subject, since]) => ({ code, subject, what: about(code), since }));
    if (status) {
      const known = (a) => status.alarms.filter((s) => s.code === a.code && s.subject === a.subject);
      const seen = new Set();
      list = list.flatMap((a) => {
        const told = known(a).map((s) => ({ ...a, ...s })).filter((s) => !seen.has(s.what));
        told.forEach((s) => seen.add(s.what));
        return told.length || known(a).length ? told : [a];
      });
    }
    // What was so from the start and does not stop the arm: drives that lack something, rights that were not granted.
    const quiet = list.filter((a) => a.code === 506 || a.code === 507);
    const loud = list.filter((a) => !quiet.includes(a));
    const fault = status?.alarms.find((a) => a.about === "fault" && a.code === frame.fault?.code);
    const key = JSON.stringify([frame.fault, fault?.does, loud.map((a) => [a.what, a.does, a.clears, a.subject]), quiet.map((a) => a.what)]);
    fill($("alarms"), key, () => {
      const cards = [];
      if (frame.fault) {
        const since = frame.alarms.find(([code]) => code === frame.fault.code)?.[2];
        cards.push(card("fault", `Fault ${frame.fault.code}: ${frame.fault.what}`, since, fault?.does, fault?.clears ?? frame.fault.clears));
      }
      for (const a of loud) cards.push(card("", `${a.about ? `${a.about}: ` : ""}${a.what}`, a.since, a.does, a.clears));
      if (quiet.length) cards.push(notes(quiet));
      return cards;
    });
  }

  sources(frame, status) {
    const words = this.scene.words;
    const rows = frame.sources.map((s) => {
      const row = make("tr");
      const name = make("td");
      // Fresh and held are well; stale warns; expired and refused hold the arm; absent is nothing.
      name.append(make("i", undefined, `dot ${["", "good", "warn", "bad", "good", "bad"][s.health] ?? ""}`));
      name.append(s.name === "obstacles" ? `obstacles ${s.id}` : s.name);
      const age = s.age_s === null ? "–" : s.age_s < 10 ? `${(1000 * s.age_s).toFixed(0)} ms` : `${s.age_s.toFixed(0)} s`;
      row.append(name, make("td", words.health[s.health] ?? "?"), make("td", age, "number"), make("td", s.accepted, "number"), make("td", s.rejected, "number"));
      const told = s.name === "obstacles" ? status?.obstacles.find((o) => o.id === s.id) : status?.[s.name];
      row.title = Object.entries(told?.rejected ?? {}).map(([cause, count]) => `${count} x ${cause}`).join("\n");
      return row;
    });
    const table = make("table");
    table.append(make("caption", "Sources"));
    const head = make("tr");
    for (const [name, kind] of [["", ""], ["", ""], ["age", "number"], ["taken", "number"], ["refused", "number"]]) head.append(make("th", name, kind));
    table.append(head, ...rows);
    $("sources").replaceChildren(table);
  }

  drives(status) {
    if (!status) return $("drives").replaceChildren();
    const { count, ready, enabled, fault } = status.drives;
    const table = make("table");
    table.append(make("caption", "Drives and buses"));
    const line = (name, value, state) => {
      const row = make("tr");
      const cell = make("td", value);
      if (state) cell.prepend(make("i", undefined, `dot ${state}`));
      row.append(make("th", name), cell);
      table.append(row);
    };
    line("ready", `${ready} of ${count}`, ready === count ? "good" : "warn");
    line("giving torque", `${enabled}`, enabled === count ? "good" : "");
    if (fault) {
      // The first card has it in full.
      line("in fault", fault.split(":")[0], "bad");
      table.lastChild.title = fault;
    }
    for (const bus of status.buses) {
      const trouble = bus.lost + bus.unsent > 0 ? `, ${bus.lost} lost, ${bus.unsent} unsent` : "";
      const well = bus.state === "ErrorActive";
      const told = well ? "" : `${bus.state}, `;
      const state = { BusOff: "bad", Down: "bad" }[bus.state] ?? (well && !trouble ? "good" : "warn");
      line(bus.name, `${told}${(100 * bus.load_measured).toFixed(0)} % of ${(100 * bus.load_limit).toFixed(0)} %${trouble}`, state);
    }
    $("drives").replaceChildren(table);
  }
}

function card(kind, what, since, does, clears) {
  const element = make("div", undefined, `alarm ${kind}`);
  const title = sentence(what, "b");
  if (since !== undefined && since !== null) element.append(make("span", `since ${since.toFixed(2)} s`, "since"));
  element.append(title);
  for (const [name, text] of [["", does], ["To clear: ", clears]]) {
    if (!text) continue;
    const line = make("p", name);
    line.append(sentence(text));
    element.append(line);
  }
  return element;
}

function notes(list) {
  const details = make("details", undefined, "notes");
  const items = make("ul");
  for (const a of list) items.append(sentence(a.does ? `${a.what}: ${a.does}` : a.what, "li"));
  details.append(make("summary", `${list.length} ${list.length === 1 ? "note" : "notes"} on drives and real-time rights`), items);
  return details;
}
