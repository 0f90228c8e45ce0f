// Values of ambient light at a place of a body, three texels of a list for each point, or one: the ratio of all light.
// Held to composite/ambient/mesh_transfer.py.
struct Among {
    vec3 ratio;  // of irradiance
    vec3 kept;  // ratio of glossy light
    vec3 instead;  // radiance that is reflected besides
};

int point_row(int steps, int i) {
    return i * (2 * steps + 3 - i) >> 1;
}

// three points and their weights; twin: mesh_transfer.py
ivec3 points_at(vec4 places, vec3 weights, out vec3 shares) {
    int steps = int(places.w);
    weights = max(weights, 0.0);
    vec2 along = weights.yz / max(weights.x + weights.y + weights.z, 1e-12) * float(steps);
    int i = min(int(along.x), steps - 1), j = min(int(along.y), steps - 1 - i);
    float u = along.x - float(i), v = along.y - float(j);
    bool upper = u + v > 1.0 && i + j < steps - 1;
    int row = point_row(steps, i) + j, below = point_row(steps, i + 1) + j;
    shares = upper ? vec3(u + v - 1.0, 1.0 - v, 1.0 - u) : vec3(1.0 - u - v, u, v);
    return steps == 1 ? ivec3(places.xyz) : int(places.x) + ivec3(upper ? below + 1 : row, below, row + 1);
}

Among among_bodies(sampler2D list, int first, int texels, vec4 places, vec3 weights) {
    vec3 shares;
    ivec3 points = first + texels * points_at(places, weights, shares);
    Among among = Among(vec3(0.0), vec3(0.0), vec3(0.0));
    for (int k = 0; k < 3; ++k) {
        among.ratio += shares[k] * listed(list, points[k]).rgb;
#if defined(GLOSSY)
        if (texels > 1) {
            among.kept += shares[k] * listed(list, points[k] + 1).rgb;
            among.instead += shares[k] * listed(list, points[k] + 2).rgb;
        }
#endif
    }
    if (texels == 1) among.kept = among.ratio;
    return among;
}
