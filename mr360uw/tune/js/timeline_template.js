// SPDX-License-Identifier: Apache-2.0
// What the time line consists of; its behaviour is in timeline.js.

export const template = `
<div class="uw uw-time" role="group" aria-label="Time line">
  <div class="uw-bar" role="toolbar" aria-label="Playing">
    <button type="button" :aria-pressed="playing" @click="play(!playing)" :aria-label="playing ? 'Pause' : 'Play'">
      {{ playing ? "\u275a\u275a" : "\u25b6" }}</button>
    <span class="uw-group" role="group" aria-label="Steps">
      <button type="button" @click="seek(start)" aria-label="To the in point">&#124;&#9664;</button>
      <button type="button" @click="seek(frame - 1)" aria-label="One frame back">&minus;1</button>
      <button type="button" @click="seek(frame + 1)" aria-label="One frame on">+1</button>
    </span>
    <span class="uw-group" role="group" aria-label="Range">
      <button type="button" @click="setRange(frame, stop)" title="Begin at this frame (I)">In</button>
      <button type="button" @click="setRange(start, frame + 1)" title="End with this frame (O)">Out</button>
      <button type="button" @click="setRange(0, count)" :disabled="start === 0 && stop === count">All</button>
    </span>
    <span aria-live="off">{{ rangeText }}</span>
    <span class="uw-where"><b>{{ timeText }}</b> &nbsp; frame {{ frame }} of {{ count }}</span>
  </div>
  <div ref="strip" class="uw-strip" role="slider" tabindex="0" aria-label="Play head" aria-valuemin="0"
    :aria-valuemax="count - 1" :aria-valuenow="frame" :aria-valuetext="timeText + ', frame ' + frame"
    @keydown="stripKey" @pointerdown="scrub" @pointermove="scrubMove" @pointerup="scrubEnd" @pointercancel="scrubEnd">
    <img v-for="(one, k) in thumbs" :key="k" :src="one.src" :style="one.style" alt="" draggable="false">
    <div v-for="[from, to] in played" :key="'p' + from" class="uw-played"
      :style="{ left: across(from) + '%', width: across(to - from) + '%' }"></div>
    <div class="uw-out" :style="{ left: 0, width: across(start) + '%' }"></div>
    <div class="uw-out" :style="{ left: across(stop) + '%', right: 0 }"></div>
    <div class="uw-head" :style="{ left: across(frame + 0.5) + '%' }"></div>
    <div v-for="edge in ['start', 'stop']" :key="edge" class="uw-edge" role="slider" tabindex="0"
      :aria-label="edge === 'start' ? 'In point' : 'Out point'" aria-valuemin="0" :aria-valuemax="count"
      :aria-valuenow="edge === 'start' ? start : stop" :style="{ left: across(edge === 'start' ? start : stop) + '%' }"
      @keydown="edgeKey($event, edge)" @pointerdown.stop="hold($event)" @pointermove.stop="edgeMove($event, edge)"
      @pointerup.stop="edgeEnd"></div>
  </div>
  <template v-if="curve">
    <div class="uw-bar" role="toolbar" :aria-label="'Keys of ' + curve.label">
      <b>{{ curve.label }}</b><span>{{ keysText }}</span>
      <button type="button" @click="addHere" title="At the play head, with the value it has there">Add key</button>
      <button type="button" @click="remove(chosen)" :disabled="chosen < 0">Remove key</button>
      <span class="uw-group" role="group" aria-label="Between keys">
        <button v-for="one in ['linear', 'smooth', 'hold']" :key="one" type="button" :aria-pressed="kind === one"
          @click="interpolate(one)">{{ one }}</button>
      </span>
      <span class="uw-where">{{ chosenText }}</span>
    </div>
    <svg ref="curve" class="uw-curve" :height="box.height" role="group" tabindex="-1"
      :aria-label="'Curve of ' + curve.label + '. Double click adds a key; arrow keys move one, Delete removes it.'"
      @dblclick="addAt">
      <g v-for="one in valueTicks" :key="'v' + one">
        <line class="uw-grid" :x1="box.left" :x2="box.width - box.right" :y1="y(one)" :y2="y(one)" />
        <text :x="box.left - 6" :y="y(one) + 4" text-anchor="end">{{ short(one) }}</text>
      </g>
      <g v-for="one in timeTicks" :key="'t' + one">
        <line class="uw-grid" :x1="x(one)" :x2="x(one)" :y1="box.top" :y2="box.height - box.bottom" />
        <text :x="x(one)" :y="box.height - 6" text-anchor="middle">{{ short(one) }} s</text>
      </g>
      <text x="4" y="12">{{ curve.unit }}</text>
      <path class="uw-line" :d="path" :stroke-dasharray="waiting ? '2 5' : null" />
      <rect class="uw-shade" :x="x(0)" :y="box.top" :width="Math.max(x(start / rate) - x(0), 0)" :height="box.height - box.top - box.bottom" />
      <rect class="uw-shade" :x="x(stop / rate)" :y="box.top" :width="Math.max(x(count / rate) - x(stop / rate), 0)" :height="box.height - box.top - box.bottom" />
      <line class="uw-now" :x1="x((frame + 0.5) / rate)" :x2="x((frame + 0.5) / rate)" :y1="box.top" :y2="box.height - box.bottom" />
      <circle v-for="(key, k) in keys" :key="k" class="uw-key" :class="{ 'uw-selected': k === chosen }" r="6.5"
        :cx="x(key[0])" :cy="y(key[1])" tabindex="0" role="button" :aria-pressed="k === chosen" :data-key="k"
        :aria-label="keyText(key)" @focus="chosen = k" @keydown="keyKey($event, k)" @dblclick.stop
        @pointerdown.stop="keyDown($event, k)" @pointermove="keyMove($event)" @pointerup="keyUp" @pointercancel="keyUp" />
    </svg>
  </template>
</div>`;
