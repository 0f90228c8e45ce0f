// Height and slopes of the surface over places (x, z) instead of rest positions: one level of the atlas, with a border
// of one texel from its other side. Held to surface/spline.py
#include "particles.glsl"

uniform sampler2D coefficients;
uniform int first_row, points;
uniform float tile_m, top;

layout(location = 0) out vec4 height;
layout(location = 1) out vec4 shift;

const int MOST_STEPS = 8;
const float CLOSE = 0.02;  // points: the rest is linear

void main() {
    float per_m = float(points) / tile_m;
    vec2 place = gl_FragCoord.xy - vec2(0.5, top + 0.5) - 1.0;
    vec2 rest = place - per_m * nearest_shift(coefficients, first_row, points, place);
    rest = place - per_m * nearest_shift(coefficients, first_row, points, rest);
    Displacement d;
    vec2 off;
    float across;
    int step = 0;
    bool close;
    do {
        d = displacement(coefficients, first_row, points, per_m, rest);
        off = rest + d.value.yz * per_m - place;
        vec2 along = vec2(1.0 + d.by_a.y, d.by_a.z), aside = vec2(d.by_b.y, 1.0 + d.by_b.z);
        across = area_ratio(d);
        off = across < 0.1 ? 0.5 * off
                           : vec2(aside.y * off.x - aside.x * off.y, along.x * off.y - along.y * off.x) / across;
        close = abs(off.x) + abs(off.y) < CLOSE;
        if (!close) rest -= off;
    } while (!close && ++step < MOST_STEPS);
    vec3 value = d.value - (off.x * d.by_a + off.y * d.by_b) / per_m;
    height = vec4(value.x, slope_over_places(d, across), 0.0);
    shift = vec4(value.yz, 0.0, 0.0);
}
