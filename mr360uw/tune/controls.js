// The controls of all parameters, drawn from their descriptions. Held to tune/fields.py.
//
// spec: the tables and fields. begin, and `take` from then on: tree, the values that the scene file sets; errors and
// texts, by dotted key; keyed, the values now of the parameters that have keys; words, the present places and sizes of objects in all words for
// them; chosen, the number of the object with handles; hidden, the words that the file says in others; idle, why parameters have no effect. Emits: change {key, value, group}, reset {key, default}, add {key,
// table}, remove {key}, mark {key}, settle {} at the end of a drag.

const PAUSE_MS = 25; // between two changes of one drag that are sent

// What is new, with the old objects where nothing in them changed: what is typed into a control stays while others change.
const settled = (old, now) => {
  if (JSON.stringify(old) === JSON.stringify(now)) return old;
  if (Array.isArray(now)) return now.map((one, k) => settled(old?.[k], one));
  if (!now || typeof now !== "object") return now;
  return Object.fromEntries(Object.entries(now).map(([key, one]) => [key, settled(old?.[key], one)]));
};

const wordsOf = (...texts) => texts.join(" ").toLowerCase().split(/[^\p{L}\d]+/u).filter(Boolean).map((word) => (word.length > 3 ? word.replace(/s$/, "") : word));

// How well one word fits: 8 one of these words, 6 a beginning of one, 0 neither.
const fit = (word, words) => (words.includes(word) ? 8 : words.some((one) => one.startsWith(word)) ? 6 : 0);

const [BEST, CLEAR] = [3, 3]; // controls that a search shows before all others, and their least fit for each word

const Control = {
  props: ["field", "path", "value", "error", "text", "key_state", "present", "idle", "of"],
  emits: ["change", "reset", "mark", "settle"],
  data: () => ({ held: null, group: 0, timer: null, next: null }),
  watch: {
    value() {
      if (!this.group) this.held = null;
    },
  },
  computed: {
    id() {
      return "control-" + this.path.replaceAll(".", "-");
    },
    isSet() {
      return this.value !== undefined;
    },
    shown() {
      if (this.held !== null) return this.held;
      return this.isSet ? this.value : this.present ?? this.field.default;
    },
    position() {
      const value = typeof this.shown === "number" ? this.shown : this.middle;
      const [low, high] = this.field.span;
      const at = Math.min(Math.max(value, low), high);
      return this.field.logarithmic ? Math.log(at / low) / Math.log(high / low) : (at - low) / (high - low);
    },
    middle() {
      const [low, high] = this.field.span;
      return this.field.logarithmic ? Math.sqrt(low * high) : 0.5 * (low + high);
    },
    hex() {
      const channel = (v) => {
        const c = Math.min(Math.max(v, 0), 1);
        const code = c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055;
        return Math.round(255 * code).toString(16).padStart(2, "0");
      };
      return "#" + (this.shown || [1, 1, 1]).map(channel).join("");
    },
    choice() {
      return this.isSet ? JSON.stringify(this.value) : "";
    },
    described() {
      return this.id + "-help" + (this.error ? " " + this.id + "-error" : "") + (this.idle ? " " + this.id + "-idle" : "");
    },
    title() {
      return [this.field.help, this.field.bounds && "[" + this.field.bounds + "]"].filter(Boolean).join(" ");
    },
  },
  methods: {
    // the value at a position of the slider, as Field.value_at gives it
    valueAt(position) {
      const [low, high] = this.field.span;
      const log = this.field.logarithmic;
      const value = log ? low * (high / low) ** position : low + (high - low) * position;
      if (this.field.kind === "integer") return Math.round(value);
      if (!value) return 0;
      const digits = log ? 2 - Math.floor(Math.log10(Math.abs(value))) : 1 - Math.floor(Math.log10(this.field.step));
      return Number(value.toFixed(Math.min(Math.max(digits, 0), 12)));
    },
    drag(value) {
      if (!this.group) this.group = Date.now();
      this.held = value;
      this.next = value;
      this.timer ??= setTimeout(this.send, PAUSE_MS);
    },
    send() {
      clearTimeout(this.timer);
      this.timer = null;
      if (this.next === null) return;
      this.$emit("change", { key: this.path, value: this.next, group: String(this.group) });
      this.next = null;
    },
    release() {
      this.send();
      this.group = 0;
      this.$emit("settle", {});
    },
    put(value) {
      this.held = value;
      this.$emit("change", { key: this.path, value, group: null });
    },
    number(text) {
      if (text.trim() === "") return this.$emit("reset", { key: this.path });
      const value = Number(text);
      this.put(this.field.kind === "integer" ? Math.trunc(value) : value);
    },
    component(k, text, dragged) {
      const value = [...(this.shown || Array(this.field.length).fill(0))];
      value[k] = Number(text);
      dragged ? this.drag(value) : this.put(value);
    },
    colour(hex) {
      const linear = (code) => (code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4);
      this.drag([1, 3, 5].map((k) => Number(linear(parseInt(hex.slice(k, k + 2), 16) / 255).toFixed(4))));
    },
    choose(text) {
      text === "" ? this.$emit("reset", { key: this.path }) : this.put(JSON.parse(text));
    },
    words(value) {
      return value === null || value === undefined ? "none" : value === true ? "yes" : value === false ? "no" : value;
    },
  },
  template: `
    <div class="control" :class="{changed: isSet, wrong: error, idle}" :data-key="path">
      <div class="control-head">
        <span v-if="of" class="muted">{{ of }}&nbsp;</span>
        <label :for="id" :title="title">{{ field.label }}</label>
        <span v-if="isSet" class="mark" role="img" aria-label="changed" title="set in the scene file"></span>
        <span class="grow"></span>
        <button v-if="field.changes" type="button" class="quiet key" :class="{on: key_state}" @click="$emit('mark', {key: path})"
          :aria-label="'key ' + field.label + ' at this time'" title="key this parameter at this time">◆</button>
        <button v-if="isSet && !field.required" type="button" class="quiet reset" @click="held = null; $emit('reset', {key: path})"
          :aria-label="'reset ' + field.label" :title="'back to the default: ' + words(field.default)">↺</button>
      </div>
      <div class="control-body">
        <template v-if="field.kind === 'number' || field.kind === 'integer'">
          <input type="range" min="0" max="1" step="0.001" :value="position" :aria-label="field.label + ', slider'"
            :aria-valuetext="words(shown) + ' ' + field.unit" @input="drag(valueAt(Number($event.target.value)))" @change="release">
          <input :id="id" type="number" :value="shown" :step="field.step" :placeholder="words(shown)" :aria-describedby="described"
            :aria-invalid="!!error" @change="number($event.target.value)">
          <span class="unit">{{ field.unit }}</span>
        </template>
        <template v-else-if="field.kind === 'vector'">
          <input v-for="k in field.length" :id="k === 1 ? id : null" type="number" :step="field.step" :value="shown ? shown[k - 1] : ''"
            :aria-label="field.label + ', ' + k" :aria-describedby="described" :aria-invalid="!!error"
            @change="component(k - 1, $event.target.value)">
          <span class="unit">{{ field.unit }}</span>
        </template>
        <template v-else-if="field.kind === 'colour'">
          <input :id="id" type="color" :value="hex" :aria-describedby="described" @input="colour($event.target.value)" @change="release">
          <input v-for="k in 3" type="number" step="0.01" :value="shown ? shown[k - 1] : ''" :aria-label="field.label + ', ' + 'red green blue'.split(' ')[k - 1]"
            :aria-invalid="!!error" @change="component(k - 1, $event.target.value)">
        </template>
        <input v-else-if="field.kind === 'switch' && !field.optional" :id="id" type="checkbox" role="switch" :checked="shown"
          :aria-describedby="described" @change="put($event.target.checked)">
        <select v-else-if="field.kind === 'choice' || field.kind === 'switch'" :id="id" :value="choice" :aria-describedby="described"
          :aria-invalid="!!error" @change="choose($event.target.value)">
          <option v-if="!field.required" value="">{{ words(field.default) }} (default)</option>
          <option v-for="one in field.choices" :value="JSON.stringify(one)">{{ words(one) }}</option>
          <option v-if="isSet && !field.choices.includes(value)" :value="choice">{{ value }}</option>
        </select>
        <input v-else :id="id" type="text" spellcheck="false" :value="field.kind === 'toml' ? text : shown" :placeholder="field.default_text || 'none'"
          :aria-describedby="described" :aria-invalid="!!error" @change="put($event.target.value)">
      </div>
      <p :id="id + '-help'" class="help">{{ title }}</p>
      <p v-if="idle" :id="id + '-idle'" class="why">{{ idle }}</p>
      <p v-if="error" :id="id + '-error'" class="error" role="alert">{{ error }}</p>
    </div>`,
};

export default {
  components: { Control },
  props: ["spec", "first", "begin"],
  emits: ["change", "reset", "add", "remove", "mark", "choose", "settle"],
  data() {
    return { search: "", all: false, open: {}, entry: {}, adding: {}, now: this.begin };
  },
  computed: {
    tree() {
      return this.now.tree;
    },
    wanted() {
      return wordsOf(this.search);
    },
    // What a search finds, the best first: buttons of the page, and parameters; of those that fit alike the first ones lead
    actions() {
      const buttons = this.wanted.length ? [...document.querySelectorAll(".page-header button, .stage-bar button")] : [];
      return buttons.filter((one) => one.offsetParent && this.wanted.every((word) => fit(word, wordsOf(one.textContent, one.ariaLabel, one.dataset.words))));
    },
    every() {
      return this.spec.flatMap((group) => this.fields(group).map((field) => ({ group, field, fit: this.fitOf(group, field), name: `${group.key}.${field.key}` })));
    },
    found() {
      return this.every.filter((one) => one.fit).sort((a, b) => b.fit - a.fit);
    },
    shortlist() {
      const there = ({ group }) => !group.repeated || this.count(group) > 0;
      if (this.wanted.length) return this.found.filter((one) => there(one) && one.fit >= CLEAR * this.wanted.length).slice(0, BEST);
      const firsts = this.all ? [] : this.first.map((name) => this.every.find((one) => one.name === name));
      return firsts.filter((one) => one && there(one) && !this.now.hidden.includes(this.path(one.group, one.field)));
    },
    groups() {
      const rest = this.wanted.length ? this.found.filter((one) => !this.shortlist.includes(one)) : this.all ? this.every : [];
      return [...new Set(rest.map((one) => one.group))].map((group) => ({ group, fields: rest.filter((one) => one.group === group).map((one) => one.field) }));
    },
  },
  methods: {
    take(now) {
      if (now.chosen !== this.now.chosen) this.entry = { ...this.entry, object: now.chosen };
      this.now = settled(this.now, now);
    },
    fields(group) {
      const tag = group.tag && this.tree[group.key]?.[group.tag];
      return group.kinds[tag] || Object.values(group.kinds)[0];
    },
    // By a parameter's own words, by those of its table with half the weight, else anywhere; 0 where a word is missing.
    fitOf(group, field) {
      const [own, table] = [wordsOf(field.key, field.label, field.everyday), wordsOf(group.key, group.title, group.everyday)];
      const text = [...own, ...table, ...wordsOf(field.help, group.help)].join(" ");
      const fits = this.wanted.map((word) => Math.max(fit(word, own), fit(word, table) / 2, text.includes(word) ? 1 : 0));
      const first = this.first.includes(`${group.key}.${field.key}`) ? 1 : 0;
      return fits.length && Math.min(...fits) && fits.reduce((sum, one) => sum + one, first);
    },
    count(group) {
      return (this.tree[group.key] || []).length;
    },
    at(group) {
      return Math.min(this.entry[group.key] || 0, Math.max(this.count(group) - 1, 0));
    },
    table(group) {
      const table = this.tree[group.key];
      if (group.repeated) return (table || [])[this.at(group)];
      return typeof table === "string" ? { path: table } : table;
    },
    path(group, field) {
      return group.repeated ? `${group.key}.${this.at(group)}.${field.key}` : `${group.key}.${field.key}`;
    },
    value(group, field) {
      const now = this.now.keyed[this.path(group, field)];
      return now !== undefined ? now : (this.table(group) || {})[field.key];
    },
    bound(group, field) {
      const path = this.path(group, field);
      const { errors, texts, keyed, words, idle } = this.now;
      return { field, path, value: this.value(group, field), error: errors[path], text: texts[path], key_state: path in keyed, present: words[path], idle: idle[path] };
    },
    isOpen(group) {
      return this.wanted.length > 0 || !!this.open[group.key];
    },
    name(group, k) {
      const table = this.tree[group.key][k];
      const file = String(table.mesh || table.path || table.kind || table.parameter || "");
      return `${k + 1} ${file.split(/[\\/]/).pop()}`;
    },
    select(group, k) {
      this.entry = { ...this.entry, [group.key]: k };
      this.$emit("choose", { key: group.key, number: k });
    },
    needed(group) {
      return this.fields(group).find((field) => field.required && field.kind === "path");
    },
    add(group) {
      const needed = this.needed(group);
      const given = this.adding[group.key] || (this.table(group) || {})[needed?.key] || "";
      this.$emit("add", { key: group.key, table: needed ? { [needed.key]: given } : {} });
      this.adding = { ...this.adding, [group.key]: "" };
      this.select(group, this.count(group));
    },
  },
  template: `
    <section class="controls" aria-label="Parameters">
      <div class="controls-head">
        <input v-model="search" type="search" placeholder="Search parameters" aria-label="Search parameters">
        <div class="segments" role="group" aria-label="Which parameters">
          <button type="button" :aria-pressed="!all" @click="all = false">First</button>
          <button type="button" :aria-pressed="all" @click="all = true">All</button>
        </div>
      </div>
      <div class="controls-list" tabindex="-1">
        <div v-if="actions.length" class="entries">
          <button v-for="one in actions" type="button" class="action" :title="one.title" @click="one.click()">{{ one.textContent }}</button>
        </div>
        <Control v-for="{group, field} in shortlist" :key="path(group, field)" v-bind="bound(group, field)" :of="wanted.length ? group.title : ''"
          @change="$emit('change', $event)" @reset="$emit('reset', $event)" @mark="$emit('mark', $event)" @settle="$emit('settle', $event)"></Control>
        <details v-for="{group, fields} in groups" :key="group.key" class="group" :open="isOpen(group)" :data-group="group.key">
          <summary @click.prevent="open = {...open, [group.key]: !open[group.key]}">
            {{ group.title }}<span class="count" v-if="group.repeated">{{ count(group) }}</span>
            <span class="count" v-else-if="group.optional && !table(group)">off</span>
          </summary>
          <template v-if="isOpen(group)">
            <p class="group-help">{{ group.help }}</p>
            <div v-if="group.repeated" class="entries" role="group" :aria-label="group.title">
              <button v-for="(one, k) in tree[group.key] || []" type="button" :aria-pressed="k === at(group)" @click="select(group, k)">{{ name(group, k) }}</button>
              <input v-if="needed(group)" type="text" spellcheck="false" :value="adding[group.key]" :placeholder="needed(group).label + (count(group) ? ': the same' : '')"
                :aria-label="needed(group).label + ' of a new entry'" @input="adding = {...adding, [group.key]: $event.target.value}">
              <button type="button" class="quiet add" @click="add(group)" :aria-label="'add to ' + group.title" title="add">+</button>
              <button v-if="count(group)" type="button" class="quiet remove" @click="$emit('remove', {key: group.key + '.' + at(group)})"
                :aria-label="'remove from ' + group.title" title="remove the chosen one">−</button>
            </div>
            <div v-if="group.optional" class="entries">
              <button v-if="!table(group)" type="button" @click="$emit('change', {key: group.key, value: {}, group: null})">Add to the scene</button>
              <button v-else type="button" @click="$emit('remove', {key: group.key})">Remove from the scene</button>
            </div>
            <template v-if="!group.repeated || count(group)">
              <Control v-for="field in fields" :key="path(group, field)" v-bind="bound(group, field)"
                @change="$emit('change', $event)" @reset="$emit('reset', $event)" @mark="$emit('mark', $event)" @settle="$emit('settle', $event)"></Control>
            </template>
          </template>
        </details>
        <p v-if="wanted.length && !found.length && !actions.length" class="group-help">No parameter has these words.</p>
      </div>
    </section>`,
};
