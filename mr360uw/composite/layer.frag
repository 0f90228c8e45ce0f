// one object in one pixel: its samples in groups, each group lit once (reference.py: groups, light_up)
#include "composite/light.glsl"
#include "composite/sampling.glsl"
uniform sampler2D seen, triangles, materials, store, diffuse, beam, veil, attenuation, sun_map, casters, plane_depth;
uniform sampler2DArray ambient, glossy, caustic_ratio;
uniform mat4 placed_world;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform ivec2 gaussian;
uniform ivec2 raster_origin;
uniform ivec2 raster_shift;
uniform ivec2 offsets[SAMPLES];
uniform vec2 numbers;
uniform bool blended;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform float glossy_roughness[8];
uniform Lights lights;
uniform MediumTable medium;
uniform CausticStack stack;
#if AOVS == 1
layout(location = 0) out vec4 parts_out[5];
#elif AOVS == 2
layout(location = 0) out vec4 parts_out[4];
#else
layout(location = 0) out vec4 radiance;
layout(location = 1) out float nearest;
#endif

const int WORDS = (SAMPLES + 31) / 32;
const float PLANE_TOLERANCE = 1.0;
#if defined(BY_SAMPLE)
const float WIDTH = inversesqrt(float(SAMPLES));
#else
const float WIDTH = 1.0;
#endif

vec3 world_direction(vec2 place) {
    return world_from_camera * direction_from_frame(window + place, frame_size);
}

vec2 sample_seen(ivec2 corner, int k) {
    return texelFetch(seen, corner + offsets[k], 0).rg;
}

float glossy_level(float roughness) {
    float level = 0.0;
    for (int k = 0; k + 1 < lights.glossy_levels; ++k)
        level += clamp((roughness - glossy_roughness[k]) / (glossy_roughness[k + 1] - glossy_roughness[k]), 0.0, 1.0);
    return level;
}

Parts light_surface(Surface s) {
    vec3 scale = ambient_factor(lights, medium, diffuse, s.point);
    vec3 irradiance = vec3(0.0), waves = vec3(1.0);
    bool faces = dot(s.normal, lights.sun_direction) > 0.0 && dot(s.geometric_normal, lights.sun_direction) > 0.0;
    if (lights.has_sun && faces) {
        float free = visibility(lights, sun_map, casters, slopes, s.point + lights.bias_m * s.geometric_normal);
        waves = waves_at(lights, medium, beam, diffuse, stack, caustic_ratio, plane_depth, s.point, s.footprint_m);
        irradiance = beam_at(lights, medium, beam, s.point) * waves * free;
    }
    return surface_light(lights, s, ambient, glossy, glossy_level(s.roughness), scale, irradiance, waves);
}

void add(inout vec4 sums[5], inout float distance_m, Surface s, float weight) {
    float up = s.direction.y;
    Parts p = light_surface(s);
    vec3 through = vec3(1.0), haze = vec3(0.0);
    if (lights.has_medium) {
        through = transmittance_lookup(medium, attenuation, s.distance_m, up);
        haze = veil_lookup(medium, veil, s.distance_m, up);
    }
    float share = weight * (blended ? s.base.a : 1.0);
#if AOVS == 1
    sums[0] += share * vec4(through * p.diffuse, 1.0);
    sums[1] += share * vec4(through * p.glossy, 1.0);
    sums[2] += share * vec4(through * (p.sun_diffuse + p.sun_glossy), 1.0);
    sums[3] += share * vec4(through * p.caustics, 1.0);
    sums[4] += share * vec4(through * p.emission, 1.0);
#elif AOVS == 2
    sums[0] += share * vec4(haze, 1.0);
    sums[1] += share * vec4(through, 1.0);
    sums[2] += share * vec4(s.normal, 1.0);
    sums[3] += share * vec4(s.point + lights.camera_position, 1.0);
#else
    vec3 total = p.diffuse + p.glossy + p.sun_diffuse + p.sun_glossy + p.emission;
    sums[0] += share * vec4(through * total + haze, 1.0);
#endif
    distance_m = min(distance_m, s.distance_m);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) + raster_shift;
    ivec2 corner = ivec2(gaussian.x * pixel.x - gaussian.y * pixel.y, gaussian.y * pixel.x + gaussian.x * pixel.y)
                 - raster_origin;
    int left[WORDS];
    int count = 0;
    for (int w = 0; w < WORDS; ++w) left[w] = 0;
    for (int k = 0; k < SAMPLES; ++k) {
        float number = sample_seen(corner, k).r;
        if (number > numbers.x && number <= numbers.y) {
            left[k >> 5] |= 1 << (k & 31);
            ++count;
        }
    }
    vec4 sums[5] = vec4[5](vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    float distance_m = 1e30;
    for (int chosen = 0; chosen < SAMPLES && count > 0; ++chosen) {
        if ((left[chosen >> 5] & (1 << (chosen & 31))) == 0) continue;
        float number = sample_seen(corner, chosen).r;
        vec2 place = frame_from_raster(vec2(corner + raster_origin + offsets[chosen]) + 0.5, vec2(gaussian));
        vec3 direction = world_direction(place);
        vec3 next_column = world_direction(place + vec2(WIDTH, 0.0));
        vec3 next_row = world_direction(place + vec2(0.0, WIDTH));
        Triangle triangle = fetch_triangle(triangles, placed_world, int(number - numbers.x - 1.0));
        Surface s = surface(triangles, materials, store, placed_world, triangle, direction, next_column, next_row,
                            PI / frame_size.y * WIDTH);
        int members = 0;
#if defined(BY_SAMPLE)
        members = 1;
        --count;
#else
        for (int k = chosen; k < SAMPLES; ++k) {
            if ((left[k >> 5] & (1 << (k & 31))) == 0) continue;
            vec2 other = sample_seen(corner, k);
            bool same = other.r == number;
            if (!same) {
                vec2 step = frame_from_raster(vec2(offsets[k] - offsets[chosen]), vec2(gaussian));
                vec3 towards = direction + (next_column - direction) * step.x + (next_row - direction) * step.y;
                float offset = dot(other.g * towards - s.point, s.geometric_normal);
                int row = int(other.r - numbers.x - 1.0) * TRIANGLE_TEXELS + 9;
                same = abs(offset) <= PLANE_TOLERANCE * s.footprint_m && listed(triangles, row).y == triangle.patch_number;
            }
            if (same) {
                left[k >> 5] &= ~(1 << (k & 31));
                ++members;
                --count;
            }
        }
#endif
        add(sums, distance_m, s, float(members) / float(SAMPLES));
    }
#if AOVS == 1
    for (int k = 0; k < 5; ++k) parts_out[k] = sums[k];
#elif AOVS == 2
    for (int k = 0; k < 4; ++k) parts_out[k] = sums[k];
#else
    radiance = sums[0];
    nearest = distance_m;
#endif
}
