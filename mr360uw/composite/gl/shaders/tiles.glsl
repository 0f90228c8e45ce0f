// Exact rectangle of longitudes and latitudes of a triangle seen from the origin. Held to composite/tiles.py.
#include "sphere.glsl"

// (south, north) latitude of the great circle arc from p to q, both unit
vec2 edge_latitudes(vec3 p, vec3 q) {
    vec3 normal = cross(p, q);
    float squared = max(dot(normal, normal), 1e-20);
    vec3 top = vec3(0.0, 1.0, 0.0) - normal * (normal.y / squared);
    float highest = asin(clamp(length(top), 0.0, 1.0));
    float after = dot(cross(p, top), normal), before = dot(cross(top, q), normal);
    float at_p = asin(clamp(p.y, -1.0, 1.0)), at_q = asin(clamp(q.y, -1.0, 1.0));
    vec2 range = vec2(min(at_p, at_q), max(at_p, at_q));
    if (after > 0.0 && before > 0.0) range.y = highest;
    if (after < 0.0 && before < 0.0) range.x = -highest;
    return range;
}

// +1 where a triangle seen from the origin lies over the upper pole, -1 over the lower, 0 over neither
float pole_of_triangle(vec3 a, vec3 b, vec3 c) {
    vec3 side = vec3(cross(a, b).y, cross(b, c).y, cross(c, a).y);
    if (!(all(greaterThanEqual(side, vec3(0.0))) || all(lessThanEqual(side, vec3(0.0))))) return 0.0;
    return sign(cross(b - a, c - a).y * dot(a, cross(b, c)));
}

// frame coordinates of three directions, unwrapped: the second and third as near to the first as possible
mat3x2 unwrapped(vec3 p, vec3 q, vec3 r, vec2 size) {
    mat3x2 places = mat3x2(frame_from_direction(p, size), frame_from_direction(q, size), frame_from_direction(r, size));
    places[1].x += size.x * floor((places[0].x - places[1].x) / size.x + 0.5);
    places[2].x += size.x * floor((places[1].x - places[2].x) / size.x + 0.5);
    return places;
}

// (left, top, right, bottom) in frame coordinates
vec4 rectangle_of_triangle(vec3 a, vec3 b, vec3 c, vec2 size) {
    vec3 p = normalize(a), q = normalize(b), r = normalize(c);
    vec2 pq = edge_latitudes(p, q), qr = edge_latitudes(q, r), rp = edge_latitudes(r, p);
    float south = min(pq.x, min(qr.x, rp.x)), north = max(pq.y, max(qr.y, rp.y));
    float pole = pole_of_triangle(a, b, c);
    if (pole > 0.0) north = 0.5 * PI;
    if (pole < 0.0) south = -0.5 * PI;
    float top = size.y * (0.5 - north / PI), bottom = size.y * (0.5 - south / PI);
    if (pole != 0.0) return vec4(0.0, top, size.x, bottom);
    mat3x2 at = unwrapped(p, q, r, size);
    return vec4(min(at[0].x, min(at[1].x, at[2].x)), top, max(at[0].x, max(at[1].x, at[2].x)), bottom);
}
