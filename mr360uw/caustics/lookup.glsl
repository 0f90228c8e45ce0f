// twin: lookup.py
#include "caustics/gl/atlas_level.glsl"
// `ratio` holds the mip_atlas of a stack and filters linearly, `plane_depth` its plane_steps
struct CausticStack {
    float tile_m;
    vec3 sun_direction;
};

// point = (x, depth below the mean surface, z)
vec3 caustic_lookup(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, vec3 point, float footprint_m) {
    int steps = textureSize(plane_depth, 0).x;
    float position = 0.0;
    int k = 0;
    // tests at its end, because software drivers run a body once more to leave
    do {
        vec2 plane = texelFetch(plane_depth, ivec2(k, 0), 0).rg;
        position += clamp((point.y - plane.x) * plane.y, 0.0, 1.0);
        ++k;
    } while (k < steps);
    int layers = (steps + 2) / 3;
    float layer = min(floor(position / 3.0), float(layers - 1));
    vec4 share = max(1.0 - abs(position - 3.0 * layer - vec4(0.0, 1.0, 2.0, 3.0)), 0.0);

    vec2 uv = (point.xz + stack.sun_direction.xz * (point.y / stack.sun_direction.y)) / stack.tile_m;
    uv -= floor(uv);
    float size = float(textureSize(ratio, 0).x - 2);
    float level = log2(max(footprint_m * size / (sqrt(3.0) * stack.tile_m), 1.0));
    float number = min(floor(level), log2(size) - 1.0);
    float between = min(level - number, 1.0);
    float side = size * exp2(-number);

    int colours = textureSize(ratio, 0).z / layers;
    vec3 value = vec3(0.0), colour = colours == 1 ? vec3(1.0) : vec3(1.0, 0.0, 0.0);
    float at = layer * float(colours), end = at + float(colours);
    do {
        vec4 planes = mix(caustic_level(ratio, size, side, number, uv, at),
                          caustic_level(ratio, size, 0.5 * side, number + 1.0, uv, at), between);
        value += dot(planes, share) * colour;
        colour = colour.zxy;
        at += 1.0;
    } while (at < end);
    return value;
}
