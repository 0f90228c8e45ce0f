// Footprints of pixels on surfaces, over which shadows are averaged: a middle and two sides. Held to
// composite/lighting/shadow.py.
struct Footprint {
    vec3 middle;
    mat2x3 sides;
};

// derivative of a point on a plane by a frame coordinate; neighbour: direction that lies `pixels` pixels farther
vec3 pixel_step(vec3 point, vec3 normal, vec3 neighbour, float pixels) {
    float cosine = dot(normal, neighbour), along = abs(cosine) > 1e-6 ? dot(normal, point) / cosine : 0.0;
    vec3 flat_step = neighbour * length(point) - point, slanted = neighbour * along - point;
    float shorter = min(LONGEST_FOOTPRINT * length(flat_step) / max(length(slanted), 1e-18), 1.0);
    return (along > 0.0 ? slanted * shorter : flat_step) / pixels;
}

// offset, matrix: (x, y) and (xx, xy, yy) of an area of the frame
Footprint footprint_of(vec3 point, mat2x3 steps, vec2 offset, vec3 matrix) {
    return Footprint(point + steps * offset, steps * mat2(matrix.xy, matrix.yz));
}
