// SPDX-License-Identifier: Apache-2.0
// The time line of the tuning page: thumbnails, play head, range, and the keys of one parameter. See elements.py.

import { addStyle } from "mr360uw-tune/style.js";
import { Throttle } from "mr360uw-tune/throttle.js";
import { short, ticks } from "mr360uw-tune/ticks.js";
import { template } from "mr360uw-tune/timeline_template.js";

const SEEK_MS = 60; // least time between two events while the head is dragged
const KEYS_MS = 100; // and between two while a key is dragged
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export default {
  template,
  props: {
    count: Number, // frames of the clip
    rate: Number, // frames a second
    // of these, after: the number of the last event that Python had heard of
    at: Object, // { frame, serial, after } of the play head
    range: Object, // { start, stop, serial, after }: first frame, and the one after the last
    thumbnails: { type: Array, default: () => [] }, // { frame, url }
    played: { type: Array, default: () => [] }, // [first, the one after the last] of frames that are shown at once
    curve: Object, // { label, unit, low, high, keys: [[s, value]], interpolation, samples: [[s, value]] } or null; serial, after
  },
  emits: ["seek", "play", "range", "keys"],
  data() {
    return {
      frame: this.at.frame,
      start: this.range.start,
      stop: this.range.stop,
      playing: false,
      keys: [],
      kind: "linear",
      chosen: -1,
      waiting: false, // for the samples of keys that have changed
      heldBounds: null, // of the value axis, while a key is dragged
      box: { width: 800, height: 112, left: 64, right: 22, top: 18, bottom: 22 },
    };
  },
  created() {
    this.events = new Throttle((name, told) => this.$emit(name, told));
    this.number = 0; // of the newest event; an answer to an older one would undo what was done since
    this.take(this.curve);
  },
  mounted() {
    addStyle();
    this.watcher = new ResizeObserver(([entry]) => (this.box.width = Math.max(entry.contentRect.width, 200)));
    this.watcher.observe(this.$el);
  },
  beforeUnmount() {
    this.watcher.disconnect();
    cancelAnimationFrame(this.beat);
    this.events.stop();
  },
  watch: {
    at(now, before) {
      if (this.isNew(now, before) && !this.playing && !this.scrubbing) this.frame = now.frame;
    },
    range(now, before) {
      if (this.isNew(now, before)) [this.start, this.stop] = [now.start, now.stop];
    },
    curve(now, before) {
      if (now && !this.isNew(now, before)) return;
      if (this.held === undefined) this.take(now);
      else this.waiting = false;
    },
  },
  computed: {
    timeText() {
      return `${(this.frame / this.rate).toFixed(2)} s`;
    },
    rangeText() {
      const [a, b] = [this.start / this.rate, this.stop / this.rate];
      return `${a.toFixed(2)} \u2013 ${b.toFixed(2)} s, ${this.stop - this.start} frames`;
    },
    keysText() {
      return this.keys.length === 1 ? "1 key" : `${this.keys.length || "no"} keys`;
    },
    chosenText() {
      const key = this.keys[this.chosen];
      return key ? this.keyText(key) : "";
    },
    thumbs() {
      const all = [...this.thumbnails].sort((a, b) => a.frame - b.frame);
      return all.map((one, k) => {
        const from = k ? (all[k - 1].frame + one.frame + 1) / 2 : 0;
        const to = k + 1 < all.length ? (one.frame + all[k + 1].frame + 1) / 2 : this.count;
        const src = (one.url.startsWith("/") ? window.path_prefix || "" : "") + one.url;
        return { src, style: { left: `${this.across(from)}%`, width: `${this.across(to) - this.across(from)}%` } };
      });
    },
    bounds() {
      if (this.heldBounds) return this.heldBounds;
      const values = [...this.keys, ...(this.curve?.samples || [])].map((one) => one[1]);
      const { low, high } = this.curve || {};
      let [a, b] = [low ?? Math.min(...values, 0), high ?? Math.max(...values, 1)];
      // a wide range of which the keys use little is shown in part
      if (values.length) {
        const [least, most] = [Math.min(...values), Math.max(...values)];
        const margin = Math.max(0.6 * (most - least), 0.5 * Math.abs(most), 1e-3 * (b - a));
        [a, b] = [Math.max(low ?? -Infinity, least - margin), Math.min(high ?? Infinity, most + margin)];
      }
      return b > a ? [a, b] : [a - 0.5, a + 0.5];
    },
    valueTicks() {
      return ticks(...this.bounds, 4);
    },
    timeTicks() {
      return ticks(0, this.count / this.rate, Math.max(Math.floor(this.box.width / 90), 2));
    },
    path() {
      const samples = this.curve?.samples || [];
      return samples.map(([t, v], k) => `${k ? "L" : "M"}${this.x(t).toFixed(1)} ${this.y(v).toFixed(1)}`).join("");
    },
  },
  methods: {
    short,
    isNew(now, before) {
      return now.serial !== before?.serial && now.after >= this.number;
    },
    numbered(told) {
      this.number += 1;
      return { ...told, number: this.number };
    },
    across(frame) {
      return (100 * frame) / Math.max(this.count, 1);
    },
    x(time_s) {
      const { left, right, width } = this.box;
      return left + ((width - left - right) * time_s * this.rate) / Math.max(this.count, 1);
    },
    y(value) {
      const { top, bottom, height } = this.box;
      const [low, high] = this.bounds;
      return top + ((height - top - bottom) * (high - value)) / (high - low);
    },
    keyText(key) {
      return `key at ${key[0].toFixed(2)} s: ${short(key[1])} ${this.curve.unit}`;
    },

    // --- play head
    seek(frame, how = "") {
      const at = clamp(Math.round(frame), 0, this.count - 1);
      if (at === this.frame && how) return;
      this.frame = at;
      const told = this.numbered({ frame: at, time_s: at / this.rate, how });
      if (how === "scrub") this.events.later("seek", SEEK_MS, told);
      else this.events.now("seek", told);
    },
    rest() {
      this.seek(this.frame);
    },
    isPlayed(frame) {
      return this.played.some(([from, to]) => from <= frame && frame < to);
    },
    play(playing) {
      this.playing = playing;
      this.$emit("play", { playing });
      if (!playing) {
        cancelAnimationFrame(this.beat);
        this.rest();
        return;
      }
      if (this.frame < this.start || this.frame >= this.stop - 1) this.frame = this.start;
      let before = performance.now();
      let at = this.frame;
      this.events.now("seek", this.numbered({ frame: at, time_s: at / this.rate, how: "play" }));
      const step = (time) => {
        // the clip's rate, but no frame is passed by that was not made yet; the first time may lie before the click
        if (this.isPlayed(this.frame)) at += (Math.max(time - before, 0) / 1000) * this.rate;
        for (let one = this.frame + 1; one <= at; one += 1) if (!this.isPlayed(one)) at = one;
        before = time;
        const length = Math.max(this.stop - this.start, 1);
        if (at >= this.stop) at = this.start + ((at - this.start) % length);
        this.seek(Math.floor(at), "play");
        this.beat = requestAnimationFrame(step);
      };
      this.beat = requestAnimationFrame(step);
    },
    frameAt(event) {
      const area = this.$refs.strip.getBoundingClientRect();
      return ((event.clientX - area.left) / area.width) * this.count;
    },
    scrub(event) {
      if (event.button !== 0) return;
      if (this.playing) this.play(false);
      this.$refs.strip.setPointerCapture(event.pointerId);
      this.scrubbing = true;
      this.seek(Math.floor(this.frameAt(event)), "scrub");
    },
    scrubMove(event) {
      if (this.scrubbing) this.seek(Math.floor(this.frameAt(event)), "scrub");
    },
    scrubEnd() {
      if (!this.scrubbing) return;
      this.scrubbing = false;
      this.rest();
    },
    stripKey(event) {
      const step = event.shiftKey ? 10 : 1;
      const actions = {
        ArrowLeft: () => this.seek(this.frame - step),
        ArrowRight: () => this.seek(this.frame + step),
        Home: () => this.seek(this.start),
        End: () => this.seek(this.stop - 1),
        i: () => this.setRange(this.frame, this.stop),
        o: () => this.setRange(this.start, this.frame + 1),
        " ": () => this.play(!this.playing),
      };
      this.act(event, actions[event.key]);
    },
    act(event, action) {
      if (!action || event.target !== event.currentTarget) return;
      event.preventDefault();
      action();
    },

    // --- range
    setRange(start, stop) {
      const from = clamp(start, 0, this.count - 1);
      [this.start, this.stop] = [from, clamp(stop, from + 1, this.count)];
      this.events.now("range", this.numbered({ start: this.start, stop: this.stop }));
    },
    hold(event) {
      event.target.setPointerCapture(event.pointerId);
    },
    edgeMove(event, edge) {
      if (!event.target.hasPointerCapture(event.pointerId)) return;
      const frame = Math.round(this.frameAt(event));
      if (edge === "start") this.start = clamp(frame, 0, this.stop - 1);
      else this.stop = clamp(frame, this.start + 1, this.count);
    },
    edgeEnd() {
      this.setRange(this.start, this.stop);
    },
    edgeKey(event, edge) {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key] * (event.shiftKey ? 10 : 1);
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      if (edge === "start") this.setRange(Math.min(this.start + step, this.stop - 1), this.stop);
      else this.setRange(this.start, this.stop + step);
    },

    // --- keys
    take(curve) {
      this.keys = (curve?.keys || []).map((key) => [...key]);
      this.kind = curve?.interpolation || "linear";
      this.waiting = false;
      if (this.chosen >= this.keys.length) this.chosen = -1;
    },
    tell(done) {
      const told = this.numbered({ keys: this.keys.map((key) => [...key]), interpolation: this.kind, done });
      this.waiting = true;
      if (done) this.events.now("keys", told);
      else this.events.later("keys", KEYS_MS, told);
    },
    // The nearest frame between a key's neighbours, and a value within the parameter's range.
    moveTo(k, time_s, value) {
      const last = this.count - 1;
      const low = k > 0 ? Math.round(this.keys[k - 1][0] * this.rate) + 1 : 0;
      const high = k + 1 < this.keys.length ? Math.round(this.keys[k + 1][0] * this.rate) - 1 : last;
      const frame = clamp(Math.round(time_s * this.rate), low, Math.max(high, low));
      const { low: least, high: most } = this.curve;
      this.keys[k] = [frame / this.rate, clamp(value, least ?? -Infinity, most ?? Infinity)];
    },
    add(time_s, value) {
      const frame = clamp(Math.round(time_s * this.rate), 0, this.count - 1);
      const same = this.keys.findIndex((key) => Math.round(key[0] * this.rate) === frame);
      if (same >= 0) {
        this.moveTo(same, time_s, value);
      } else {
        this.keys.push([frame / this.rate, value]);
        this.keys.sort((a, b) => a[0] - b[0]);
      }
      this.chosen = this.keys.findIndex((key) => Math.round(key[0] * this.rate) === frame);
      this.moveTo(this.chosen, frame / this.rate, value);
      this.tell(true);
    },
    addAt(event) {
      const [time_s, value] = this.valueAt(event);
      this.add(time_s, value);
    },
    addHere() {
      const samples = this.curve.samples || [];
      const time_s = this.frame / this.rate;
      const next = samples.findIndex((one) => one[0] >= time_s);
      const [a, b] = [samples[Math.max(next - 1, 0)], samples[next < 0 ? samples.length - 1 : next]];
      const part = a && b && b[0] > a[0] ? clamp((time_s - a[0]) / (b[0] - a[0]), 0, 1) : 1;
      this.add(time_s, a && b ? a[1] + part * (b[1] - a[1]) : (this.bounds[0] + this.bounds[1]) / 2);
    },
    remove(k) {
      if (k < 0) return;
      this.keys.splice(k, 1);
      this.chosen = Math.min(k, this.keys.length - 1);
      this.tell(true);
    },
    interpolate(kind) {
      this.kind = kind;
      this.tell(true);
    },
    valueAt(event) {
      const area = this.$refs.curve.getBoundingClientRect();
      const { left, right, top, bottom, height, width } = this.box;
      const [low, high] = this.bounds;
      const across = (event.clientX - area.left - left) / (width - left - right);
      const down = (event.clientY - area.top - top) / (height - top - bottom);
      return [(across * this.count) / this.rate, high - down * (high - low)];
    },
    keyDown(event, k) {
      if (event.button !== 0) return;
      event.target.focus();
      event.target.setPointerCapture(event.pointerId);
      [this.held, this.chosen] = [k, k];
      this.heldBounds = this.bounds;
    },
    keyMove(event) {
      if (this.held === undefined) return;
      const [time_s, value] = this.valueAt(event);
      this.moveTo(this.held, time_s, value);
      this.changed = true;
      this.tell(false);
    },
    keyUp() {
      if (this.held === undefined) return;
      [this.held, this.heldBounds] = [undefined, null];
      if (this.changed) this.tell(true);
      this.changed = false;
    },
    keyKey(event, k) {
      const step = event.shiftKey ? 10 : 1;
      const [time_s, value] = this.keys[k];
      const one = ((this.bounds[1] - this.bounds[0]) / 100) * step;
      const move = (t, v) => () => {
        this.moveTo(k, t, v);
        this.tell(true);
      };
      const actions = {
        ArrowLeft: move(time_s - step / this.rate, value),
        ArrowRight: move(time_s + step / this.rate, value),
        ArrowUp: move(time_s, value + one),
        ArrowDown: move(time_s, value - one),
        Delete: () => this.remove(k),
        Backspace: () => this.remove(k),
        Enter: () => this.seek(Math.round(time_s * this.rate)),
      };
      this.act(event, actions[event.key]);
    },
  },
};
