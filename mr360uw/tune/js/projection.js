// SPDX-License-Identifier: Apache-2.0
// Projections of a picture onto a pane of the canvas, and back.
// Twins: mr360uw/preview/live.py (look-around) and mr360uw/sphere.py (longitude, latitude).
//
// view: { look: bool, yaw, pitch, fov [deg] of a look-around; u, v, zoom of a flat picture: its middle as fractions
// of the picture from the top left, and how often it is enlarged from where all of it fits }.
// pane: { width, height [px], aspect: height over width of the picture, wraps: whether it is a panorama }.

const DEGREE = Math.PI / 180;

export const directionOf = ({ longitude, latitude }) => [
  Math.cos(latitude) * Math.sin(longitude),
  Math.sin(latitude),
  -Math.cos(latitude) * Math.cos(longitude),
];

export const pointOf = ([x, y, z]) => ({ longitude: Math.atan2(x, -z), latitude: Math.atan2(y, Math.hypot(x, z)) });

// Point at an angle from another [rad], towards `right` and `up` as seen from the camera (not both 0).
export function pointBeside(center, angle, right, up) {
  const { longitude, latitude } = center;
  const c = directionOf(center);
  const r = [Math.cos(longitude), 0, Math.sin(longitude)];
  const u = [-Math.sin(latitude) * Math.sin(longitude), Math.cos(latitude), Math.sin(latitude) * Math.cos(longitude)];
  const length = Math.hypot(right, up);
  const across = r.map((value, k) => (right * value + up * u[k]) / length);
  return pointOf(c.map((value, k) => Math.cos(angle) * value + Math.sin(angle) * across[k]));
}

export const reachOf = (view) => Math.tan(0.5 * view.fov * DEGREE);

// Rows of the rotation from the view's axes to the panorama's: pitch, then yaw.
export function rotationOf(view) {
  const [c, s] = [Math.cos(view.yaw * DEGREE), Math.sin(view.yaw * DEGREE)];
  const [p, q] = [Math.cos(view.pitch * DEGREE), Math.sin(view.pitch * DEGREE)];
  return [
    [c, -s * q, -s * p],
    [0, p, -q],
    [s, c * q, c * p],
  ];
}

// Fractions of a flat picture that the pane spans across and down.
export function spanOf(view, pane) {
  const scale = view.zoom * Math.min(pane.width, pane.height / pane.aspect);
  return [pane.width / scale, pane.height / (scale * pane.aspect)];
}

// What continuous coordinates of a pane show: { u, v } of the picture and, of a panorama, { longitude, latitude };
// null beside the picture.
export function shownAt(view, pane, x, y) {
  if (view.look) {
    const reach = reachOf(view);
    const ray = [reach * ((2 * x) / pane.width - 1), (reach * (pane.height - 2 * y)) / pane.width, -1];
    const point = pointOf(rotationOf(view).map((row) => row[0] * ray[0] + row[1] * ray[1] + row[2] * ray[2]));
    return { ...point, u: point.longitude / (2 * Math.PI) + 0.5, v: 0.5 - point.latitude / Math.PI };
  }
  const [across, down] = spanOf(view, pane);
  let u = view.u + (x / pane.width - 0.5) * across;
  const v = view.v + (y / pane.height - 0.5) * down;
  if (v < 0 || v > 1 || Math.abs(u - view.u) > 0.5 + 1e-12) return null;
  if (!pane.wraps) return u < 0 || u > 1 ? null : { u, v };
  u -= Math.floor(u);
  return { u, v, longitude: 2 * Math.PI * (u - 0.5), latitude: Math.PI * (0.5 - v) };
}

// Continuous coordinates { x, y } of a pane that show a point of a panorama; null behind the view.
export function coordinatesOf(view, pane, point) {
  if (view.look) {
    const d = directionOf(point);
    const rows = rotationOf(view);
    const [x, y, z] = [0, 1, 2].map((k) => rows[0][k] * d[0] + rows[1][k] * d[1] + rows[2][k] * d[2]);
    if (z >= -1e-6) return null;
    const scale = (0.5 * pane.width) / (-z * reachOf(view));
    return { x: 0.5 * pane.width + scale * x, y: 0.5 * pane.height - scale * y };
  }
  const [across, down] = spanOf(view, pane);
  let away = point.longitude / (2 * Math.PI) + 0.5 - view.u;
  away -= Math.round(away);
  const v = 0.5 - point.latitude / Math.PI;
  return { x: pane.width * (0.5 + away / across), y: pane.height * (0.5 + (v - view.v) / down) };
}

// Pixels of the pane to a radian, about a point.
export function pixelsPerRadian(view, pane, point) {
  const step = 1e-3;
  const here = coordinatesOf(view, pane, point);
  const there = here && coordinatesOf(view, pane, pointBeside(point, step, 0, point.latitude > 0 ? -1 : 1));
  return there ? Math.max(Math.hypot(there.x - here.x, there.y - here.y) / step, 1) : 1;
}
