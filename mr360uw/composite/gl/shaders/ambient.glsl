// Values of ambient light at a place of a body, three texels of a list for each knot. Held to composite/ambient/lattice.py
// and composite/ambient/knot_values.py.
struct Among {
    vec3 ratio;  // of irradiance
    float visible;
    vec4 about;  // visibility as a + b.d
    vec3 instead;  // light of what blocks
};

int knot_row(int steps, int i) {
    return i * (2 * steps + 3 - i) >> 1;
}

// three knots and their weights; twin: lattice.py
ivec3 knots_at(vec4 places, vec3 weights, out vec3 shares) {
    int steps = int(places.w);
    weights = max(weights, 0.0);
    vec2 along = weights.yz / max(weights.x + weights.y + weights.z, 1e-12) * float(steps);
    int i = min(int(along.x), steps - 1), j = min(int(along.y), steps - 1 - i);
    float u = along.x - float(i), v = along.y - float(j);
    bool upper = u + v > 1.0 && i + j < steps - 1;
    int row = knot_row(steps, i) + j, below = knot_row(steps, i + 1) + j;
    shares = upper ? vec3(u + v - 1.0, 1.0 - v, 1.0 - u) : vec3(1.0 - u - v, u, v);
    return steps == 1 ? ivec3(places.xyz) : int(places.x) + ivec3(upper ? below + 1 : row, below, row + 1);
}

Among among_bodies(sampler2D list, int first, vec4 places, vec3 weights) {
    vec3 shares;
    ivec3 knots = first + 3 * knots_at(places, weights, shares);
    vec4 a = vec4(0.0), b = vec4(0.0), c = vec4(0.0);
    for (int k = 0; k < 3; ++k) {
        a += shares[k] * listed(list, knots[k]);
#if defined(GLOSSY)
        b += shares[k] * listed(list, knots[k] + 1);
        c += shares[k] * listed(list, knots[k] + 2);
#endif
    }
    return Among(a.rgb, a.a, b, c.rgb);
}

vec3 reflected_among(Among among, vec3 reflected, vec3 axis) {
    float seen = clamp(among.about.x + dot(among.about.yzw, axis), 0.0, 1.0);
    float hidden = (1.0 - seen) / max(1.0 - among.visible, 1e-4);
    return reflected * seen + among.instead * hidden;
}
