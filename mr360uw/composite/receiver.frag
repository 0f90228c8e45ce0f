// what objects and waves change on the receiver in one pixel (light.py: receiver_ratio)
#include "composite/light.glsl"
uniform sampler2D shape, surfels, occlusion, diffuse, beam, veil, sun_map, casters, plane_depth;
uniform sampler2DArray ambient, caustic_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform int surfel_count;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
uniform MediumTable medium;
uniform CausticStack stack;
const float SMOOTH = 0.02;
layout(location = 0) out vec4 ratio;
layout(location = 1) out vec4 haze;

// between the places of occlusion.frag where those agree, from the surfels where they do not
float blocked_at(vec3 point, vec3 normal) {
    vec2 p = (gl_FragCoord.xy - 0.5) / float(STRIDE);
    ivec2 i = ivec2(p);
    vec4 c = vec4(texelFetch(occlusion, i, 0).r, texelFetch(occlusion, i + ivec2(1, 0), 0).r,
                  texelFetch(occlusion, i + ivec2(0, 1), 0).r, texelFetch(occlusion, i + ivec2(1, 1), 0).r);
    float spread = max(max(c.x, c.y), max(c.z, c.w)) - min(min(c.x, c.y), min(c.z, c.w));
    vec2 f = fract(p);
    int count = spread > SMOOTH ? surfel_count : 1;
    float exact = ambient_blocked(surfels, 0, count, point, normal);
    return spread > SMOOTH ? exact : mix(mix(c.x, c.y, f.x), mix(c.z, c.w, f.x), f.y);
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
    float blocked = 0.0;
#if defined(OCCLUSION)
    blocked = blocked_at(point, place.xyz);
#endif
    float free = 1.0;
#if defined(SHADOW)
    free = visibility(lights, sun_map, casters, slopes, point);
#endif
    waves = waves_at(lights, medium, beam, diffuse, stack, caustic_ratio, plane_depth, point, place.w * PI / frame_size.y);
    ratio.rgb = lit_ratio(arrives, sun, blocked, free, waves);
    if (all(lessThanEqual(abs(ratio.rgb - 1.0), vec3(1e-4)))) ratio.rgb = vec3(1.0);
#if defined(MEDIUM)
    else haze.rgb = veil_lookup(medium, veil, place.w, direction.y);
#endif
}
