// Image of one cell of the surface: its corners in pixels of the target, from the corner of its bounding square.
// Held to caustics/flux/deposit.py.
#include "caustics/flux/cell.glsl"
uniform sampler2D rays;
uniform sampler2D flux;
uniform int grid;
uniform float size;        // pixels of the map across the tile; the target spans two tiles and one row for even light
uniform float depth;       // in tiles
uniform vec2 travel;       // of the beam for each metre of depth, taken off
uniform vec2 extents;      // cells wider than x and up to y pixels are drawn

flat out vec4 cell_ab;
flat out vec4 cell_cd;
flat out vec4 cell_light_at;  // intensities, corner of the bounding square
#ifdef RECTANGLES
flat out vec2 cell_extent;
#endif

ivec2 wrap(ivec2 at) {
    return ivec2(at.x < grid ? at.x : at.x - grid, at.y < grid ? at.y : at.y - grid);  // % is slow on software drivers
}

vec2 hit(ivec2 at) {
    vec4 ray = texelFetch(rays, wrap(at), 0);
    return (vec2(at) / float(grid) + ray.xy + (ray.zw - travel) * depth) * size;
}

void main() {
    int row = gl_VertexID / grid;
    ivec2 at = ivec2(gl_VertexID - row * grid, row);
    Cell q = opened(Cell(hit(at), hit(at + ivec2(1, 0)), hit(at + ivec2(1, 1)), hit(at + ivec2(0, 1))));
    vec2 light = texelFetch(flux, at, 0).rg * (size * size / float(grid * grid));
    vec2 low = floor(min(min(q.a, q.b), min(q.c, q.d)));
    vec2 extent = max(ceil(max(max(q.a, q.b), max(q.c, q.d))) - low, 1.0);
    float widest = max(extent.x, extent.y);
    bool drawn = widest > extents.x && widest <= extents.y && light.x + light.y > 0.0;
    vec2 tile = low - size * floor(low / size);
#ifndef RECTANGLES
    if (widest >= size) {
        // as wide as the map: even light, collected in a pixel of its own
        q = Cell(vec2(0.0), vec2(1.0, 0.0), vec2(1.0), vec2(0.0, 1.0));
        low = vec2(0.0);
        widest = 1.0;
        drawn = light.x + light.y > 0.0;
        tile = vec2(0.0, 2.0 * size);
    }
#endif
    cell_ab = vec4(q.a - low, q.b - low);
    cell_cd = vec4(q.c - low, q.d - low);
    cell_light_at = vec4(intensities(q, light.x, light.y), tile);
#ifdef RECTANGLES
    cell_extent = drawn ? extent : vec2(0.0);
    gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
#else
    gl_PointSize = widest;
    gl_Position = drawn ? vec4((tile + 0.5 * widest) / vec2(size, size + 0.5) - 1.0, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
#endif
}
