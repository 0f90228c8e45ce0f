// Radiance of fragments at the camera: each is a place on a triangle of a body, seen through the water.
// Held to composite/shading.py.
#include "composite/gl/shaders/lamps.glsl"
#include "composite/gl/shaders/sun.glsl"
#if defined(EYE)
#include "composite/gl/shaders/eyes.glsl"
uniform float eye_m;
#endif
uniform sampler2D fragments, bodies;
uniform sampler2D triangles, materials, store, diffuse, beam, veil, attenuation, lamps, plane_depth;
uniform sampler2DArray ambient, caustic_ratio, plate_ratio;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform int count;
uniform float filter_width;
uniform sampler2D sun_seen;  // visible fractions of the sun's disc and halo, of each fragment
uniform sampler2D lamps_seen;  // visible fractions of the lamps, LAMPS for each fragment
uniform float glossy_roughness[MAXIMUM_GLOSSY_LEVELS];
uniform View view;
uniform Sun sun;
uniform int glossy_levels;
uniform float outside_index;
uniform MediumTable medium;
uniform CausticStack stack;
#if OUTPUTS == 1
layout(location = 0) out vec4 parts_out[6];
#elif OUTPUTS == 2
layout(location = 0) out vec4 parts_out[4];
#else
layout(location = 0) out vec4 radiance;
layout(location = 1) out float distance_m;
#endif

vec3 world_direction(vec2 place) {
    return world_from_camera * direction_from_frame(place, frame_size);
}

float glossy_level(float roughness) {
    float level = 0.0;
    for (int k = 0; k + 1 < glossy_levels; ++k)
        level += clamp((roughness - glossy_roughness[k]) / (glossy_roughness[k + 1] - glossy_roughness[k]), 0.0, 1.0);
    return level;
}

bool faces_sun(Surface s) {
    return dot(s.normal, sun.direction) > 0.0 && dot(s.geometric_normal, sun.direction) > 0.0;
}

Parts light_surface(Surface s, Among among, int number) {
    Coat coat = make_coat(s, outside_index);
    vec3 axis = lobe_axis(s.normal, coat.view, coat.n_dot_v, s.roughness);
    vec3 scale = ambient_factor(view, medium, diffuse, s.point, s.normal.y);
    vec3 mirrored = ambient_factor(view, medium, diffuse, s.point, axis.y);
    Parts parts = ambient_light(coat, s, among, ambient, glossy_level(s.roughness), axis, scale, mirrored);
#if defined(SUN)
    bool faces = faces_sun(s);
    float free = 1.0;
#if defined(SHADOW)
    vec2 seen = texelFetch(sun_seen, list_place(number), 0).rg;
    free = mix(seen.x, seen.y, scattered_at(sun, view, medium, beam, s.point));
#endif
    vec3 waves = waves_at(sun, view, medium, beam, stack, caustic_ratio, plane_depth, s.point, s.footprint_m);
    vec3 irradiance = beam_at(sun, view, medium, beam, s.point) * waves * (faces ? free : 0.0);
    float half_angle = half_angle_at(sun, view, medium, beam, s.point);
    parts.sun = reflected_light(coat, s, sun.direction, irradiance, half_angle);
    parts.caustics = parts.sun * (1.0 - 1.0 / max(waves, 1e-6));
#endif
#if defined(LAMPS)
    for (int k = 0; k < LAMPS; ++k) {
        Lamp lamp = fetch_lamp(lamps, k);
        LampLight light = lamp_light(lamp, medium, beam, attenuation, s.point);
        bool lit = dot(s.normal, light.towards) > 0.0 && dot(s.geometric_normal, light.towards) > 0.0;
        float free = lit ? texelFetch(lamps_seen, list_place(number * LAMPS + k), 0).r : 0.0;
        parts.lamps += reflected_light(coat, s, light.towards, free * light.irradiance, light.half_angle);
    }
#endif
    return trimmed(parts, s.trim);
}

void main() {
    int number = min(lane_number(ivec2(gl_FragCoord.xy)), count - 1);
    vec4 fragment = texelFetch(fragments, list_place(number), 0);  // triangle, place, body
    int body = 4 * int(fragment.w);
    mat4 placed = transpose(mat4(texelFetch(bodies, list_place(body), 0), texelFetch(bodies, list_place(body + 1), 0),
                                 texelFetch(bodies, list_place(body + 2), 0), vec4(0.0, 0.0, 0.0, 1.0)));
    vec4 numbers = texelFetch(bodies, list_place(body + 3), 0);  // -, first point value, points of the front if two-sided, texels a point
    Triangle triangle = fetch_triangle(triangles, placed, int(fragment.x));
    vec2 place = fragment.yz;
    vec3 right = world_direction(place + vec2(filter_width, 0.0)), below = world_direction(place + vec2(0.0, filter_width));
#if defined(EYE)
    vec3 start = world_from_camera * ray_start(direction_from_frame(place, frame_size), eye_m);
    triangle.a -= start;
    triangle.b -= start;
    triangle.c -= start;
#endif
    Surface s = surface(triangles, materials, store, placed, triangle, world_direction(place), right, below,
                        PI / frame_size.y * filter_width);
#if defined(EYE)
    s.point += start;
#endif
    Among among = Among(vec3(1.0), vec3(1.0), vec3(0.0));
#if defined(AMONG_BODIES)
    int first_value = int(numbers.y) + (s.behind ? int(numbers.w) * int(numbers.z) : 0);
    among = among_bodies(bodies, first_value, int(numbers.w), listed(triangles, triangle.first + 10), s.weights);
#endif
    Parts p = light_surface(s, among, number);
    vec3 through = vec3(1.0), haze = vec3(0.0);
#if defined(MEDIUM)
    through = transmittance_lookup(medium, attenuation, s.distance_m, s.direction.y);
    haze = veil_lookup(medium, veil, s.distance_m, s.direction.y) * environment_lookup(plate_ratio, 0, s.direction);
#endif
#if defined(BLENDED)
    float alpha = s.base.a;
#else
    float alpha = 1.0;
#endif
#if OUTPUTS == 1
    parts_out[0] = vec4(through * p.diffuse, alpha);
    parts_out[1] = vec4(through * p.glossy, alpha);
    parts_out[2] = vec4(through * p.sun, alpha);
    parts_out[3] = vec4(through * p.lamps, alpha);
    parts_out[4] = vec4(through * p.caustics, alpha);
    parts_out[5] = vec4(through * p.emission, alpha);
#elif OUTPUTS == 2
    parts_out[0] = vec4(haze, alpha);
    parts_out[1] = vec4(through, alpha);
    parts_out[2] = vec4(s.normal, alpha);
    parts_out[3] = vec4(s.point + view.position, alpha);
#else
    radiance = vec4(through * (p.diffuse + p.glossy + p.sun + p.lamps + p.emission) + haze, alpha);
    distance_m = s.distance_m;
#endif
}
