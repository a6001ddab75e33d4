// What a user of the page relies on: the arm is where the daemon says, a fault is told, a pause holds, a daemon may go.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { request } from "node:http";
import { join } from "node:path";
import { Bench, ask, browser, newest, open, picture, plant, sinew, sleep, status, text, until } from "./support.mjs";

let chromium;
before(async () => (chromium = await browser()));
after(() => chromium.close());

/** A record of the page at a tick, between the two around it. */
function between(page, tick) {
  return page.evaluate((wanted) => {
    const frames = globalThis.sinew.store.frames;
    const i = frames.findIndex((f) => f.tick >= wanted);
    if (i < 0) return null;
    const [a, b] = [frames[Math.max(0, i - 1)], frames[i]];
    const s = b.tick === a.tick ? 0 : (wanted - a.tick) / (b.tick - a.tick);
    return { apart: b.tick - a.tick, tip: a.tip.map((x, k) => x + s * (b.tip[k] - x)) };
  }, tick);
}

const distance = (a, b) => Math.hypot(...a.map((x, i) => x - b[i]));

/** Waits until words and picture are those of the record that is shown (a browser without a graphics card draws late). */
function agreed(page) {
  return until("the record that is shown in words and in 3D", () =>
    page.evaluate(() => {
      const { store, drawnTip } = globalThis.sinew;
      const { t, tick, tip } = store.current;
      const words = `${tip.map((x) => (1000 * x).toFixed(1)).join(", ")} mm`;
      const same = document.getElementById("tip").textContent === words && Math.hypot(...drawnTip().map((x, i) => x - tip[i])) < 1e-5;
      return same ? { t, tick, tip, last: store.shown.at(-1).t } : null;
    }), 10);
}

test("the page of a running demo shows the arm where its daemon says, pauses and scrubs", { timeout: 240000 }, async () => {
  const bench = new Bench();
  try {
    const kept = join(bench.folder, "demo");
    const demo = bench.start(sinew, "demo", "tip", "--duration", "100", "--keep", kept, "--view=0");
    const address = await until("address in the demo's words", () => {
      if (demo.exitCode !== null) throw new Error(demo.words());
      return demo.words().match(/http:\/\/127\.0\.0\.1:\d+\//)?.[0];
    }, 90);
    const config = join(kept, "demo.toml");
    const page = await open(chromium, address);
    await until("an arm that tracks", async () => (await newest(page))?.mode === 3, 90);

    // The arm moves: the daemon's report is compared with the page's records around its tick.
    for (let look = 0; look < 3; look++) {
      await sleep(1000);
      const report = await status(config);
      const shown = await until("a record of the report's tick", () => between(page, report.ticks - 1));
      assert.ok(distance(shown.tip, report.tip.position_m) < 2e-4, JSON.stringify([shown, report.tip]));
    }
    const { scene, tensions } = await page.evaluate(() => ({
      scene: globalThis.sinew.scene,
      tensions: globalThis.sinew.store.current.command_n.length,
    }));
    assert.equal(tensions, scene.geometry.cables.length);
    assert.equal((await newest(page)).obstacles.length, 2);
    await until("obstacles that the loop knows", async () => (await newest(page)).obstacles.every((o) => o.distance_m > 0));
    await sleep(12000);
    await picture(page, "tracking");

    // Paused: the record that is shown stays, what is drawn is that record, new ones come all the same.
    await page.click("#pause");
    const held = await agreed(page);
    const words = await text(page, "#tip");
    await sleep(1500);
    assert.equal(await text(page, "#tip"), words);
    assert.ok((await newest(page)).tick > held.tick, "records come while the page is paused");
    assert.equal(await text(page, "#pause"), "Live");

    // Scrubbed: an older record, in words and in 3D.
    await page.$eval("#slider", (slider) => {
      slider.value = Math.floor(slider.max / 2);
      slider.dispatchEvent(new Event("input"));
    });
    const old = await agreed(page);
    assert.ok(old.t < old.last - 2 && distance(old.tip, held.tip) > 1e-3, JSON.stringify([old, held]));
    await picture(page, "paused");

    // Live again.
    await page.click("#pause");
    await until("the newest record", async () => (await text(page, "#tip")) !== words && (await text(page, "#pause")) === "Pause");

    // Whoever comes later sees what was before.
    const late = await open(chromium, address, true);
    const window = await until("a window", () => late.evaluate(() => globalThis.sinew?.store.frames.length));
    assert.ok(window > 100, `${window}`);
    await sleep(1500);
    await picture(late, "dark");
    for (const one of [page, late]) {
      assert.deepEqual(one.trouble, []);
      assert.deepEqual(one.asked.filter((url) => !url.startsWith(address) && !url.startsWith("data:") && !url.startsWith("blob:")), []);
      await one.close();
    }
  } finally {
    await bench.end();
  }
});

test("a planted fault is told with its remedy, and the page outlives its daemon", { timeout: 240000 }, async () => {
  const bench = new Bench();
  try {
    const config = bench.configure();
    const simulated = bench.start(plant, "--config", config, "--fault", "trip:2,1@14");
    await until("the plant", () => simulated.said.includes("\n") || simulated.exitCode !== null, 60);
    const address = await bench.view("--config", config);
    const page = await open(chromium, address);
    await until("that there is no daemon", async () => /no daemon/.test(await text(page, "#link")));

    const run = () => bench.start(sinew, "run", "--config", config);
    let daemon = run();
    await until("records", async () => (await text(page, "#link")) === "live" && (await newest(page)) !== null);
    const camera = () => bench.start(sinew, "obstacles", "inject", "--config", config, "--ball", "0.6,0.2,-1.4,0.12");
    let inject = camera();
    await until("an obstacle", async () => (await newest(page)).obstacles[0]?.distance_m > 0);
    const armed = await until("an arm that is armed", async () => /arming|holding/.test(await ask("arm", "--config", config)), 30);
    assert.ok(armed);
    await until("an arm that holds", async () => (await text(page, "#mode")) === "holding");
    await picture(page, "holding");

    await until("the fault", () => page.$(".alarm.fault"), 60);
    const report = await until("the fault in the report", async () => (await status(config))?.fault);
    await until("the fault in words", async () => {
      const told = await text(page, ".alarm.fault");
      return told.includes(report.what) && told.includes(report.clears.slice(0, 20));
    });
    assert.match(await text(page, ".alarm.fault"), /2,1/);
    assert.equal(await text(page, "#mode"), "faulted");
    await sleep(1000);
    await picture(page, "fault");

    // It goes: what was last is still there. Another one comes: its records are shown.
    const last = await newest(page);
    inject.kill("SIGTERM");
    daemon.kill("SIGKILL");
    await daemon.ended;
    await until("that it has gone", async () => !/live/.test(await text(page, "#link")), 30);
    assert.ok((await newest(page)).tick >= last.tick);
    assert.ok(await page.$(".alarm.fault"));
    daemon = run();
    await until("records of the next daemon", async () => {
      const now = await newest(page);
      return (await text(page, "#link")) === "live" && now && now.t < last.t;
    }, 60);
    assert.deepEqual(page.trouble, []);
    await page.close();
  } finally {
    await bench.end();
  }
});

test("a recording is shown, scrubbed in parts, and played", { timeout: 240000 }, async () => {
  const bench = new Bench();
  try {
    const file = join(bench.folder, "run.mcap");
    await bench.start(sinew, "plan", "tip-no-avoidance", "--out", file).ended;
    const page = await open(chromium, await bench.view(file));
    await until("the whole recording", () => page.evaluate(() => globalThis.sinew?.store.current));
    const whole = await page.evaluate(() => {
      const { store, scene } = globalThis.sinew;
      return { from: store.shown[0].t, to: store.shown.at(-1).t, span: scene.recording.span_s, count: store.shown.length };
    });
    assert.ok(whole.count > 500 && whole.from === whole.span[0] && whole.span[1] - whole.to < 0.2, JSON.stringify(whole));
    const first = await agreed(page);

    // The middle, then ten seconds around it, in which every step of 0.1 s is there.
    await page.$eval("#slider", (slider) => {
      slider.value = Math.round(slider.max / 2);
      slider.dispatchEvent(new Event("input"));
    });
    const middle = await agreed(page);
    assert.ok(Math.abs(middle.t - (whole.from + whole.to) / 2) < 1 && distance(middle.tip, first.tip) > 1e-3, JSON.stringify(middle));
    await page.select("#span", "10");
    const part = await until("the part", () => page.evaluate(() => {
      const { shown, current } = globalThis.sinew.store;
      const length = shown.at(-1).t - shown[0].t;
      return length < 11 ? { length, count: shown.length, t: current.t, tip: current.tip, target: current.target.position_m, error: current.error_m } : null;
    }));
    assert.ok(part.length > 9.7 && part.count >= 98 && part.t === middle.t, JSON.stringify(part));
    assert.deepEqual(part.tip, middle.tip);
    assert.ok(Math.abs(distance(part.tip, part.target) - part.error) < 1e-5, JSON.stringify(part));

    await page.click("#pause");
    await until("a later record", async () => (await page.evaluate(() => globalThis.sinew.store.current.t)) > part.t + 0.5);
    await page.click("#pause");
    const stopped = await agreed(page);
    await sleep(1000);
    assert.equal((await agreed(page)).t, stopped.t);
    await picture(page, "recording");
    assert.deepEqual(page.trouble, []);
    await page.close();
  } finally {
    await bench.end();
  }
});

test("only pages of this computer's own address are served", { timeout: 60000 }, async () => {
  const bench = new Bench();
  try {
    const address = new URL(await bench.view("--arm", "nobody"));
    const get = (host) =>
      new Promise((done, failed) => {
        const options = { host: "127.0.0.1", port: address.port, path: "/scene", headers: { host } };
        request(options, (answer) => done(answer.resume())).on("error", failed).end();
      });
    assert.equal((await get(address.host)).statusCode, 200);
    assert.equal((await get("localhost:1")).statusCode, 200);
    const foreign = await get("rebound.example:80");
    assert.equal(foreign.statusCode, 403);
    const own = await get(address.host);
    assert.equal(own.headers["access-control-allow-origin"], undefined);
    assert.match(own.headers["content-security-policy"], /default-src 'none'/);
  } finally {
    await bench.end();
  }
});
