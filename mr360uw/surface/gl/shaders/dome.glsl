// The sky by direction and footprint, from an atlas of its levels below each other. Held to surface/sky.py
#include "sphere.glsl"

struct Dome {
    ivec2 size;  // width and height of level 0
    int levels;
};

vec3 dome_level(Dome dome, sampler2D sky, vec2 place, int level) {
    int top = 2 * (dome.size.y - (dome.size.y >> level)) + 2 * level;
    vec2 texel = place * vec2(dome.size >> level) + vec2(1.0, float(top) + 1.0);
    return textureLod(sky, texel / vec2(textureSize(sky, 0)), 0.0).rgb;
}

vec3 dome_look(Dome dome, sampler2D sky, vec3 direction, float footprint_rad) {
    float level = log2(max(footprint_rad * float(dome.size.y) / PI, 1.0));
    level = min(level, float(dome.levels - 1));
    int lower = min(int(level), max(dome.levels - 2, 0));
    vec2 place = frame_from_direction(vec3(direction.x, abs(direction.y), direction.z), vec2(1.0));
    return mix(dome_level(dome, sky, place, lower), dome_level(dome, sky, place, min(lower + 1, dome.levels - 1)),
               level - float(lower));
}
