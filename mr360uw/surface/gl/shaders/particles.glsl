// Displacement of a sea's particles by the splines of one level. Held to surface/spline.py
vec4 spline_basis(float t) {
    float r = 1.0 - t;
    return vec4(r * r * r, 4.0 - 6.0 * t * t + 3.0 * t * t * t, 4.0 - 6.0 * r * r + 3.0 * r * r * r, t * t * t) / 6.0;
}

vec4 spline_slope(float t) {
    float r = 1.0 - t;
    return 0.5 * vec4(-r * r, t * (3.0 * t - 4.0), -r * (3.0 * r - 4.0), t * t);
}

struct Displacement {
    vec3 value;  // height, shift over x and z
    vec3 by_a;
    vec3 by_b;
};

// four neighbouring points of n, which repeat
ivec4 periodic_four(float first, int n) {
    ivec4 i = int(first) + ivec4(-1, 0, 1, 2);
    return i + n * (ivec4(lessThan(i, ivec4(0))) - ivec4(greaterThanEqual(i, ivec4(n))));
}

// `coefficients` holds those of the level from row `top` on, n across the tile. `rest` is in points.
Displacement displacement(sampler2D coefficients, int top, int n, float per_m, vec2 rest) {
    vec2 i = floor(rest);
    vec2 f = rest - i;
    i -= float(n) * floor(i / float(n));
    vec4 x = spline_basis(f.x), dx = spline_slope(f.x), z = spline_basis(f.y), dz = spline_slope(f.y);
    ivec4 column = periodic_four(i.x, n), row = top + periodic_four(i.y, n);
    Displacement d = Displacement(vec3(0.0), vec3(0.0), vec3(0.0));
    for (int r = 0; r < 4; ++r) {
        vec3 value = vec3(0.0), slope = vec3(0.0);
        for (int k = 0; k < 4; ++k) {
            vec3 c = texelFetch(coefficients, ivec2(column[k], row[r]), 0).rgb;
            value += x[k] * c;
            slope += dx[k] * c;
        }
        d.value += z[r] * value;
        d.by_a += z[r] * per_m * slope;
        d.by_b += dz[r] * per_m * value;
    }
    return d;
}

// of the surface over places (x, z), where its area over the rest area is `across`, at least LEAST_ACROSS
const float LEAST_ACROSS = 0.05;
vec2 slope_over_places(Displacement d, float across) {
    vec2 slope = vec2((1.0 + d.by_b.z) * d.by_a.x - d.by_a.z * d.by_b.x,
                      (1.0 + d.by_a.y) * d.by_b.x - d.by_b.y * d.by_a.x);
    return slope / max(across, LEAST_ACROSS);
}

float area_ratio(Displacement d) {
    return (1.0 + d.by_a.y) * (1.0 + d.by_b.z) - d.by_b.y * d.by_a.z;
}

// shift of the particle nearest to a rest position
vec2 nearest_shift(sampler2D coefficients, int top, int n, vec2 rest) {
    ivec2 i = ivec2(floor(rest + 0.5 - float(n) * floor((rest + 0.5) / float(n))));
    return texelFetch(coefficients, ivec2(i.x, top + i.y), 0).gb;
}
