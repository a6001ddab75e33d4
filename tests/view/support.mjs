// Processes of a run, and the browser.

import assert from "node:assert/strict";
import { execFile, spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync, mkdirSync, openSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { promisify } from "node:util";
import puppeteer from "puppeteer-core";

const programs = process.env.SINEW_VIEW_PROGRAMS;
export const sinew = join(programs, "sinew");
export const plant = join(programs, "sim_plant");
const root = new URL("../..", import.meta.url).pathname;

export const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Waits until a question is answered with something true, which it returns. */
export async function until(what, ask, seconds = 30) {
  const end = Date.now() + 1000 * seconds;
  let last;
  for (;;) {
    last = await ask();
    if (last) return last;
    if (Date.now() > end) throw new Error(`${what}: not within ${seconds} s`);
    await sleep(50);
  }
}

/** A folder, and all processes that were started for a test; nothing of them stays. */
export class Bench {
  constructor() {
    this.folder = mkdtempSync(join(tmpdir(), "sinew-view-test-"));
    this.children = [];
  }

  /** A configuration of the paper's arm with bus and shared memory of its own. */
  configure() {
    const name = `view${process.pid}`;
    const text = ["arm.toml", "controller.toml", "drives.toml", "plant.toml"]
      .map((file) => readFileSync(join(root, "config", file), "utf8"))
      .join("\n")
      .replace(/^interface = .*$/m, `interface = "${name}"`);
    const memory = join(this.folder, "ipc");
    mkdirSync(memory, { mode: 0o700 });
    const run = join(this.folder, "run");
    mkdirSync(run, { mode: 0o700 });
    const file = join(this.folder, "arm.toml");
    writeFileSync(file, `${text}\n[ipc]\nprefix = "${name}_"\nroot_path = "${memory}/"\nrun_path = "${run}"\n`);
    return file;
  }

  start(program, ...args) {
    const log = join(this.folder, `${this.children.length}.log`);
    const child = spawn(program, args, { stdio: ["ignore", "pipe", openSync(log, "w")] });
    child.said = "";
    child.stdout.on("data", (data) => (child.said += data));
    child.words = () => `${child.said}\n${readFileSync(log, "utf8")}`;
    child.ended = new Promise((done) => child.on("exit", done));
    this.children.push(child);
    return child;
  }

  /** Starts a page; its address. */
  async view(...args) {
    const view = this.start(sinew, "view", "--port", "0", ...args);
    await until("address of the page", () => view.said.includes("\n") || view.exitCode !== null);
    assert.match(view.said, /^http:\/\/127\.0\.0\.1:\d+\/\n$/, view.words());
    return view.said.trim();
  }

  async end() {
    for (const child of this.children.toReversed()) {
      if (child.exitCode === null) child.kill("SIGTERM");
      await Promise.race([child.ended, sleep(15000).then(() => child.kill("SIGKILL"))]);
    }
    rmSync(this.folder, { recursive: true, force: true });
  }
}

/** What a command answers, whatever its code. */
export async function ask(...args) {
  const failed = (error) => error;
  return (await promisify(execFile)(sinew, args).catch(failed)).stdout;
}

export async function status(config) {
  const text = await ask("status", "--config", config, "--json");
  return text ? JSON.parse(text) : null;
}

export function browser() {
  return puppeteer.launch({
    executablePath: process.env.SINEW_BROWSER ?? "/usr/bin/chromium",
    // WebGL without a graphics card; Chromium's sandbox wants rights that a container does not have.
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
  });
}

/** Opens a page; what goes wrong in it, and every address that it asks, is kept. */
export async function open(browser, address, dark = false) {
  const page = await browser.newPage();
  page.trouble = [];
  page.asked = [];
  page.on("pageerror", (error) => page.trouble.push(String(error)));
  // That a server has gone is the browser's own word: on a slow computer a demo ends before its test does.
  const gone = /net::ERR_(INCOMPLETE_CHUNKED_ENCODING|CONNECTION_REFUSED)/;
  page.on("console", (message) => {
    if (message.type() === "error" && !gone.test(message.text())) page.trouble.push(message.text());
  });
  page.on("request", (request) => page.asked.push(request.url()));
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: dark ? "dark" : "light" }]);
  await page.setViewport({ width: 1600, height: 1000 });
  await page.goto(address, { waitUntil: "domcontentloaded" });
  return page;
}

export const text = (page, selector) => page.$eval(selector, (element) => element.textContent);

/** The newest record that the page has, without its report. */
export const newest = (page) =>
  page.evaluate(() => {
    const frame = globalThis.sinew?.store.frames.at(-1);
    return frame ? { ...frame, status: null } : null;
  });

export async function picture(page, name) {
  const folder = process.env.SINEW_VIEW_SCREENSHOTS;
  if (folder) await page.screenshot({ path: join(folder, `${name}.png`) });
}
