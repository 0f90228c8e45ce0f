// Chroma codes of a tile over the plate, from the steps of its pixels. Held to video/pixels/kernels.py
#include "composite/gl/shaders/plate.glsl"
uniform usampler2D u_codes, v_codes;
uniform sampler2D steps;     // of plate_luma.frag
uniform ivec2 corner, size;  // of the tile: column and row, columns and rows
uniform bool wrap;
uniform int frame;
uniform float peak;
layout(location = 0) out uint u;
layout(location = 1) out uint v;

// Sum of a column's steps over the rows of a block that lie in the tile.
vec4 down(int column, int row) {
    vec4 sum = vec4(0.0);
    if (column < 0 || column >= size.x) return sum;
    for (int r = max(row, 0); r < min(row + 1 + SY, size.y); ++r) sum += texelFetch(steps, ivec2(column, r), 0);
    return sum;
}

float across(usampler2D plane, ivec3 columns, int row) {
    return code_at(plane, columns.x, row) + 6.0 * code_at(plane, columns.y, row) + code_at(plane, columns.z, row);
}

// What interpolation and filter lose of a code: the code less its blur [1 6 1]/8.
float lost_detail(usampler2D plane, ivec2 at) {
    ivec2 extent = textureSize(plane, 0);
    int left = at.x > 0 ? at.x - 1 : wrap ? extent.x - 1 : 0;
    int right = at.x + 1 < extent.x ? at.x + 1 : wrap ? 0 : at.x;
    ivec3 columns = ivec3(left, at.x, right);
    float blur = across(plane, columns, at.y);
    if (SY == 1) {
        float above = across(plane, columns, max(at.y - 1, 0));
        blur = (above + 6.0 * blur + across(plane, columns, min(at.y + 1, extent.y - 1))) / 8.0;
    }
    return code_at(plane, at.x, at.y) - blur / 8.0;
}

void main() {
    ivec2 at = ivec2(corner.x >> SX, corner.y >> SY) + ivec2(gl_FragCoord.xy);
    int column = (at.x << SX) - corner.x, row = (at.y << SY) - corner.y;
    u = texelFetch(u_codes, at, 0).r;
    v = texelFetch(v_codes, at, 0).r;
    vec4 middle = down(column, row), beside = SX == 1 ? down(column + 1, row) : vec4(0.0);
    if (middle.w == 0.0 && beside.w == 0.0) return;
    // the column left of the tile is taken to change like its first one
    if (SX == 1) middle = down(column > 0 ? column - 1 : column, row) + 2.0 * middle + beside;
    vec3 change = middle.xyz / float((1 + 3 * SX) * (1 + SY));
    vec2 code = vec2(u, v) + change.xy;
    if (SX == 1 && change.z > 0.0) code -= change.z * vec2(lost_detail(u_codes, at), lost_detail(v_codes, at));
    u = quantised(code.x, dither(at + ivec2(59, 17), frame), peak);
    v = quantised(code.y, dither(at + ivec2(31, 101), frame), peak);
}
