// The page: records come by server-sent events; what is shown is one of them, the newest or that of the slider.

import { modeColour, styled } from "./colours.js";
import { Panels } from "./panels.js";
import { Playback } from "./playback.js";
import { Plots } from "./plots.js";
import { Window } from "./window.js";
import { World } from "./world.js";

const $ = (id) => document.getElementById(id);
/** Between two drawings of the plots (ms). */
const PLOTS_MS = 100;

const scene = await (await fetch("scene")).json();
const store = new Window();
const panels = new Panels(scene);
const world = new World($("canvas"), $("labels"), scene);
const plots = new Plots($("plots"), scene, (time) => seek(store.at(time)));
let playback = null;
let changed = false;
let plotted = 0;

function seek(index) {
  store.seek(index);
  changed = true;
  if (!playback?.playing) plotted = 0;
}

function pause(on) {
  if (on) store.pause();
  else store.live();
  changed = true;
  plotted = 0;
}

function control() {
  const paused = store.paused && !playback?.playing;
  $("pause").textContent = !paused ? "Pause" : playback ? "Play" : "Live";
  $("pause").setAttribute("aria-pressed", paused);
  const frames = store.shown;
  const slider = $("slider");
  slider.max = Math.max(0, frames.length - 1);
  slider.value = store.paused ? store.index : slider.max;
  const now = store.current;
  const behind = frames.at(-1).t - now.t;
  if (playback) $("when").textContent = `${now.t.toFixed(2)} of ${scene.recording.span_s[1].toFixed(2)} s`;
  else $("when").textContent = paused ? `${now.t.toFixed(2)} s (${behind > 0 ? "−" : ""}${behind.toFixed(2)} s)` : `${now.t.toFixed(2)} s`;
}

/** Modes over the window as colours, faults as ticks: where to look. */
function strip() {
  const canvas = $("strip");
  const frames = store.shown;
  canvas.width = canvas.clientWidth;
  const c = canvas.getContext("2d");
  c.fillStyle = styled("line");
  c.fillRect(0, 0, canvas.width, canvas.height);
  const last = Math.max(1, frames.length - 1);
  for (let from = 0; from < frames.length; ) {
    let to = from;
    while (to + 1 < frames.length && frames[to + 1].mode === frames[from].mode) to++;
    c.fillStyle = modeColour(frames[from].mode);
    const x = (from / last) * canvas.width;
    c.fillRect(x, 0, Math.max(1, ((to + 1) / last) * canvas.width - x), canvas.height);
    from = to + 1;
  }
}

function show(time) {
  requestAnimationFrame(show);
  playback?.advance(time);
  const frame = store.current;
  if (frame && changed) {
    changed = false;
    const frames = store.shown;
    const end = store.paused ? store.index + 1 : frames.length;
    const from = store.at(frame.t - span());
    world.show(frame, frames.slice(from, end));
    panels.show(frame);
    control();
  }
  if (frame && time - plotted > PLOTS_MS && (!store.paused || plotted === 0 || playback?.playing)) {
    plotted = time;
    plots.show(store.shown, frame, span(), store.paused);
    strip();
  }
  world.draw();
}

/** Seconds that the plots show: those of the window, of a recording all that is loaded. */
const span = () => (playback ? Infinity : Number($("span").value));

/** Records of a running daemon. The browser connects anew by itself, and gets the window again. */
function follow() {
  const events = new EventSource("events");
  events.onerror = () => panels.link(false, "sinew view has ended");
  events.addEventListener("link", (event) => {
    const { connected, why } = JSON.parse(event.data);
    panels.link(connected, why);
  });
  events.addEventListener("status", (event) => store.setStatus(JSON.parse(event.data)));
  events.addEventListener("window", (event) => {
    store.reset(JSON.parse(event.data));
    changed = true;
  });
  events.addEventListener("frame", (event) => {
    store.push(JSON.parse(event.data));
    changed ||= !store.paused;
  });
}

$("pause").onclick = () => (playback ? playback.toggle() : pause(!store.paused));
$("slider").oninput = (event) => seek(Number(event.target.value));
$("back").onclick = () => seek((store.paused ? store.index : store.frames.length - 1) - 1);
$("forward").onclick = () => seek((store.paused ? store.index : store.frames.length - 1) + 1);
$("span").onchange = () => {
  if (playback) return playback.choose();
  changed = true;
  plotted = 0;
};
for (const button of $("views").children) button.onclick = () => world.controls && world.look(button.dataset.view);
addEventListener("keydown", (event) => {
  if (event.target.matches?.("select, input, button")) return;
  const act = { " ": $("pause").onclick, ArrowLeft: $("back").onclick, ArrowRight: $("forward").onclick }[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

if (scene.recording) playback = new Playback(scene.recording, store, seek);
else follow();
requestAnimationFrame(show);

/** For tests: what is shown, and where the arm's tip is drawn (m, base frame). */
globalThis.sinew = { store, scene, playback, drawnTip: () => world.arm.tip.toArray() };
