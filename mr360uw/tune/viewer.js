// SPDX-License-Identifier: Apache-2.0
// The viewer of the tuning page: a picture, flat or around the viewer, with markers and handles. See situation.py.

import { Painter } from "mr360uw-tune/painter.js";
import { coordinatesOf, pixelsPerRadian, pointBeside, shownAt, spanOf } from "mr360uw-tune/projection.js";
import { addStyle } from "mr360uw-tune/style.js";
import { Throttle } from "mr360uw-tune/throttle.js";
import { template } from "mr360uw-tune/viewer_template.js";

const CLICK_PX = 4; // a pointer that moves less is a click
const STROKE_PX = 3; // between two points of a line that is drawn
const MOVE_MS = 40; // least time between two events of a drag
const VIEW_MS = 150; // and between two of a view
const TURN_DEG = 5; // of an arrow key
const HANDLE_PX = 44; // least distance of a handle from the middle of its object
const [SMALL_PX, BESIDE_PX] = [110, 14]; // radius below which an object's mark and handle are beside it, and how far
const REACH_MS = 400; // without a turn of the wheel that end a change of distance
const FAR_PX = 1e5; // beyond which a line is not drawn
const FOV = { low: 20, high: 140, start: 90 };
const ZOOM = { low: 1, near: 3, high: 16 };
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const HANDLES = [
  { handle: "move", sign: "\u2725", words: "Move" },
  { handle: "turn", sign: "\u21bb", words: "Turn", right: 0, up: -1 },
  { handle: "scale", sign: "\u2922", words: "Scale", right: 1, up: 1 },
];
const startView = (look) => ({ look, yaw: 0, pitch: 0, fov: FOV.start, u: 0.5, v: 0.5, zoom: 1 });

export default {
  template,
  props: {
    picture: Object, // { url, serial, stale, coarse, stand_in, panorama, name } or null
    other: Object, // { url, serial, name } or null
    expected: Number, // serial of the first picture that shows the settings as they are
    markers: { type: Array, default: () => [] }, // { name, label, kind, longitude, latitude, radius }
    horizon: { type: Array, default: () => [] }, // of points [longitude, latitude]
    drawn: { type: Array, default: () => [] }, // of [kind, points]
    drawing: String, // kind of the lines that drags draw; empty: they turn the view
    selected: String, // name of the marker with handles
    look: Boolean,
    compare: { type: String, default: "none" }, // none, wipe, side
  },
  emits: ["pick", "stroke", "drag", "view", "select", "mode", "compare", "shown", "failed"],
  data() {
    return {
      view: startView(this.look),
      size: { width: 1, height: 1 },
      aspect: 0.5,
      wraps: true,
      shown: { serial: -1, stale: false, coarse: false, name: "" },
      second: "", // name of the second picture as it is drawn
      wipe: 0.5,
      comparison: this.compare,
      wrong: "",
      dragged: null, // { handle, name, longitude, latitude } while a handle is held
      bare: false, // without marks and handles
      stroke: [], // points of the line that is being drawn
      pointed: null, // what is under the pointer
    };
  },
  created() {
    this.painter = null; // not reactive: the proxy of a bitmap is none
    this.newest = -1;
    this.newestOther = -1;
    this.asked = null;
    this.held = null;
    this.reached = null; // { handle, name, longitude, latitude, start, farther } while the wheel moves an object
    this.events = new Throttle((name, told) => this.$emit(name, told));
  },
  mounted() {
    addStyle();
    const canvas = this.$refs.canvas;
    this.painter = new Painter(canvas);
    if (!this.painter.gl) {
      this.wrong = "This browser does not offer WebGL2: no picture can be shown. Allow hardware or software graphics.";
      return;
    }
    canvas.addEventListener("webglcontextlost", this.lost);
    canvas.addEventListener("webglcontextrestored", this.restored);
    this.$refs.stage.addEventListener("wheel", this.wheel, { passive: false });
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(canvas);
    this.watchRatio();
    this.resize();
    this.load(this.picture);
    this.loadOther(this.other);
  },
  beforeUnmount() {
    this.watcher?.disconnect();
    this.ratio?.removeEventListener("change", this.newRatio);
    this.events.stop();
    const canvas = this.$refs.canvas;
    canvas.removeEventListener("webglcontextlost", this.lost);
    this.painter?.gl?.getExtension("WEBGL_lose_context")?.loseContext(); // browsers allow for few contexts
  },
  computed: {
    pane() {
      const width = this.comparison === "side" ? this.size.width / 2 : this.size.width;
      return { width, height: this.size.height, aspect: this.aspect, wraps: this.wraps };
    },
    lookNow() {
      return this.view.look && this.wraps;
    },
    seen() {
      return { ...this.view, look: this.lookNow };
    },
    badge() {
      if (this.wrong) return "";
      if (this.shown.serial < 0) return "rendering";
      if (this.shown.serial < this.expected || this.shown.stale) {
        return "rendering \u2013 the picture is older than the settings";
      }
      if (this.shown.standIn) return "rendering \u2013 nearest keyframe";
      return this.shown.coarse ? "rendering \u2013 draft" : "";
    },
    placed() {
      return this.wraps && !this.bare ? this.markers.map((one) => this.place(one, one)).filter((one) => one.at) : [];
    },
    handles() {
      const one = this.markers.find((marker) => marker.name === this.selected);
      if (!one || !this.wraps || this.bare) return [];
      const scale = pixelsPerRadian(this.seen, this.pane, one);
      const most = Math.min(1.2, (0.3 * Math.min(this.pane.width, this.pane.height)) / scale); // they stay in sight
      const arm = Math.min(Math.max((one.radius || 0) * 1.3, HANDLE_PX / scale), most);
      return HANDLES.filter((h) => !one.handles || one.handles.includes(h.handle))
        .map((h) => {
          const held = this.dragged?.handle === h.handle && this.dragged.name === one.name ? this.dragged : null;
          const point = held || (h.handle === "move" ? one : pointBeside(one, arm, h.right, h.up));
          const look = { name: one.name, label: `${h.words} ${one.label || one.name}`, radius: h.handle === "move" ? one.radius : 0 };
          return this.place({ ...h, ...look, point, arm }, point);
        })
        .filter((h) => h.at);
    },
    horizonLines() {
      return this.wraps ? this.horizon.map((line) => this.pathOf(line)) : [];
    },
    drawnLines() {
      if (!this.wraps) return [];
      const drawn = this.stroke.length ? [...this.drawn, [this.drawing, this.stroke]] : this.drawn;
      return drawn.map(([kind, line]) => ({ kind, path: this.pathOf(line.length > 1 ? line : [...line, ...line]) }));
    },
    where() {
      const p = this.pointed;
      if (!p || p.longitude === undefined) return "";
      const degrees = (angle) => ((angle * 180) / Math.PI).toFixed(1).replace("-", "\u2212");
      return `${degrees(p.longitude)}\u00b0 across, ${degrees(p.latitude)}\u00b0 up`;
    },
  },
  watch: {
    picture(now) { this.load(now); },
    other(now) { this.loadOther(now); },
    look(now) { this.setMode(now); },
    compare(now) { this.comparison = now; },
    comparison: "paint",
    wipe: "paint",
    view: { deep: true, handler() { this.paint(); this.events.later("view", VIEW_MS, this.viewNow()); } },
  },
  methods: {
    // --- pictures
    async fetched(url) {
      await null; // the server's prefix is set once the page is mounted
      return this.painter.load((url.startsWith("/") ? window.path_prefix || "" : "") + url);
    },
    async load(picture) {
      if (!picture || !this.painter?.gl || picture.serial <= this.newest) return;
      this.newest = picture.serial;
      try {
        const bitmap = await this.fetched(picture.url);
        if (picture.serial < this.shown.serial) return bitmap.close(); // a newer one came first
        this.show(0, bitmap, picture.panorama);
        this.shown = { serial: picture.serial, stale: picture.stale, coarse: picture.coarse, name: picture.name, standIn: picture.stand_in };
        this.wrong = "";
        this.$emit("shown", { serial: picture.serial });
      } catch (error) {
        if (picture.serial < this.newest) return;
        this.wrong = `The picture could not be loaded (${error.message}).`;
        this.$emit("failed", { serial: picture.serial, reason: error.message });
      }
    },
    async loadOther(other) {
      if (!other || !this.painter?.gl || other.serial <= this.newestOther) return;
      this.newestOther = other.serial;
      const asked = (this.asked = {});
      try {
        const bitmap = await this.fetched(other.url);
        if (asked !== this.asked) return bitmap.close();
        this.show(1, bitmap, this.wraps);
        this.second = other.name;
      } catch (error) {
        this.wrong = `The second picture could not be loaded (${error.message}).`;
        this.$emit("failed", { serial: other.serial, reason: error.message });
      }
    },
    async snapshot(name) {
      const bitmap = this.painter?.bitmaps[0];
      if (!bitmap) return;
      this.asked = {}; // a second picture that is under way comes too late
      this.show(1, await createImageBitmap(bitmap, { colorSpaceConversion: "none", premultiplyAlpha: "none" }), this.wraps);
      this.second = name;
      if (this.comparison !== "none") this.$emit("compare", { compare: this.comparison, second: name });
    },
    show(unit, bitmap, wraps) {
      const before = this.painter.bitmaps[unit];
      if (!unit) [this.aspect, this.wraps] = [bitmap.height / bitmap.width, wraps];
      this.painter.upload(unit, bitmap, wraps);
      before?.close();
      this.paint();
    },
    lost(event) {
      event.preventDefault();
      this.wrong = "The graphics context was lost; waiting for it.";
    },
    restored() {
      this.painter.build();
      this.wrong = "";
      this.paint();
    },
    resize() {
      const canvas = this.$refs.canvas;
      const { width, height } = canvas.getBoundingClientRect();
      if (!width || !height) return;
      this.size = { width, height };
      const ratio = window.devicePixelRatio;
      canvas.width = Math.max(Math.round(width * ratio), 1);
      canvas.height = Math.max(Math.round(height * ratio), 1);
      this.draw(); // at once: a canvas that is resized is empty
    },
    // A window that is moved to another screen changes its pixels, not its size.
    watchRatio() {
      this.ratio?.removeEventListener("change", this.newRatio);
      this.ratio = window.matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
      this.ratio.addEventListener("change", this.newRatio);
    },
    newRatio() {
      this.resize();
      this.watchRatio();
    },
    paint() {
      this.frame ??= requestAnimationFrame(() => this.draw());
    },
    draw() {
      if (this.frame) cancelAnimationFrame(this.frame);
      this.frame = undefined;
      if (!this.painter?.gl) return;
      const canvas = this.$refs.canvas;
      const side = this.comparison === "side";
      const pane = { ...this.pane, width: side ? canvas.width / 2 : canvas.width, height: canvas.height };
      this.painter.draw(this.seen, pane, side ? 0.5 : this.comparison === "wipe" ? this.wipe : 2, side);
    },
    place(marker, point) {
      const at = coordinatesOf(this.seen, this.pane, point);
      const inside = at && at.x >= 0 && at.x <= this.pane.width && at.y >= 0 && at.y <= this.pane.height;
      const radius = (marker.radius || 0) * pixelsPerRadian(this.seen, this.pane, point);
      const beside = radius && radius < SMALL_PX ? radius + BESIDE_PX : 0;
      const aside = inside && at.x + beside > this.pane.width ? -beside : beside;
      return { ...marker, aside, at: inside ? { left: `${at.x + aside}px`, top: `${at.y}px` } : null };
    },
    hide() {
      this.bare = !this.bare;
    },

    // A path of SVG through points [longitude, latitude].
    pathOf(line) {
      let [text, last] = ["", null];
      const around = this.pane.width / spanOf(this.seen, this.pane)[0]; // width of a flat panorama
      for (const [longitude, latitude] of line) {
        let at = coordinatesOf(this.seen, this.pane, { longitude, latitude });
        if (at && Math.hypot(at.x, at.y) > FAR_PX) at = null;
        const seam = at && last && !this.lookNow && Math.round((at.x - last.x) / around) * around;
        if (seam) text += `L${(at.x - seam).toFixed(1)} ${at.y.toFixed(1)}`; // on to the edge, and again from the other
        if (at) text += `${seam || !last ? "M" : "L"}${at.x.toFixed(1)} ${at.y.toFixed(1)}`;
        last = at;
      }
      return text;
    },

    // --- views
    viewNow() {
      const { yaw, pitch, fov, u, v, zoom } = this.view;
      return { look: this.lookNow, yaw_deg: yaw, pitch_deg: pitch, fov_deg: fov, u, v, zoom };
    },
    setMode(look) {
      if (look === this.view.look) return;
      this.view.look = look;
      const chosen = this.markers.find((marker) => marker.name === this.selected);
      if (look && chosen && !this.view.yaw && !this.view.pitch) this.turnTo(chosen); // begin where there is something
      this.$emit("mode", { look });
    },
    setCompare(comparison) {
      if (comparison === this.comparison) return;
      this.comparison = comparison;
      this.$emit("compare", { compare: comparison, second: this.second });
    },
    reset() {
      this.view = startView(this.view.look);
    },
    turnTo({ longitude, latitude }) {
      if (this.lookNow) {
        this.view.yaw = (longitude * 180) / Math.PI;
        this.view.pitch = (latitude * 180) / Math.PI;
        return;
      }
      this.view.u = longitude / (2 * Math.PI) + 0.5;
      this.view.v = 0.5 - latitude / Math.PI;
      this.view.zoom = Math.max(this.view.zoom, ZOOM.near);
      this.keepInside();
    },
    turn(across, up) {
      if (this.lookNow) {
        this.view.yaw = ((((this.view.yaw + across + 180) % 360) + 360) % 360) - 180;
        this.view.pitch = clamp(this.view.pitch + up, -90, 90);
      } else {
        this.view.u += (across / 360) * (2 / (1 + this.view.zoom)) * 2;
        this.view.v -= (up / 180) * (2 / (1 + this.view.zoom));
        this.keepInside();
      }
    },
    keepInside() {
      this.view.v = clamp(this.view.v, 0, 1);
      this.view.u = this.wraps ? this.view.u - Math.floor(this.view.u) : clamp(this.view.u, 0, 1);
    },
    enlarge(factor, x = this.pane.width / 2, y = this.pane.height / 2) {
      if (this.lookNow) {
        this.view.fov = clamp(this.view.fov / factor, FOV.low, FOV.high);
        return;
      }
      const zoom = clamp(this.view.zoom * factor, ZOOM.low, ZOOM.high);
      // the point under the pointer stays
      const scale = (1 / this.view.zoom - 1 / zoom) / Math.min(this.pane.width, this.pane.height / this.aspect);
      this.view.u += (x - this.pane.width / 2) * scale;
      this.view.v += ((y - this.pane.height / 2) * scale) / this.aspect;
      this.view.zoom = zoom;
      if (zoom === 1) this.view.v = 0.5;
      this.keepInside();
    },
    wheel(event) {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 33 : 1;
      const { x, y } = this.inPane(event);
      const factor = Math.exp(-0.0015 * clamp(event.deltaY * lines, -300, 300));
      const one = this.markers.find((marker) => marker.name === this.selected && marker.radius);
      const at = one && this.wraps && coordinatesOf(this.seen, this.pane, one);
      const away = at ? Math.hypot(x - at.x, y - at.y) - one.radius * pixelsPerRadian(this.seen, this.pane, one) : Infinity;
      if (away < BESIDE_PX) this.reach(one, 1 / factor, event);
      else this.enlarge(factor, x, y);
    },
    // The wheel over the chosen object changes its distance, as one drag until it rests.
    reach({ name, longitude, latitude }, factor, event) {
      const held = { handle: "reach", name, longitude, latitude, start: { longitude, latitude }, farther: 1 };
      if (!this.reached) this.tell("start", event, (this.reached = held));
      this.reached.farther *= factor;
      this.tell("move", event, this.reached);
      clearTimeout(this.rest);
      this.rest = setTimeout(() => (this.reached = this.tell("end", event, this.reached)), REACH_MS);
    },
    inPane(event) {
      const box = this.$refs.canvas.getBoundingClientRect();
      const x = event.clientX - box.left;
      return { x: x >= this.pane.width ? x - this.pane.width : x, y: event.clientY - box.top };
    },

    // --- pointer on the picture
    down(event) {
      if (event.button !== 0) return;
      this.$refs.canvas.setPointerCapture(event.pointerId);
      const draws = this.drawing && this.wraps && !event.shiftKey;
      this.held = { x: event.clientX, y: event.clientY, view: { ...this.view }, moved: false, draws };
    },
    moved(event) {
      const at = this.inPane(event);
      this.pointed = shownAt(this.seen, this.pane, at.x, at.y);
      if (!this.held) return;
      const [dx, dy] = [event.clientX - this.held.x, event.clientY - this.held.y];
      if (!this.held.moved && Math.hypot(dx, dy) < CLICK_PX) return;
      if (this.held.draws) return this.drawTo(at);
      this.held.moved = true;
      this.view = { ...this.held.view };
      if (this.lookNow) {
        const perPixel = (2 * Math.tan((0.5 * this.view.fov * Math.PI) / 180) * (180 / Math.PI)) / this.pane.width;
        this.turn(-dx * perPixel, dy * perPixel);
      } else {
        const scale = this.view.zoom * Math.min(this.pane.width, this.pane.height / this.aspect);
        this.view.u -= dx / scale;
        this.view.v -= dy / (scale * this.aspect);
        this.keepInside();
      }
    },
    // Goes on with the line that is drawn; where it leaves the panorama, it waits.
    drawTo(at) {
      const held = this.held;
      if (!held.moved) {
        held.last = this.inPane({ clientX: held.x, clientY: held.y });
        this.addPoint(held.last);
      }
      held.moved = true;
      if (Math.hypot(at.x - held.last.x, at.y - held.last.y) < STROKE_PX) return;
      held.last = at;
      this.addPoint(at);
    },
    addPoint({ x, y }) {
      const found = shownAt(this.seen, this.pane, x, y);
      if (found?.longitude !== undefined) this.stroke = [...this.stroke, [found.longitude, found.latitude]];
    },
    letGo() {
      this.held = null;
      this.stroke = [];
    },
    up(event) {
      const held = this.held;
      if (this.stroke.length) this.$emit("stroke", { points: this.stroke });
      this.letGo();
      if (held && !held.moved) {
        const { x, y } = this.inPane(event);
        this.pick(x, y, event);
      }
    },
    pick(x, y, event) {
      const found = shownAt(this.seen, this.pane, x, y);
      if (found) this.$emit("pick", { ...found, ...this.modifiers(event) });
    },
    modifiers: (event) => ({ shift: event.shiftKey, ctrl: event.ctrlKey, alt: event.altKey, meta: event.metaKey }),

    // --- keyboard
    key(event) {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const step = event.shiftKey ? 1 : TURN_DEG;
      const actions = {
        ArrowLeft: () => this.turn(-step, 0),
        ArrowRight: () => this.turn(step, 0),
        ArrowUp: () => this.turn(0, step),
        ArrowDown: () => this.turn(0, -step),
        "+": () => this.enlarge(1.2),
        "=": () => this.enlarge(1.2),
        "-": () => this.enlarge(1 / 1.2),
        0: () => this.reset(),
        Enter: () => this.pick(this.pane.width / 2, this.pane.height / 2, event),
      };
      const action = actions[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    },
    wipeKey(event) {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.wipe = clamp(this.wipe + step, 0, 1);
    },
    wipeDown(event) {
      event.target.setPointerCapture(event.pointerId);
    },
    wipeMove(event) {
      if (!event.target.hasPointerCapture(event.pointerId)) return;
      const box = this.$refs.canvas.getBoundingClientRect();
      this.wipe = clamp((event.clientX - box.left) / box.width, 0, 1);
    },

    // --- handles
    grab(event, handle) {
      if (event.button !== 0) return;
      event.target.closest("button").setPointerCapture(event.pointerId);
      const { longitude, latitude } = handle.point;
      this.dragged = { handle: handle.handle, name: handle.name, longitude, latitude, start: { longitude, latitude }, aside: handle.aside };
      this.tell("start", event);
    },
    pull(event) {
      if (!this.dragged) return;
      const { x, y } = this.inPane(event);
      const found = shownAt(this.seen, this.pane, x - this.dragged.aside, y);
      if (!found || found.longitude === undefined) return;
      this.dragged = { ...this.dragged, longitude: found.longitude, latitude: found.latitude };
      this.tell("move", event);
    },
    release(event, phase = "end") {
      if (!this.dragged) return;
      this.tell(phase, event);
      this.dragged = null;
    },
    tell(phase, event, { handle, name, longitude, latitude, start, farther = 1 } = this.dragged) {
      const told = { phase, handle, name, longitude, latitude, start, farther, ...this.modifiers(event) };
      if (phase === "move") return this.events.later("drag", MOVE_MS, told);
      this.events.now("drag", told);
    },
    // An arrow key on a handle is a short drag of it.
    nudge(event, handle) {
      const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] || [];
      if (event.key === "Escape" && this.dragged) return event.preventDefault(), this.release(event, "cancel");
      if (right === undefined) return;
      event.preventDefault();
      const large = event.shiftKey ? 5 : 1;
      const start = { longitude: handle.point.longitude, latitude: handle.point.latitude };
      let end;
      if (handle.handle === "move") end = pointBeside(start, (large * 0.5 * Math.PI) / 180, right, up);
      else if (handle.handle === "turn") end = pointBeside(start, (handle.arm * large) / 90, right || up, 0);
      else {
        const arm = Math.atan(Math.tan(handle.arm) * 1.02 ** (large * (right || up))); // sizes go with tangents
        const middle = this.markers.find((marker) => marker.name === handle.name);
        end = pointBeside(middle, arm, 1, 1);
      }
      const told = { handle: handle.handle, name: handle.name, start, ...this.modifiers(event), shift: false };
      this.$emit("drag", { phase: "start", ...told, ...start });
      this.$emit("drag", { phase: "end", ...told, ...end });
    },
  },
};
