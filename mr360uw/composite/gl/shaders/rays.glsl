// Ray-triangle intersection, one ray or four at once. Held to rays.py.
// A facet is three vectors of a triangle: a ray d meets it if d.a, d.b, d.c are not negative. Their sum is one over the
// distance, and divided by it they are the barycentric weights of the corners.
struct Facet {
    vec3 a;
    vec3 b;
    vec3 c;
    float side;  // -1 or 1 if only one side is shown: -1 where it faces the origin; 0 for both
};

Facet make_facet(vec3 a, vec3 b, vec3 c) {
    vec3 bc = cross(b, c - b);
    float volume = dot(a, bc);
    return Facet(bc / volume, cross(c, a - c) / volume, cross(a, b - a) / volume, 0.0);
}

// (weights of the corners, distance)
vec4 barycentric(Facet facet, vec3 direction) {
    vec3 weights = vec3(dot(direction, facet.a), dot(direction, facet.b), dot(direction, facet.c));
    float total = weights.x + weights.y + weights.z;
    if (abs(total) < 1e-30) total = 1e-30;
    return vec4(weights, 1.0) / total;
}

// four rays and their nearest hits: triangle + 1, one over the distance, smooth piece; 0 for no hit
struct Four {
    vec4 x, y, z;
    vec4 triangle, nearness, piece;
};

// longitude, latitude: (cosine, sine) of one direction. turns: (cosine, sine, cosine, sine) of the angles added to them
Four four_rays(vec2 longitude, vec2 latitude, vec4 turns[4]) {
    Four four;
    for (int k = 0; k < 4; ++k) {
        vec4 t = turns[k];
        vec2 lon = vec2(longitude.x * t.x - longitude.y * t.y, longitude.y * t.x + longitude.x * t.y);
        vec2 lat = vec2(latitude.x * t.z - latitude.y * t.w, latitude.y * t.z + latitude.x * t.w);
        four.x[k] = lat.x * lon.y;
        four.y[k] = lat.y;
        four.z[k] = -lat.x * lon.x;
    }
    four.triangle = four.nearness = four.piece = vec4(0.0);
    return four;
}

vec4 products(Four four, vec3 v) {
    return v.x * four.x + v.y * four.y + v.z * four.z;
}

// one over the distance at which each ray hits a triangle, 0 for no hit
vec4 hits(Four four, Facet facet) {
    vec4 u = products(four, facet.a), v = products(four, facet.b), w = products(four, facet.c);
    vec4 inside = step(0.0, min(u, min(v, w)));
    return inside * (u + v + w);
}

// record a triangle as the hit of the rays that it is nearest for
void keep(inout Four four, vec4 hit, float triangle, float piece) {
    for (int k = 0; k < 4; ++k) {
        bool nearer = hit[k] > four.nearness[k];
        four.triangle[k] = nearer ? triangle : four.triangle[k];
        four.nearness[k] = nearer ? hit[k] : four.nearness[k];
        four.piece[k] = nearer ? piece : four.piece[k];
    }
}
