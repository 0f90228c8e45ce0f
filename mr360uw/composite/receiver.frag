// what objects and waves change on the receiver in one pixel (light.py: receiver_ratio)
#include "composite/light.glsl"
uniform sampler2D shape, surfels, coarse, diffuse, beam, veil, sun_map, casters, plane_depth;
uniform sampler2DArray ambient, caustic_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform int surfel_count;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
uniform MediumTable medium;
uniform CausticStack stack;
const float SMOOTH = 0.02;  // change of what is blocked between places that is followed by a straight line
const float WIDE = 4.0;     // a penumbra as wide as this many places, likewise
layout(location = 0) out vec4 ratio;
layout(location = 1) out vec4 haze;

// (part of the ambient light blocked, part of the sun seen): between the places of coarse.frag where those follow the
// ground smoothly, from the bodies themselves where they do not
vec2 kept_at(vec3 point, vec3 normal, float footprint_m) {
    vec2 p = (gl_FragCoord.xy - 0.5) / float(STRIDE);
    ivec2 i = ivec2(p);
    vec2 a = texelFetch(coarse, i, 0).rg, b = texelFetch(coarse, i + ivec2(1, 0), 0).rg;
    vec2 c = texelFetch(coarse, i + ivec2(0, 1), 0).rg, d = texelFetch(coarse, i + ivec2(1, 1), 0).rg;
    vec2 f = fract(p), between = mix(mix(a, b, f.x), mix(c, d, f.x), f.y), kept = vec2(0.0, 1.0);
#if defined(OCCLUSION)
    bool rough = max(max(a.x, b.x), max(c.x, d.x)) - min(min(a.x, b.x), min(c.x, d.x)) > SMOOTH;
    float blocked = ambient_blocked(surfels, 0, rough ? surfel_count : 1, point, normal);
    kept.x = rough ? blocked : between.x;
#endif
#if defined(SHADOW)
    bool sharp = narrowest_penumbra(lights, casters, point) < WIDE * float(STRIDE) * footprint_m;
    float seen = visibility(lights, sun_map, casters, slopes, point, sharp);
    kept.y = sharp ? seen : between.y;
#endif
    return kept;
}

void main() {
    ratio = vec4(1.0);
    haze = vec4(0.0);
    vec4 place = texelFetch(shape, ivec2(gl_FragCoord.xy), 0);
    if (place.w <= 0.0) return;
    vec3 direction = world_from_camera * direction_from_frame(window + gl_FragCoord.xy, frame_size);
    vec3 point = place.w * direction, waves = vec3(1.0);
    vec3 arrives = environment_lookup(ambient, 0, place.xyz) * ambient_factor(lights, medium, diffuse, point);
    vec3 sun = beam_at(lights, medium, beam, point) * max(dot(place.xyz, lights.sun_direction), 0.0);
    float footprint_m = place.w * PI / frame_size.y;
    vec2 kept = vec2(0.0, 1.0);
#if defined(OCCLUSION) || defined(SHADOW)
    kept = kept_at(point, place.xyz, footprint_m / max(-dot(direction, place.xyz), 0.1));
#endif
    waves = waves_at(lights, medium, beam, stack, caustic_ratio, plane_depth, point, footprint_m);
    ratio.rgb = lit_ratio(arrives, sun, kept.x, kept.y, waves);
    if (all(lessThanEqual(abs(ratio.rgb - 1.0), vec3(1e-4)))) ratio.rgb = vec3(1.0);
#if defined(MEDIUM)
    else haze.rgb = veil_lookup(medium, veil, place.w, direction.y);
#endif
}
