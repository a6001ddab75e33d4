// The records of the last minute, and which of them is shown.

/** Frames that are kept, as many as the server keeps. */
const MOST = 1800;

export class Window {
  constructor() {
    this.frames = [];
    this.status = null;
    // While paused: the frames as they were then, and the one that is shown.
    this.held = null;
    this.index = 0;
  }

  get paused() {
    return this.held !== null;
  }

  /** The frames that are looked at. */
  get shown() {
    return this.held ?? this.frames;
  }

  /** The frame that is looked at; null before the first. */
  get current() {
    return (this.paused ? this.held[this.index] : this.frames.at(-1)) ?? null;
  }

  push(frame) {
    frame.status = this.status;
    this.frames.push(frame);
    if (this.frames.length > MOST) this.frames.shift();
  }

  /** Begins anew, with what the server has kept. What is paused stays. */
  reset(frames) {
    for (const frame of frames) frame.status = this.status;
    this.frames = frames;
  }

  /** Shows one of these frames, and nothing that comes. */
  hold(frames, index) {
    this.reset(frames);
    this.held = frames;
    this.index = index;
  }

  setStatus(status) {
    this.status = status;
    const newest = this.frames.at(-1);
    if (newest) newest.status = status;
  }

  pause() {
    if (this.paused || this.frames.length === 0) return;
    this.held = this.frames.slice();
    this.index = this.held.length - 1;
  }

  live() {
    this.held = null;
  }

  /** Shows a frame of the window by its place, paused. */
  seek(index) {
    this.pause();
    if (this.paused) this.index = Math.min(this.held.length - 1, Math.max(0, index));
  }

  /** The place of the frame nearest to a time (s). */
  at(time) {
    const frames = this.shown;
    let low = 0;
    let high = frames.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (frames[middle].t < time) low = middle + 1;
      else high = middle;
    }
    return low > 0 && time - frames[low - 1].t < frames[low].t - time ? low - 1 : low;
  }
}
