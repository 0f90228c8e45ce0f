// what objects and waves change on the receiver in one pixel (light.py: receiver_ratio)
#include "composite/light.glsl"
uniform sampler2D shape, surfels, diffuse, beam, veil, sun_map, casters, plane_depth;
uniform sampler2DArray ambient, caustic_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform int surfel_count;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
uniform MediumTable medium;
uniform CausticStack stack;
layout(location = 0) out vec4 ratio;
layout(location = 1) out vec4 haze;

void main() {
    ratio = vec4(1.0);
    haze = vec4(0.0);
    vec4 place = texelFetch(shape, ivec2(gl_FragCoord.xy), 0);
    if (place.w <= 0.0) return;
    vec3 direction = world_from_camera * direction_from_frame(window + gl_FragCoord.xy, frame_size);
    vec3 point = place.w * direction, waves = vec3(1.0);
    vec3 arrives = environment_lookup(ambient, 0, place.xyz) * ambient_factor(lights, medium, diffuse, point);
    vec3 sun = beam_at(lights, medium, beam, point) * max(dot(place.xyz, lights.sun_direction), 0.0);
    float blocked = ambient_blocked(surfels, 0, surfel_count, point, place.xyz);
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
