// Light on the receiver at listed samples, side x side of a block one after the other: caustics and, on request, ambient
// fraction, veil and light of lamps. Held to composite/receiver/ratio.py.
#include "composite/gl/shaders/lamps.glsl"
#include "composite/gl/shaders/sun.glsl"
#if defined(EYE)
#include "composite/gl/shaders/eyes.glsl"
uniform float eye_m;
#endif
uniform sampler2D blocks, shape, diffuse, beam, veil, attenuation, lamps, plane_depth;
uniform sampler2D lamps_seen;  // visible fractions of the lamps, LAMPS for each sample
uniform sampler2DArray ambient, caustic_ratio, plate_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform int count;
uniform int side_bits;  // log2 of side
uniform float plane_height;
uniform vec2 fade;  // distances from which, and at which, the receiver fades out
uniform View view;
uniform Sun sun;
uniform MediumTable medium;
uniform CausticStack stack;
layout(location = 0) out vec4 waves;
#if defined(ROUGH)
layout(location = 1) out vec4 share;  // ambient fraction of the light, weight
layout(location = 2) out vec4 haze;
#endif
#if defined(LAMPS)
layout(location = 3) out vec4 added;  // light of lamps over the plate's own
#endif

void main() {
    int number = min(lane_number(ivec2(gl_FragCoord.xy)), count - 1), side = 1 << side_bits;
    vec4 block = texelFetch(blocks, list_place(number >> (2 * side_bits)), 0);  // its corner in the frame
    vec2 within = vec2(number & (side - 1), (number >> side_bits) & (side - 1)) + 0.5;
    vec2 place = block.xy + within;
    vec3 direction = world_from_camera * direction_from_frame(place, frame_size);
    vec3 start = vec3(0.0);
#if defined(EYE)
    start = world_from_camera * ray_start(direction_from_frame(place, frame_size), eye_m);
#endif
#if defined(PLANE)
    float distance_m = (plane_height - start.y) / direction.y;
#else
    vec4 ground = texelFetch(shape, list_place(number), 0);
    float distance_m = ground.w;
#endif
    vec3 seen_from = distance_m * direction, point = start + seen_from;
    waves.rgb = waves_at(sun, view, medium, beam, stack, caustic_ratio, plane_depth, point,
                         distance_m * PI / frame_size.y);
#if defined(ROUGH)
    vec3 around = environment_lookup(ambient, 0, ground.xyz) * ambient_factor(view, medium, diffuse, point, ground.y);
    vec3 direct = beam_at(sun, view, medium, beam, point) * max(dot(ground.xyz, sun.direction), 0.0);
    float weight = distance_m > 0.0 ? 1.0 - smoothstep(fade.x, fade.y, distance_m) : 0.0;
    share = vec4(around / max(around + direct, DARK), weight);
    haze = vec4(0.0);
#if defined(MEDIUM)
    haze.rgb = veil_lookup(medium, veil, distance_m, direction.y) * environment_lookup(plate_ratio, 0, direction);
#endif
#endif
#if defined(LAMPS)
    added = vec4(0.0);
    for (int k = 0; k < LAMPS; ++k) {
        Lamp lamp = fetch_lamp(lamps, k);
        LampLight light = lamp_light(lamp, medium, beam, attenuation, point);
        float cosine = max(dot(ground.xyz, light.towards), 0.0);
        float free = texelFetch(lamps_seen, list_place(number * LAMPS + k), 0).r;
        if (distance_m > 0.0) added.rgb += cosine * free * light.irradiance;
    }
    added.rgb = min(added.rgb / max(around + direct, DARK), BRIGHTEST);
#endif
}
