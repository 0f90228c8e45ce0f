// SPDX-License-Identifier: Apache-2.0
// Looks of the viewer and the time line, light and dark.

const TEXT = `
.uw { --uw-back: #f4f6f8; --uw-panel: #ffffff; --uw-line: #c3ccd5; --uw-text: #16202a; --uw-soft: #52606d;
  --uw-accent: #0b6e99; --uw-warm: #b45309; --uw-focus: #0369a1;
  font: 13px/1.4 system-ui, sans-serif; color: var(--uw-text); }
.body--dark .uw { --uw-back: #14181d; --uw-panel: #1e242b; --uw-line: #3a444f; --uw-text: #e6edf3; --uw-soft: #9fb0c0;
  --uw-accent: #38bdf8; --uw-warm: #fbbf24; --uw-focus: #7dd3fc; }
.uw :focus-visible { outline: 2px solid var(--uw-focus); outline-offset: 2px; }
.uw-bar button { font: inherit; color: inherit; background: none; border: 1px solid var(--uw-line); border-radius: 4px;
  padding: 2px 9px; min-height: 26px; cursor: pointer; }
.uw-bar button:hover { border-color: var(--uw-accent); }
.uw-bar button[aria-pressed="true"] { background: var(--uw-accent); border-color: var(--uw-accent); color: #fff; }
.body--dark .uw-bar button[aria-pressed="true"] { color: #06202e; }
.uw-bar button:disabled { opacity: 0.45; cursor: default; }

.uw-viewer { display: flex; flex-direction: column; width: 100%; height: 100%; min-height: 160px; }
.uw-bar { display: flex; flex-wrap: wrap; gap: 6px 14px; align-items: center; padding: 5px 8px;
  background: var(--uw-panel); border-bottom: 1px solid var(--uw-line); }
.uw-group { display: inline-flex; }
.uw-group button + button { margin-left: -1px; }
.uw-group button { border-radius: 0; }
.uw-group button:first-child { border-radius: 4px 0 0 4px; }
.uw-group button:last-child { border-radius: 0 4px 4px 0; }
/* its room is kept while it is empty: a bar that grew would move the picture under the pointer */
.uw-where { margin-left: auto; min-width: 176px; min-height: 1.4em; text-align: right; color: var(--uw-soft); font-variant-numeric: tabular-nums; white-space: nowrap; }
@media (max-width: 600px) {
  .uw-viewer .uw-bar { flex-wrap: nowrap; overflow-x: auto; }
  .uw-viewer .uw-bar > * { flex: none; }
  .uw-viewer .uw-where { display: none; }
}
.uw-stage { position: relative; flex: 1 1 0; min-height: 0; overflow: hidden; background: #16181b; }
.uw-stage canvas { position: absolute; inset: 0; width: 100%; height: 100%; touch-action: none; cursor: crosshair; }
.uw-stage canvas:focus-visible { outline-offset: -2px; }
.uw-stage svg { position: absolute; inset: 0; height: 100%; pointer-events: none; }
.uw-stage svg .uw-drawn-edge { fill: none; stroke: #000; stroke-opacity: .6; stroke-width: 5; stroke-linecap: round; stroke-linejoin: round; }
.uw-stage svg .uw-drawn { fill: none; stroke: #f472b6; stroke-width: 3; stroke-linecap: round; stroke-linejoin: round; }
.uw-stage svg .uw-drawn.uw-inside { stroke: #4ade80; }
.uw-stage svg .uw-drawn.uw-outside { stroke: #f87171; }
.uw-stage svg .uw-drawn.uw-matte { stroke: #fff; stroke-width: 2; }
.uw-between { position: absolute; top: 0; bottom: 0; left: calc(50% - 1px); width: 2px; background: #fff; }
.uw-stage .uw-chip { position: absolute; bottom: 8px; padding: 2px 8px; border-radius: 4px; pointer-events: none;
  background: rgb(10 14 18 / 0.72); color: #f1f5f9; }
.uw-badge { position: absolute; top: 10px; left: 50%; transform: translateX(-50%); padding: 3px 12px;
  border-radius: 12px; background: #fbbf24; color: #1c1403; font-weight: 600; pointer-events: none; z-index: 4; }
.uw-badge.uw-wrong { background: #b91c1c; color: #fff; }
.uw-stage .uw-divider { position: absolute; top: 0; bottom: 0; width: 17px; margin-left: -8.5px; cursor: ew-resize;
  touch-action: none; z-index: 2; }
.uw-divider::before { content: ""; position: absolute; left: 7.5px; width: 2px; top: 0; bottom: 0; background: #fff;
  box-shadow: 0 0 3px #000; }
.uw-divider::after { content: "\\2194"; position: absolute; left: -3px; top: calc(50% - 12px); width: 23px; height: 23px;
  line-height: 21px; text-align: center; border-radius: 50%; background: #fff; color: #16202a;
  box-shadow: 0 0 3px #000; }
.uw-mark { position: absolute; padding: 0; border: 0; border-radius: 10px; background: none; color: #fff; font: inherit;
  cursor: pointer;
  transform: translate(-9px, -9px); display: flex; align-items: center; gap: 5px; white-space: nowrap; z-index: 1;
  text-shadow: 0 0 3px #000, 0 0 2px #000, 0 0 1px #000; touch-action: none; }
.uw-mark span { pointer-events: none; }
.uw-mark i { display: block; box-sizing: border-box; width: 18px; height: 18px; border: 2px solid #fff;
  border-radius: 50%; box-shadow: 0 0 0 1px #000, inset 0 0 0 1px #000; }
.uw-mark.uw-sun i { background: #facc15; border-style: dotted; }
.uw-mark.uw-lamp i { background: #fb923c; border-radius: 3px; transform: scale(0.8) rotate(45deg); }
.uw-mark.uw-spot i { border-radius: 0; transform: scale(0.7); background: #f472b6; }
.uw-mark.uw-selected i { border-color: #22d3ee; background: rgb(34 211 238 / 0.35); }
.uw-mark.uw-handle { z-index: 3; cursor: grab; }
.uw-mark.uw-handle i { border-color: #22d3ee; background: #083344; color: #a5f3fc; font-size: 13px; line-height: 15px;
  font-style: normal; text-align: center; text-shadow: none; width: 20px; height: 20px; }
.uw-handle.uw-move { cursor: move; }

.uw-time { display: flex; flex-direction: column; width: 100%; background: var(--uw-panel);
  border-top: 1px solid var(--uw-line); }
.uw-time .uw-where { font-size: 13px; color: var(--uw-text); }
.uw-strip { position: relative; height: 56px; background: var(--uw-back); touch-action: none;
  cursor: pointer; margin: 0 22px 0 64px; }
.uw-strip:focus-visible, .uw-curve:focus-visible { outline-offset: -2px; }
.uw-strip img { position: absolute; top: 0; height: 100%; object-fit: cover; pointer-events: none; user-select: none; }
.uw-strip .uw-played { position: absolute; bottom: 0; height: 3px; background: #22c55e; pointer-events: none; }
.uw-strip .uw-out { position: absolute; top: 0; bottom: 0; background: var(--uw-back); opacity: 0.72;
  pointer-events: none; }
.uw-strip .uw-edge { position: absolute; top: 0; bottom: 0; width: 13px; margin-left: -6.5px; cursor: ew-resize;
  touch-action: none; }
.uw-edge::before { content: ""; position: absolute; inset: 0 4.5px; background: var(--uw-warm); border-radius: 2px; }
.uw-head { position: absolute; top: 0; bottom: 0; width: 2px; margin-left: -1px; background: #e11d48;
  box-shadow: 0 0 0 1px rgb(255 255 255 / 0.7); pointer-events: none; }
.uw-curve { display: block; width: 100%; touch-action: none; background: var(--uw-panel); }
.uw-curve text { fill: var(--uw-soft); font-size: 11px; font-variant-numeric: tabular-nums; user-select: none; }
.uw-curve .uw-grid { stroke: var(--uw-line); stroke-width: 1; }
.uw-curve .uw-line { fill: none; stroke: var(--uw-accent); stroke-width: 2; }
.uw-curve .uw-now { stroke: #e11d48; stroke-width: 1.5; }
.uw-curve .uw-shade { fill: var(--uw-back); opacity: 0.72; }
.uw-key { fill: var(--uw-panel); stroke: var(--uw-accent); stroke-width: 2; cursor: grab; outline-offset: 3px; }
.uw-key.uw-selected { fill: var(--uw-accent); }
`;

export function addStyle() {
  if (document.getElementById("uw-style")) return;
  const element = document.createElement("style");
  element.id = "uw-style";
  element.textContent = TEXT;
  document.head.append(element);
}
