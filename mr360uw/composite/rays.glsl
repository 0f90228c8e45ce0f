// twin: rays.py
// the weights are given without their sum: rays that share an edge of two triangles see the same number twice
struct Facet {
    vec3 bc;
    vec3 ca;
    vec3 ab;
    float volume;
};

Facet make_facet(vec3 a, vec3 b, vec3 c) {
    vec3 bc = cross(b, c - b);
    return Facet(bc, cross(c, a - c), cross(a, b - a), dot(a, bc));
}

vec3 facet_weights(Facet facet, vec3 direction) {
    return vec3(dot(direction, facet.bc), dot(direction, facet.ca), dot(direction, facet.ab));
}

vec4 barycentric(Facet facet, vec3 direction) {
    vec3 weights = facet_weights(facet, direction);
    float total = weights.x + weights.y + weights.z;
    if (abs(total) < 1e-30) total = 1e-30;
    return vec4(weights, facet.volume) / total;
}
