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

// `coefficients` holds them one after the other in rows of its width, those of the level from `first` on, n across the
// tile. `rest` is in points.
Displacement displacement(sampler2D coefficients, int first, int n, float per_m, vec2 rest) {
    vec2 i = floor(rest);
    vec2 f = rest - i;
    i -= float(n) * floor(i / float(n));
    vec4 x = spline_basis(f.x), dx = spline_slope(f.x), z = spline_basis(f.y), dz = spline_slope(f.y);
    Displacement d = Displacement(vec3(0.0), vec3(0.0), vec3(0.0));
    int width = textureSize(coefficients, 0).x;
    for (int row = 0; row < 4; ++row) {
        int line = first + (int(i.y) + row + n - 1) % n * n;
        vec3 value = vec3(0.0), slope = vec3(0.0);
        for (int column = 0; column < 4; ++column) {
            int at = line + (int(i.x) + column + n - 1) % n;
            vec3 c = texelFetch(coefficients, ivec2(at % width, at / width), 0).rgb;
            value += x[column] * c;
            slope += dx[column] * c;
        }
        d.value += z[row] * value;
        d.by_a += z[row] * per_m * slope;
        d.by_b += dz[row] * per_m * value;
    }
    return d;
}
