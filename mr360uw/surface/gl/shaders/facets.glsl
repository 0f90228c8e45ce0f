// Waves smaller than a pixel, by the statistics of their slopes. Held to surface/slopes.py
#include "optics.glsl"

struct Sun {
    vec3 direction;  // in the air
    vec3 irradiance;
    float half_angle_rad;
};

struct Facets {
    vec3 travel;
    vec2 slope;  // mean
    vec3 covariance;  // xx, xz, zz
    float side;  // 1 for rays in air, -1 in water
};

const float LEAST = 1e-12;
const float SHARP = 0.05;

uint pcg(uint k) {
    uint s = k * 747796405u + 2891336453u;
    uint w = ((s >> ((s >> 28u) + 4u)) ^ s) * 277803737u;
    return (w >> 22u) ^ w;
}

uint next_key(uint k, uint salt) {
    return pcg(k ^ pcg(salt));
}

float uniform_number(uint k) {
    return (float(k >> 8u) + 0.5) / 16777216.0;
}

// deviation below which a share of a normal density lies (Giles 2011, single precision)
float normal_quantile(float share) {
    float x = 2.0 * share - 1.0;
    float w = -log((1.0 - x) * (1.0 + x)), p;
    if (w < 5.0) {
        w -= 2.5;
        p = 2.81022636e-08;
        p = 3.43273939e-07 + p * w;
        p = -3.5233877e-06 + p * w;
        p = -4.39150654e-06 + p * w;
        p = 0.00021858087 + p * w;
        p = -0.00125372503 + p * w;
        p = -0.00417768164 + p * w;
        p = 0.246640727 + p * w;
        p = 1.50140941 + p * w;
    } else {
        w = sqrt(w) - 3.0;
        p = -0.000200214257;
        p = 0.000100950558 + p * w;
        p = 0.00134934322 + p * w;
        p = -0.00367342844 + p * w;
        p = 0.00573950773 + p * w;
        p = -0.0076224613 + p * w;
        p = 0.00943887047 + p * w;
        p = 1.00167406 + p * w;
        p = 2.83297682 + p * w;
    }
    return sqrt(2.0) * p * x;
}

vec3 normal_of(vec2 slope) {
    return normalize(vec3(-slope.x, 1.0, -slope.y));
}

float facing(Facets facets, vec2 slope) {
    return facets.side * (dot(facets.travel.xz, slope) - facets.travel.y);
}

// lower triangular root of the covariance: xx, zx, zz
vec3 root_of(vec3 covariance) {
    float xx = sqrt(max(covariance.x, 0.0));
    float zx = covariance.y / max(xx, LEAST);
    return vec3(xx, zx, sqrt(max(covariance.z - zx * zx, 0.0)));
}

// change of `facing` with each of two independent normal numbers
vec2 spread_of(Facets facets, vec3 root) {
    return facets.side * vec2(dot(facets.travel.xz, root.xy), facets.travel.z * root.z);
}

// where c = -mean/spread in (-infinity, 8] lies in a row of `seen_slopes`: facets.py
float seen_row(float mean, float spread) {
    float c = min(-mean / max(spread, LEAST), FARTHEST);
    return (c / (1.0 + abs(c)) + 1.0) / (FARTHEST / (1.0 + FARTHEST) + 1.0);
}

vec2 seen_entry(sampler2D seen_slopes, float quantile, float row) {
    vec2 size = vec2(textureSize(seen_slopes, 0));
    vec2 place = vec2(clamp(0.5 + 0.5 * quantile / QUANTILES, 0.0, 1.0), row);
    return textureLod(seen_slopes, (place * (size - 1.0) + 0.5) / size, 0.0).rg;
}

vec2 drawn_slope(Facets facets, sampler2D seen_slopes, uint key) {
    vec3 root = root_of(facets.covariance);
    vec2 parts = spread_of(facets, root);
    float spread = length(parts);
    float quantile = normal_quantile(uniform_number(next_key(key, 11u)));
    float across = normal_quantile(uniform_number(next_key(key, 12u)));
    float row = seen_row(facing(facets, facets.slope), spread);
    float along = quantile + seen_entry(seen_slopes, quantile, row).x;
    vec2 turn = spread > LEAST ? parts / spread : vec2(1.0, 0.0);
    vec2 g = vec2(turn.x * along - turn.y * across, turn.y * along + turn.x * across);
    return facets.slope + vec2(root.x * g.x, root.y * g.x + root.z * g.y);
}

float mean_facing(Facets facets, sampler2D seen_slopes) {
    float mean = facing(facets, facets.slope), spread = length(spread_of(facets, root_of(facets.covariance)));
    return exp(seen_entry(seen_slopes, 0.0, seen_row(mean, spread)).y) * length(vec2(mean, spread));
}

// the sun's disc over its radiance, by facets of the mean slope alone; the disc is wider by `slack` radians
float sun_disc(Facets facets, Sun sun, float n, float slack) {
    vec3 against = facets.side * normal_of(facets.slope);
    float cosine = clamp(-dot(facets.travel, against), 0.0, 1.0);
    bool below = facets.side < 0.0;
    vec3 outward = below ? refract_clamped(facets.travel, against, n) : reflect(facets.travel, against);
    float factor = below ? radiance_factor(cosine, 1.0 / n) * n * n * n * n : fresnel(cosine, n);
    // the cosine of so small an angle is 1 in single precision
    return length(outward - sun.direction) <= 2.0 * sin(0.5 * (sun.half_angle_rad + slack)) ? factor : 0.0;
}

vec3 sunlight(Facets facets, Sun sun, sampler2D seen_slopes, float n, float slack) {
    vec3 d = facets.travel;
    float half_sine = sin(0.5 * sun.half_angle_rad), solid_angle = 4.0 * PI * half_sine * half_sine;
    bool below = facets.side < 0.0;
    vec3 between = below ? n * d - sun.direction : sun.direction - d;
    float size = length(between);
    vec3 normal = between / max(size, LEAST);
    float cosine = -facets.side * dot(d, normal), at_sun = dot(sun.direction, normal);
    float image = max(solid_angle * max(at_sun, 0.0) / max(size * size, LEAST) / pow(max(abs(normal.y), 1e-3), 3.0), LEAST);
    vec3 c = facets.covariance;
    float own = image / (4.0 * PI);
    float light = 0.0;
    if (sqrt(max(c.x * c.z - c.y * c.y, 0.0)) < SHARP * own) {
        light = sun_disc(facets, sun, n, slack);
    } else if (cosine > 0.0 && normal.y > 0.0 && at_sun > 0.0) {
        vec2 slope = -normal.xz / max(normal.y, LEAST), off = slope - facets.slope;
        float xx = c.x + own, xz = c.y, zz = c.z + own, determinant = max(xx * zz - xz * xz, 1e-30);
        float square = (zz * off.x * off.x - 2.0 * xz * off.x * off.y + xx * off.y * off.y) / determinant;
        if (square < 80.0) {
            float share = min(image * exp(-0.5 * square) / (2.0 * PI * sqrt(determinant)), 1.0);
            float factor = below ? radiance_factor(min(at_sun, 1.0), n) : fresnel(min(cosine, 1.0), n);
            light = share * factor * max(facing(facets, slope), 0.0) / mean_facing(facets, seen_slopes);
        }
    }
    return light / solid_angle * sun.irradiance;
}
