// Light and Jacobian of the refraction at each grid point, from the six triangles around it.
// Held to caustics/published/divided_areas.py.
#include "caustics/flux/coverage.glsl"
uniform sampler2D rays;
uniform sampler2D flux;
uniform int grid;
uniform float size;
uniform float depth;
out vec2 light_jacobian;

ivec2 wrap(ivec2 at) {
    return (at + grid) % grid;
}

vec2 hit(ivec2 step) {
    vec4 ray = texelFetch(rays, wrap(ivec2(gl_FragCoord.xy) + step), 0);
    return (vec2(step) / float(grid) + ray.xy + ray.zw * depth) * size;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec2 west = texelFetch(flux, wrap(at - ivec2(1, 0)), 0).rg;
    vec2 north = texelFetch(flux, wrap(at - ivec2(0, 1)), 0).rg;
    float light = dot(texelFetch(flux, at, 0).rg + texelFetch(flux, wrap(at - 1), 0).rg, vec2(1.0)) + west.r + north.g;
    light *= size * size / float(grid * grid);
    vec2 o = hit(ivec2(0)), e = hit(ivec2(1, 0)), w = hit(ivec2(-1, 0)), s = hit(ivec2(0, 1)), n = hit(ivec2(0, -1));
    vec2 se = hit(ivec2(1, 1)), nw = hit(ivec2(-1, -1));
#ifdef FAN
    float area = 0.5 * (abs(twice_area(o, e, se)) + abs(twice_area(o, se, s)) + abs(twice_area(o, s, w))
                      + abs(twice_area(o, w, nw)) + abs(twice_area(o, nw, n)) + abs(twice_area(o, n, e)));
    light_jacobian = vec2(light / max(area, 1e-6), 1.0);
#else
    light_jacobian = vec2(light / 3.0, 0.25 * ((e.x - w.x) * (s.y - n.y) - (e.y - w.y) * (s.x - n.x)));
#endif
}
