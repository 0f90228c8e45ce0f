// SPDX-License-Identifier: Apache-2.0
// Events that come often: the first goes at once, then at most one in an interval, and the last in any case.

export class Throttle {
  constructor(emit) {
    [this.emit, this.waiting] = [emit, {}];
  }

  later(name, least_ms, told) {
    const one = (this.waiting[name] ??= { timer: null, told: null });
    if (one.timer) {
      one.told = told;
      return;
    }
    this.emit(name, told);
    one.timer = setTimeout(() => {
      const last = one.told;
      [one.timer, one.told] = [null, null];
      if (last) this.later(name, least_ms, last);
    }, least_ms);
  }

  // At once, in place of what waits under this name.
  now(name, told) {
    clearTimeout(this.waiting[name]?.timer);
    delete this.waiting[name];
    this.emit(name, told);
  }

  stop() {
    Object.values(this.waiting).forEach((one) => clearTimeout(one.timer));
  }
}
