// SPDX-License-Identifier: Apache-2.0
// Draws one or two pictures on a WebGL2 canvas, flat or around the viewer, with exact colours.
// Held to mr360uw/preview/live.py.

import { reachOf, rotationOf, spanOf } from "mr360uw-tune/projection.js";

const LARGEST_WIDTH = 4096; // of a texture; more is not seen on a screen and takes too long on weak GPUs

const VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D pictures[2];
uniform vec2 pane;       // size [px]
uniform float divider;   // column from which the second picture is shown
uniform bool side;       // whether the second picture has a pane of its own
uniform bool look, wraps;
uniform mat3 rotation;
uniform float reach;
uniform vec2 middle, span;
out vec4 color;
const float PI = 3.14159265358979;
void main() {
  vec2 place = vec2(gl_FragCoord.x, pane.y - gl_FragCoord.y);
  bool second = place.x >= divider;
  if (side && second) place.x -= pane.x;
  vec2 size = vec2(second ? textureSize(pictures[1], 0) : textureSize(pictures[0], 0));
  vec2 at;
  float texels;  // of the picture to a pixel
  if (look) {
    vec3 ray = vec3(reach * (2.0 * place.x / pane.x - 1.0), reach * (pane.y - 2.0 * place.y) / pane.x, -1.0);
    float pixel = 2.0 * reach / (pane.x * dot(ray, ray));  // [rad], along the narrower way
    ray = rotation * ray;
    at = vec2(atan(ray.x, -ray.z) / (2.0 * PI) + 0.5, 0.5 - atan(ray.y, length(ray.xz)) / PI);
    texels = pixel * size.y / PI;
  } else {
    at = middle + (place / pane - 0.5) * span;
    texels = max(span.x * size.x / pane.x, span.y * size.y / pane.y);
    bool beside = at.y < 0.0 || at.y > 1.0 || (wraps ? abs(at.x - middle.x) > 0.5 : at.x < 0.0 || at.x > 1.0);
    if (beside) { color = vec4(0.086, 0.094, 0.106, 1.0); return; }
  }
  float level = max(log2(texels), 0.0);
  vec3 seen = second ? textureLod(pictures[1], at, level).rgb : textureLod(pictures[0], at, level).rgb;
  color = vec4(seen, 1.0);
}`;

export class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    this.bitmaps = [null, null];
    this.wraps = [true, true];
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (this.gl) this.build();
  }

  get widest() {
    return Math.min(LARGEST_WIDTH, this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE));
  }

  // Makes all that the context holds; again after it was lost.
  build() {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      if (gl.isContextLost()) return;
      throw new Error(`viewer: ${gl.getProgramInfoLog(program)}`);
    }
    gl.useProgram(program);
    gl.bindVertexArray(gl.createVertexArray());
    this.at = (name) => gl.getUniformLocation(program, name);
    gl.uniform1iv(this.at("pictures"), [0, 1]);
    this.textures = [0, 1].map((unit) => {
      const texture = gl.createTexture();
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([22, 24, 27, 255]));
      return texture;
    });
    this.bitmaps.forEach((bitmap, unit) => bitmap && this.upload(unit, bitmap, this.wraps[unit]));
  }

  // Takes a picture (ImageBitmap) as the first (0) or the second (1); it is kept for a context that is lost.
  upload(unit, bitmap, wraps) {
    const gl = this.gl;
    [this.bitmaps[unit], this.wraps[unit]] = [bitmap, wraps];
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, this.textures[unit]);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wraps ? gl.REPEAT : gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  // Fetches a picture as it is stored: no colour space is converted, alpha is left alone.
  async load(url) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
    const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
    const blob = await answer.blob();
    const bitmap = await createImageBitmap(blob, options);
    if (bitmap.width <= this.widest) return bitmap;
    const small = await createImageBitmap(blob, { ...options, resizeWidth: this.widest, resizeQuality: "high" });
    bitmap.close();
    return small;
  }

  // pane: as in projection.js, in pixels of the canvas. divider: fraction of the canvas from which on the second
  // picture is shown. side: whether it has a pane of its own.
  draw(view, pane, divider, side) {
    const gl = this.gl;
    if (!gl || gl.isContextLost()) return;
    const { width, height } = this.canvas;
    gl.viewport(0, 0, width, height);
    gl.uniform2f(this.at("pane"), pane.width, pane.height);
    gl.uniform1f(this.at("divider"), divider * width);
    gl.uniform1i(this.at("side"), side);
    gl.uniform1i(this.at("look"), view.look);
    gl.uniform1i(this.at("wraps"), pane.wraps);
    gl.uniformMatrix3fv(this.at("rotation"), true, rotationOf(view).flat());
    gl.uniform1f(this.at("reach"), reachOf(view));
    gl.uniform2f(this.at("middle"), view.u, view.v);
    gl.uniform2fv(this.at("span"), spanOf(view, pane));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
