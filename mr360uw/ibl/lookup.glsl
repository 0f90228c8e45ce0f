// twin: lookup.py
#include "base/sphere.glsl"

vec3 environment_texel(sampler2DArray map, int layer, ivec2 p) {
    ivec2 size = textureSize(map, 0).xy;
    if (p.y < 0 || p.y >= size.y) p.x += size.x >> 1;
    if (p.x < 0) p.x += size.x;
    if (p.x >= size.x) p.x -= size.x;
    return texelFetch(map, ivec3(p.x, clamp(p.y, 0, size.y - 1), layer), 0).rgb;
}

vec3 environment_lookup(sampler2DArray map, int layer, vec3 direction) {
    vec2 p = frame_from_direction(direction, vec2(textureSize(map, 0).xy)) - 0.5;
    ivec2 corner = ivec2(floor(p));
    vec2 f = p - vec2(corner);
    vec3 upper = mix(environment_texel(map, layer, corner), environment_texel(map, layer, corner + ivec2(1, 0)), f.x);
    vec3 lower = mix(environment_texel(map, layer, corner + ivec2(0, 1)),
                     environment_texel(map, layer, corner + ivec2(1, 1)), f.x);
    return mix(upper, lower, f.y);
}

// `position` is the fractional level of the roughness: np.interp(roughness, level_roughness, levels) of the twin
vec3 glossy_lookup(sampler2DArray levels, float position, vec3 direction) {
    int last = textureSize(levels, 0).z - 1;
    int lower = min(int(position), max(last - 1, 0));
    return mix(environment_lookup(levels, lower, direction),
               environment_lookup(levels, min(lower + 1, last), direction), position - float(lower));
}
