// Radiance of the sea's picture: the tree of rays of every pixel, followed by a stack. Held to surface/ray_tree.py
#include "medium/lookup.glsl"
#include "camera.glsl"
#include "waves.glsl"
#include "facets.glsl"
#include "dome.glsl"
#include "floor.glsl"

uniform Camera camera;
uniform Waves waves;
uniform Dome dome;
uniform Sun sun;
uniform Tiled albedo_tile, pattern_tile[2];
uniform MediumTable from_camera, from_surface;
uniform sampler2D heights, shifts, lost_slopes, seen_slopes, sky, albedo, pattern_0, pattern_1;
uniform sampler2D veil_from_camera, attenuation_from_camera, veil_from_surface, attenuation_from_surface;
uniform float floor_y_m, refractive_index, pixel_rad, pixel_m, first_row;
uniform vec3 even_light, dry_light, lost_light;
uniform bool camera_in_water;
#ifdef RIPPLES
#include "caustics/sea/detail.glsl"
uniform Detail detail;
uniform sampler2D ripples;
uniform float ripple_wave, ripple_variance;
#endif

out vec4 radiance;

struct Ray {
    vec3 origin;
    vec3 direction;
    vec3 weight;
    float width;
    float spread;
    float lobe;
    uint key;
    int generation;
    bool wet;
};

vec4 kept_origin[STACK], kept_direction[STACK], kept_weight[STACK];
uvec2 kept_state[STACK];
int kept = 0;

void keep(Ray ray) {
    kept_origin[kept] = vec4(ray.origin, ray.width);
    kept_direction[kept] = vec4(ray.direction, ray.spread);
    kept_weight[kept] = vec4(ray.weight, ray.lobe);
    kept_state[kept] = uvec2(ray.key, uint(2 * ray.generation) + (ray.wet ? 1u : 0u));
    ++kept;
}

Ray taken() {
    --kept;
    vec4 o = kept_origin[kept], d = kept_direction[kept], w = kept_weight[kept];
    uvec2 state = kept_state[kept];
    return Ray(o.xyz, d.xyz, w.xyz, o.w, d.w, w.w, state.x, int(state.y >> 1u), (state.y & 1u) == 1u);
}

float brightest(vec3 weight) {
    return max(max(weight.r, weight.g), weight.b);
}

vec3 floor_radiance(vec2 place, float footprint_m, bool wet) {
    vec3 light = dry_light;
    if (wet) {
        light = even_light;
#if PATTERNS > 0
        light += tiled_at(pattern_tile[0], pattern_0, place, footprint_m);
#endif
#if PATTERNS > 1
        light += tiled_at(pattern_tile[1], pattern_1, place, footprint_m);
#endif
    }
    return tiled_at(albedo_tile, albedo, place, footprint_m) * light / PI;
}

vec3 sun_radiance(vec3 direction, float spread) {
    float seen = max(min(spread / sqrt(PI), 1.0), sun.half_angle_rad);
    float half_sine = sin(0.5 * seen);
    return length(direction - sun.direction) < 2.0 * half_sine ? sun.irradiance / (4.0 * PI * half_sine * half_sine)
                                                                : vec3(0.0);
}

vec3 unresolved(float level) {
    int last = textureSize(lost_slopes, 0).x - 1, lower = min(int(level), last - 1);
    return mix(texelFetch(lost_slopes, ivec2(lower, 0), 0).rgb, texelFetch(lost_slopes, ivec2(lower + 1, 0), 0).rgb,
               level - float(lower));
}

vec3 light_of(Ray ray) {
    vec3 total = vec3(0.0);
    bool more = true;
    int rays = 0;
    do {
        float side = ray.wet ? -1.0 : 1.0, up = ray.direction.y;
        bool to_floor = up < 0.0 && (ray.wet || floor_y_m > waves.lowest_m);
        float far = to_floor ? max((floor_y_m - ray.origin.y) / up, 0.0) : FARTHEST_M;
        Hit hit = first_hit(waves, heights, ray.origin, ray.direction, side, ray.width, ray.spread,
                            min(far, FARTHEST_M), ray.generation > 0);
        bool met = hit.distance >= 0.0;
        float distance = met ? hit.distance : far;
#ifdef WATER
        if (ray.wet) {
            float length = met || to_floor ? distance : 1e9;
            vec3 veil, passed;
            if (ray.generation == 0) {
                veil = veil_lookup(from_camera, veil_from_camera, length, up);
                passed = transmittance_lookup(from_camera, attenuation_from_camera, length, up);
            } else {
                veil = veil_lookup(from_surface, veil_from_surface, length, up);
                passed = transmittance_lookup(from_surface, attenuation_from_surface, length, up);
            }
            total += ray.weight * veil;
            ray.weight *= met || to_floor ? passed : vec3(0.0);
        }
#endif
        vec3 point = ray.origin + distance * ray.direction;
        float wide = length(vec2(ray.spread, ray.lobe));
        more = false;
        if (met) {
            vec3 covariance = unresolved(hit.level);
            vec2 slope = hit.slope;
#ifdef RIPPLES
            vec2 rest = (point.xz - waves_at(waves, shifts, point.xz, hit.level).xy) / waves.tile_m;
            float left = exp(-0.5 * ripple_wave * ripple_wave * hit.sigma_m * hit.sigma_m);
            slope += left * detail_slope(detail, ripples, rest - floor(rest));
            covariance.xz += (1.0 - left * left) * ripple_variance;
#endif
            Facets facets = Facets(ray.direction, slope, covariance, side);
#ifdef SUN
            total += ray.weight * sunlight(facets, sun, seen_slopes, refractive_index);
#endif
            vec3 normal = normal_of(covariance.x + covariance.z > 0.0 ? drawn_slope(facets, seen_slopes, ray.key) : slope);
            vec3 against = side * normal;
            float cosine = clamp(-dot(ray.direction, against), 0.0, 1.0);
            float m = ray.wet ? 1.0 / refractive_index : refractive_index;
            float reflected = fresnel(cosine, m);
            float apart = sqrt(max(covariance.x + covariance.z, 0.0) / float(SAMPLES * SAMPLES));
            float width = ray.width + ray.spread * distance;
            int generation = ray.generation + 1;
            Ray back = Ray(point, reflect(ray.direction, against), ray.weight * reflected, width, ray.spread,
                           length(vec2(ray.lobe, 2.0 * apart)), next_key(ray.key, 1u), generation, ray.wet);
            vec3 bent = normalize(refract_clamped(ray.direction, against, 1.0 / m));
            float growth = min(sqrt(solid_angle_change(max(cosine, 1e-9), m)), WIDEST);
            Ray through = Ray(point, bent, ray.weight * ((1.0 - reflected) / (m * m)), width, ray.spread * growth,
                              length(vec2(ray.lobe, abs(1.0 - 1.0 / m) * apart)), next_key(ray.key, 2u), generation,
                              !ray.wet);
            bool back_first = brightest(back.weight) > brightest(through.weight);
            Ray other = through;
            ray = back;
            if (!back_first) {
                ray = through;
                other = back;
            }
            more = brightest(ray.weight) > FAINTEST && generation < GENERATIONS;
            if (brightest(other.weight) > FAINTEST && generation < GENERATIONS && kept < STACK) keep(other);
        } else if (to_floor) {
            float footprint = (ray.width + wide * distance) * inversesqrt(max(-up, 1e-3));
            total += ray.weight * floor_radiance(point.xz, footprint, ray.wet);
        } else if (ray.wet) {
            total += ray.weight * lost_light;
        } else {
            total += ray.weight * dome_look(dome, sky, ray.direction, wide);
#ifdef SUN
            if (ray.generation == 0) total += ray.weight * sun_radiance(ray.direction, ray.spread);
#endif
        }
        if (!more && kept > 0) {
            ray = taken();
            more = true;
        }
    } while (more && ++rays < RAYS);
    return total;
}

void main() {
    vec2 corner = vec2(floor(gl_FragCoord.x), first_row + floor(gl_FragCoord.y));
    uint number = (uint(corner.y) * uint(camera.size.x) + uint(corner.x)) * uint(SAMPLES * SAMPLES);
    vec3 total = vec3(0.0);
    for (int sample_ = 0; sample_ < SAMPLES * SAMPLES; ++sample_) {
        vec2 place = corner + (vec2(sample_ % SAMPLES, sample_ / SAMPLES) + 0.5) / float(SAMPLES);
        kept = 0;
        total += light_of(Ray(camera_origin(camera, place), camera_direction(camera, place), vec3(1.0),
                              pixel_m / float(SAMPLES), pixel_rad / float(SAMPLES), 0.0,
                              next_key(number + uint(sample_), 0u), 0, camera_in_water));
    }
    radiance = vec4(total / float(SAMPLES * SAMPLES), 1.0);
}
