// A recording: the part of it that is loaded, and playing it.

const $ = (id) => document.getElementById(id);
/** Frames that are loaded at most: of a few seconds every record, of more some. */
const MOST = 1000;

export class Playback {
  constructor({ file, span_s: span }, store, seek) {
    this.whole = span;
    this.store = store;
    this.seek = seek;
    this.playing = false;
    this.loading = 0;
    $("link").className = "link on";
    $("link").textContent = file;
    const length = span[1] - span[0];
    const choices = [3600, 600, 60, 10, 1].filter((s) => s < length);
    const options = [["all", Infinity], ...choices.map((s) => [s >= 60 ? `${s / 60} min` : `${s} s`, s])];
    $("span").replaceChildren(...options.map(([name, seconds]) => new Option(name, seconds)));
    this.load(...span, span[0]);
  }

  /** Loads a range of times (s) and shows the record nearest to one of them. */
  async load(from, to, at) {
    const turn = ++this.loading;
    const answer = await fetch(`frames/${from}/${to}/${MOST}`);
    if (turn !== this.loading) return;
    if (!answer.ok) return ($("note").textContent = await answer.text());
    const frames = await answer.json();
    if (turn !== this.loading || frames.length === 0) return;
    this.store.hold(frames, 0);
    this.seek(this.store.at(at));
    this.begin();
  }

  /** Another length of the window, around what is shown. */
  choose() {
    const seconds = Number($("span").value);
    const at = this.store.current.t;
    const [first, last] = this.whole;
    const from = Math.max(first, Math.min(at - seconds / 2, last - seconds));
    return this.load(from, Math.min(last, from + seconds), at);
  }

  toggle() {
    this.playing = !this.playing;
    const { index, shown } = this.store;
    this.seek(this.playing && index === shown.length - 1 && shown.at(-1).t >= this.whole[1] - 0.1 ? 0 : index);
    this.begin();
  }

  /** Playing goes on from what is shown. */
  begin() {
    this.from = { clock: performance.now(), t: this.store.current?.t };
  }

  /** What is played moves on with the clock; at the end of what is loaded the next part is. */
  advance(clock) {
    if (!this.playing || !this.store.current) return;
    if (this.store.current.t !== this.last) this.begin(); // the slider was moved
    const t = this.from.t + (clock - this.from.clock) / 1000;
    const end = this.store.shown.at(-1).t;
    if (t > end) {
      const seconds = Number($("span").value);
      if (end >= this.whole[1] - 0.1 || !Number.isFinite(seconds)) return this.toggle();
      this.begin();
      return this.load(end, Math.min(this.whole[1], end + seconds), end);
    }
    this.seek(this.store.at(t));
    this.last = this.store.current.t;
  }
}
