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

// the samples that are not lit yet, a bit each
const int BITS = 26;
const int WORDS = (SAMPLES + BITS - 1) / BITS;
const float PLANE_TOLERANCE = 1.0;
struct Left {
    int word[WORDS];
};
#if defined(BY_SAMPLE)
const float WIDTH = inversesqrt(float(SAMPLES));
#else
const float WIDTH = 0.5;
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
#if defined(SUN)
    bool faces = dot(s.normal, lights.sun_direction) > 0.0 && dot(s.geometric_normal, lights.sun_direction) > 0.0;
    float free = 1.0;
#if defined(SHADOW)
    free = visibility(lights, sun_map, casters, slopes, s.point + lights.bias_m * s.geometric_normal);
#endif
    waves = waves_at(lights, medium, beam, stack, caustic_ratio, plane_depth, s.point, s.footprint_m);
    irradiance = beam_at(lights, medium, beam, s.point) * waves * (faces ? free : 0.0);
#endif
    return surface_light(lights, s, ambient, glossy, glossy_level(s.roughness), scale, irradiance, waves);
}

void add(inout vec4 sums[5], inout float distance_m, Surface s, float weight) {
    Parts p = light_surface(s);
    vec3 through = vec3(1.0), haze = vec3(0.0);
#if defined(MEDIUM)
    through = transmittance_lookup(medium, attenuation, s.distance_m, s.direction.y);
    haze = veil_lookup(medium, veil, s.distance_m, s.direction.y);
#endif
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

bool none_left(Left left) {
    int any = 0;
    for (int w = 0; w < WORDS; ++w) any |= left.word[w];
    return any == 0;
}

// the number of the lowest bit; 0 where none is left
int first_left(Left left) {
    int first = 0;
    for (int w = WORDS - 1; w >= 0; --w) {
        int lowest = left.word[w] & -left.word[w];
        if (lowest != 0) first = w * BITS + int(log2(float(lowest)) + 0.5);
    }
    return first;
}

bool is_left(Left left, int k) {
    return (left.word[k / BITS] & (1 << (k - BITS * (k / BITS)))) != 0;
}

void take(inout Left left, int k) {
    left.word[k / BITS] &= ~(1 << (k - BITS * (k / BITS)));
}

Left samples_of_object(ivec2 corner) {
    Left left;
    for (int w = 0; w < WORDS; ++w) {
        left.word[w] = 0;
        for (int k = w * BITS; k < min(SAMPLES, (w + 1) * BITS); ++k) {
            float number = sample_seen(corner, k).r;
            if (number > numbers.x && number <= numbers.y) left.word[w] |= 1 << (k - w * BITS);
        }
    }
    return left;
}

int list_number(float number) {
    return max(int(number - numbers.x) - 1, 0);
}

Surface surface_of_sample(ivec2 corner, int k, out Triangle triangle, out vec3 next_column, out vec3 next_row) {
    vec2 place = frame_from_raster(vec2(corner + raster_origin + offsets[k]) + 0.5, vec2(gaussian));
    next_column = world_direction(place + vec2(WIDTH, 0.0));
    next_row = world_direction(place + vec2(0.0, WIDTH));
    triangle = fetch_triangle(triangles, placed_world, list_number(sample_seen(corner, k).r));
    return surface(triangles, materials, store, placed_world, triangle, world_direction(place), next_column, next_row,
                   PI / frame_size.y * WIDTH);
}

// whether another sample lies on the same smooth piece of surface, near its plane
bool belongs(ivec2 corner, int k, int chosen, Surface s, Triangle triangle, vec3 next_column, vec3 next_row) {
    vec2 other = sample_seen(corner, k);
    vec2 step = frame_from_raster(vec2(offsets[k] - offsets[chosen]), vec2(gaussian)) / WIDTH;
    vec3 towards = s.direction + (next_column - s.direction) * step.x + (next_row - s.direction) * step.y;
    float offset = dot(other.g * towards - s.point, s.geometric_normal);
    float piece = listed(triangles, list_number(other.r) * TRIANGLE_TEXELS + 9).y;
    return piece == triangle.patch_number && abs(offset) <= PLANE_TOLERANCE * s.footprint_m;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) + raster_shift;
    ivec2 corner = ivec2(gaussian.x * pixel.x - gaussian.y * pixel.y, gaussian.y * pixel.x + gaussian.x * pixel.y)
                 - raster_origin;
    Left left = samples_of_object(corner);
    if (none_left(left)) discard;
    vec4 sums[5] = vec4[5](vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    float distance_m = 1e30;
    // loops test at their end, because software drivers run a body once more to leave
    do {
        int chosen = first_left(left), members = 1;
        Triangle triangle;
        vec3 next_column, next_row;
        Surface s = surface_of_sample(corner, chosen, triangle, next_column, next_row);
        take(left, chosen);
#if !defined(BY_SAMPLE)
        for (int k = 1; k < SAMPLES; ++k) {
            if (is_left(left, k) && belongs(corner, k, chosen, s, triangle, next_column, next_row)) {
                take(left, k);
                ++members;
            }
        }
#endif
        add(sums, distance_m, s, float(members) / float(SAMPLES));
    } while (!none_left(left));
#if AOVS == 1
    for (int k = 0; k < 5; ++k) parts_out[k] = sums[k];
#elif AOVS == 2
    for (int k = 0; k < 4; ++k) parts_out[k] = sums[k];
#else
    radiance = sums[0];
    nearest = distance_m;
#endif
}
