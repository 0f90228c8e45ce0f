// SPDX-License-Identifier: Apache-2.0
// What the viewer consists of; its behaviour is in viewer.js.

export const template = `
<div class="uw uw-viewer">
  <div class="uw-bar" role="toolbar" aria-label="View of the picture">
    <span class="uw-group" role="group" aria-label="Projection">
      <button type="button" :aria-pressed="!lookNow" @click="setMode(false)" title="The whole picture">Flat</button>
      <button type="button" :aria-pressed="lookNow" :disabled="!wraps" @click="setMode(true)"
        title="Look around: drag, wheel, arrow keys">Look around</button>
    </span>
    <span class="uw-group" role="group" aria-label="Size">
      <button type="button" @click="enlarge(1 / 1.25)" aria-label="Smaller">&minus;</button>
      <button type="button" @click="reset()" aria-label="Whole picture, or straight ahead">0</button>
      <button type="button" @click="enlarge(1.25)" aria-label="Larger">+</button>
    </span>
    <span class="uw-group" role="group" aria-label="Compare with a second picture">
      <button type="button" :aria-pressed="comparison === 'none'" @click="setCompare('none')">One</button>
      <button type="button" :aria-pressed="comparison === 'wipe'" :disabled="!second" @click="setCompare('wipe')"
        title="The second picture to the right of a divider">Wipe</button>
      <button type="button" :aria-pressed="comparison === 'side'" :disabled="!second" @click="setCompare('side')"
        title="Both pictures beside each other">Side by side</button>
      <button type="button" :disabled="shown.serial < 0" @click="snapshot('snapshot')"
        title="Keep this picture as the second one">Snapshot</button>
    </span>
    <button type="button" :aria-pressed="!bare" @click="hide" title="Show or hide marks and handles (H)">Marks</button>
    <span class="uw-where" aria-hidden="true">{{ where }}</span>
  </div>
  <div ref="stage" class="uw-stage">
    <canvas ref="canvas" tabindex="0" role="application"
      :aria-label="(shown.name || 'Picture') + '. Arrow keys turn the view, plus and minus change its size, 0 resets it, Enter picks its middle.'"
      @pointerdown="down" @pointermove="moved" @pointerup="up" @pointercancel="letGo" @pointerleave="pointed = null"
      @keydown="key"></canvas>
    <svg aria-hidden="true" :style="{ width: pane.width + 'px' }">
      <path v-for="(line, k) in horizonLines" :key="k" :d="line" fill="none" stroke="#000" stroke-opacity=".55" stroke-width="3" />
      <path v-for="(line, k) in horizonLines" :key="'w' + k" :d="line" fill="none" stroke="#67e8f9" stroke-width="1.4" stroke-dasharray="7 5" />
      <path v-for="(one, k) in drawnLines" :key="'d' + k" :d="one.path" class="uw-drawn-edge" />
      <path v-for="(one, k) in drawnLines" :key="'c' + k" :d="one.path" class="uw-drawn" :class="'uw-' + one.kind" />
    </svg>
    <button v-for="one in placed" :key="one.name" type="button" class="uw-mark"
      :class="['uw-' + one.kind, { 'uw-selected': one.name === selected }]" :style="one.at"
      :aria-label="one.label || one.name" :aria-pressed="one.name === selected" @click="$emit('select', { name: one.name })">
      <i></i><span>{{ one.label || one.name }}</span></button>
    <button v-for="one in handles" :key="one.handle" type="button" class="uw-mark uw-handle" :class="'uw-' + one.handle"
      :style="one.at" :aria-label="one.label + ': drag, or arrow keys'" :title="one.label"
      @pointerdown="grab($event, one)" @pointermove="pull" @pointerup="release($event)"
      @pointercancel="release($event, 'cancel')" @keydown="nudge($event, one)"><i>{{ one.sign }}</i></button>
    <template v-if="comparison === 'wipe' && second">
      <div class="uw-divider" role="slider" tabindex="0" aria-label="Divider of the two pictures" aria-valuemin="0"
        aria-valuemax="100" :aria-valuenow="Math.round(100 * wipe)" :style="{ left: 100 * wipe + '%' }"
        @keydown="wipeKey" @pointerdown="wipeDown" @pointermove="wipeMove"></div>
    </template>
    <div v-if="comparison === 'side'" class="uw-between"></div>
    <template v-if="comparison !== 'none' && second">
      <span class="uw-chip" style="left: 8px">{{ shown.name }}</span>
      <span class="uw-chip" style="right: 8px">{{ second }}</span>
    </template>
    <span v-if="badge" class="uw-badge" role="status">{{ badge }}</span>
    <span v-if="wrong" class="uw-badge uw-wrong" role="alert">{{ wrong }}</span>
  </div>
</div>`;
