// Rays and the light of sky, floor and water on them, and the two that a surface makes of one. Held to
// surface/tracing/ray_kernel.py
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

// of one ray that meets the surface; glitter: the sun's light
struct Parting {
    Ray reflected;
    Ray refracted;
    vec3 glitter;
};

// angle that slopes between the points of the atlas may be off by: pixels as near to the sun's edge are done by TREE
#ifdef TREE
const float SLACK = 0.0;
#else
const float SLACK = 4e-3;
#endif

float brightest(vec3 weight) {
    return max(max(weight.r, weight.g), weight.b);
}

// up to the floor, negative for never
float floor_distance(vec3 origin, vec3 direction, bool wet) {
    bool reached = direction.y < 0.0 && (wet || floor_y_m > waves.lowest_m);
    return reached ? max((floor_y_m - origin.y) / direction.y, 0.0) : NO_HIT;
}

vec3 floor_light(Ray ray, float distance, bool wet) {
    vec2 place = ray.origin.xz + distance * ray.direction.xz;
    float footprint = (ray.width + length(vec2(ray.spread, ray.lobe)) * distance)
                    * inversesqrt(max(-ray.direction.y, 1e-3));
    vec3 light = even_light;
#if PATTERNS > 0
    light += tiled_at(pattern_tile[0], pattern_0, place, footprint);
#endif
#if PATTERNS > 1
    light += tiled_at(pattern_tile[1], pattern_1, place, footprint);
#endif
    return tiled_at(albedo_tile, albedo, place, footprint) * (wet ? light : dry_light) / PI;
}

// light and transmittance of the water along a ray
struct Passage {
    vec3 veil;
    vec3 passed;
};

// by how much a veil varies about the sun: layer 0 of rays from the surface, 1 from the camera
vec3 around_sun(int layer, vec3 direction) {
#ifdef AROUND_SUN
    return environment_lookup(around, layer, direction);
#else
    return vec3(1.0);
#endif
}

Passage from_camera_on(float distance, vec3 direction) {
#ifdef WATER
    return Passage(veil_lookup(from_camera, veil_from_camera, distance, direction.y) * around_sun(1, direction),
                   transmittance_lookup(from_camera, attenuation_from_camera, distance, direction.y));
#else
    return Passage(vec3(0.0), vec3(1.0));
#endif
}

Passage from_surface_on(float distance, vec3 direction) {
#ifdef WATER
    return Passage(veil_lookup(from_surface, veil_from_surface, distance, direction.y) * around_sun(0, direction),
                   transmittance_lookup(from_surface, attenuation_from_surface, distance, direction.y));
#else
    return Passage(vec3(0.0), vec3(1.0));
#endif
}

vec3 sky_light(Ray ray) {
    vec3 light = dome_look(dome, sky, ray.direction, length(vec2(ray.spread, ray.lobe)));
#ifdef SUN
    float seen = max(min(ray.spread / sqrt(PI), 1.0), sun.half_angle_rad);
    float half_sine = sin(0.5 * seen);  // the cosine of so small an angle is 1 in single precision
    bool shown = ray.generation == 0 && length(ray.direction - sun.direction) < 2.0 * half_sine;
    light += shown ? sun.irradiance / (4.0 * PI * half_sine * half_sine) : vec3(0.0);
#endif
    return light;
}

vec3 unresolved(float level) {
    int last = textureSize(lost_slopes, 0).x - 1, lower = min(int(level), last - 1);
    return mix(texelFetch(lost_slopes, ivec2(lower, 0), 0).rgb, texelFetch(lost_slopes, ivec2(lower + 1, 0), 0).rgb,
               level - float(lower));
}

Parting parting(Ray ray, Hit hit) {
    vec3 point = ray.origin + hit.distance * ray.direction;
    float side = ray.wet ? -1.0 : 1.0;
    vec3 covariance = unresolved(hit.level);
    vec2 slope = hit.slope;
#ifdef RIPPLES
    vec2 rest = (point.xz - waves_at(waves, shifts, point.xz, hit.level).xy) / waves.tile_m;
    float left = exp(-0.5 * ripple_wave * ripple_wave * hit.sigma_m * hit.sigma_m);
    slope += left * detail_slope(detail, ripples, fract(rest));
    covariance.xz += (1.0 - left * left) * ripple_variance;
#endif
    Facets facets = Facets(ray.direction, slope, covariance, side);
    vec3 glitter = vec3(0.0);
#ifdef SUN
    glitter = sunlight(facets, sun, seen_slopes, refractive_index, SLACK);
#endif
    vec3 against = side * normal_of(drawn_slope(facets, seen_slopes, ray.key));
    float cosine = clamp(-dot(ray.direction, against), 0.0, 1.0);
    float m = ray.wet ? 1.0 / refractive_index : refractive_index;
    float reflectance = fresnel(cosine, m);
    float apart = sqrt(max(covariance.x + covariance.z, 0.0) / float(SAMPLES * SAMPLES));
    float width = ray.width + ray.spread * hit.distance;
    int generation = ray.generation + 1;
    float growth = min(sqrt(solid_angle_change(max(cosine, 1e-9), m)), WIDEST);
    vec3 bent = normalize(refract_clamped(ray.direction, against, 1.0 / m));
    return Parting(
        Ray(point, reflect(ray.direction, against), ray.weight * reflectance, width, ray.spread,
            length(vec2(ray.lobe, 2.0 * apart)), next_key(ray.key, 1u), generation, ray.wet),
        Ray(point, bent, ray.weight * ((1.0 - reflectance) / (m * m)), width, ray.spread * growth,
            length(vec2(ray.lobe, abs(1.0 - 1.0 / m) * apart)), next_key(ray.key, 2u), generation, !ray.wet),
        glitter
    );
}

Hit next_hit(Ray ray, float far) {
    return first_hit(waves, heights, ray.origin, ray.direction, ray.wet ? -1.0 : 1.0, ray.width, ray.spread,
                     far < 0.0 ? FARTHEST_M : min(far, FARTHEST_M), ray.generation > 0);
}
