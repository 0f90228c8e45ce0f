// SPDX-License-Identifier: Apache-2.0
// Axes: values at round steps, and numbers as short as their step allows.

export function ticks(low, high, most) {
  const rough = (high - low) / Math.max(most, 1);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) found.push(k * step);
  return found;
}

export const short = (value) => String(Number(value.toPrecision(4))).replace("-", "\u2212");
