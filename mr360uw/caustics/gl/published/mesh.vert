// One triangle of the grid, refracted, at the place of its first tile. Held to caustics/published/divided_areas.py.
#include "caustics/flux/coverage.glsl"
uniform sampler2D rays;
uniform sampler2D flux;
#ifndef RATIO
uniform sampler2D vertices;
#endif
uniform int grid;
uniform float size;
uniform float depth;
uniform vec2 travel;
flat out float intensity;
out vec2 light_jacobian;

ivec2 wrap(ivec2 at) {
    return ivec2(at.x < grid ? at.x : at.x - grid, at.y < grid ? at.y : at.y - grid);  // % is slow on software drivers
}

vec2 hit(ivec2 at) {
    vec4 ray = texelFetch(rays, wrap(at), 0);
    return (vec2(at) / float(grid) + ray.xy + (ray.zw - travel) * depth) * size;
}

void main() {
    int cell = gl_VertexID / 6;
    int half_cell = gl_VertexID / 3 % 2;
    int k = gl_VertexID % 3;
    int row = cell / grid;
    ivec2 at = ivec2(cell - row * grid, row);
    ivec2 b = half_cell == 0 ? ivec2(1, 0) : ivec2(1, 1);
    ivec2 c = half_cell == 0 ? ivec2(1, 1) : ivec2(0, 1);
    vec2 p0 = hit(at), p1 = hit(at + b), p2 = hit(at + c);
    vec2 low = floor(min(min(p0, p1), p2));
    vec2 high = max(max(p0, p1), p2);
    float area = 0.5 * abs(twice_area(p0, p1, p2));
    vec2 light = texelFetch(flux, at, 0).rg * (size * size / float(grid * grid));
    intensity = (half_cell == 0 ? light.x : light.y) / max(area, 1e-6);
#ifdef RATIO
    light_jacobian = vec2(0.0);
#else
    ivec2 corner = k == 0 ? ivec2(0) : k == 1 ? b : c;
    light_jacobian = texelFetch(vertices, wrap(at + corner), 0).rg;
#endif
    vec2 place = (k == 0 ? p0 : k == 1 ? p1 : p2) - size * floor(low / size);
    bool drawn = all(lessThan(high - low, vec2(size)));
    gl_Position = drawn ? vec4(place / vec2(size, size + 0.5) - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
