// Displaced surface at the grid's points: position (shift x, height, shift z) in tiles, and normal.
// Held to caustics/sea/surface.py.
#include "caustics/sea/detail.glsl"
#include "caustics/sea/gerstner.glsl"
#ifdef FIELDS
uniform sampler2D fields;  // height, shift, slope x; below it: slope z, strain
#else
uniform sampler2D waves;
uniform int wave_count;
#endif
uniform sampler2D slopes;
uniform Detail detail;
uniform int grid;

layout(location = 0) out vec4 position;
layout(location = 1) out vec4 normal;

void main() {
    vec2 uv = floor(gl_FragCoord.xy) / float(grid);
#ifdef FIELDS
    vec4 f0 = texelFetch(fields, ivec2(gl_FragCoord.xy), 0);
    vec4 f1 = texelFetch(fields, ivec2(gl_FragCoord.xy) + ivec2(0, grid), 0);
    SurfaceFields f = SurfaceFields(f0.x, f0.yz, vec2(f0.w, f1.x), f1.yzw);
#else
    SurfaceFields f = gerstner(waves, wave_count, uv);
#endif
    vec2 ripples = detail.repeats.x > 0.0 ? detail_slope(detail, slopes, uv) : vec2(0.0);
    position = vec4(f.shift.x, f.height, f.shift.y, surface_jacobian(f));
    normal = vec4(surface_normal(f, ripples), 0.0);
}
