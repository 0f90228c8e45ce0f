// what falls on the receiver in listed blocks, each SIDE samples wide that are SPACING pixels apart (light.py:
// receiver_ratio)
#include "composite/gl/shaders/light.glsl"
uniform sampler2D blocks, halos, shape, diffuse, beam, veil, sun_map, casters, plane_depth;
uniform sampler2DArray ambient, caustic_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform float plane_height;
uniform vec2 fade;  // distances from which, and at which, the receiver fades out
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
uniform MediumTable medium;
uniform CausticStack stack;
#if defined(CAUSTICS) || defined(ROUGH)
layout(location = 0) out vec4 falls;  // waves, part of the sun seen
#else
layout(location = 0) out float falls;
#endif
#if defined(ROUGH)
layout(location = 1) out vec4 share;  // ambient part of the light, weight
layout(location = 2) out vec4 haze;
#endif

void main() {
    ivec2 p = ivec2(gl_FragCoord.xy), block = p / SIDE;
    vec2 place = texelFetch(blocks, block, 0).xy + (vec2(p - block * SIDE) + 0.5) * float(SPACING);
    vec3 direction = world_from_camera * direction_from_frame(place, frame_size);
#if defined(PLANE)
    float distance_m = plane_height / direction.y;
#else
    vec4 ground = texelFetch(shape, p, 0);
    float distance_m = ground.w;
#endif
    vec3 point = distance_m * direction;
    float seen = 1.0;
#if defined(SHADOW)
    float halo = -1.0;
#if defined(HALO)
    vec4 corners = texelFetch(halos, block, 0);  // of the block; negative where straight lines do not tell the rest
    vec2 at = (vec2(p - block * SIDE) + 0.5) / float(SIDE), below = mix(corners.xz, corners.yw, at.x);
    if (corners.x >= 0.0) halo = mix(below.x, below.y, at.y);
#endif
    seen = visibility(lights, medium, beam, sun_map, casters, slopes, point, halo, 1, true);
#endif
#if defined(CAUSTICS) || defined(ROUGH)
    falls = vec4(waves_at(lights, medium, beam, stack, caustic_ratio, plane_depth, point,
                          distance_m * PI / frame_size.y), seen);
#else
    falls = seen;
#endif
#if defined(ROUGH)
    vec3 around = environment_lookup(ambient, 0, ground.xyz) * ambient_factor(lights, medium, diffuse, point);
    vec3 sun = beam_at(lights, medium, beam, point) * max(dot(ground.xyz, lights.sun_direction), 0.0);
    float weight = distance_m > 0.0 ? 1.0 - smoothstep(fade.x, fade.y, distance_m) : 0.0;
    share = vec4(around / max(around + sun, 1e-9), weight);
    haze = vec4(0.0);
#if defined(MEDIUM)
    haze.rgb = veil_lookup(medium, veil, distance_m, direction.y);
#endif
#endif
}
