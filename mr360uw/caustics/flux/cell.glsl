// twin: cell.py
#include "caustics/flux/coverage.glsl"

const float THINNEST = 2e-3;

struct Cell {
    vec2 a, b, c, d;
};

Cell opened(Cell q) {
    if (abs(twice_area(q.a, q.b, q.c)) >= THINNEST || abs(twice_area(q.a, q.c, q.d)) >= THINNEST) return q;
    vec2 other = q.d - q.b;
    vec2 along = q.c - q.a;
    if (dot(other, other) > dot(along, along)) {
        q.a = q.b;
        q.c = q.d;
    }
    along = q.c - q.a;
    if (dot(along, along) < 0.0025) {
        along = vec2(0.05, 0.0);
        q.c = q.a + along;
    }
    vec2 wide = 1.5 * THINNEST / dot(along, along) * vec2(along.y, -along.x);
    vec2 middle = q.a + 0.5 * along;
    q.b = middle + wide;
    q.d = middle - wide;
    return q;
}

vec2 intensities(Cell q, float flux_b, float flux_d) {
    float b = twice_area(q.a, q.b, q.c);
    float d = twice_area(q.a, q.c, q.d);
    if (abs(b) < THINNEST) return vec2(0.0, 2.0 * (flux_b + flux_d) / d);
    if (abs(d) < THINNEST) return vec2(2.0 * (flux_b + flux_d) / b, 0.0);
    return vec2(2.0 * flux_b / b, 2.0 * flux_d / d);
}

// corners relative to the pixel
float cell_light(Cell q, vec2 intensity) {
    float across = edge_coverage(q.c, q.a);
    float b = edge_coverage(q.a, q.b) + edge_coverage(q.b, q.c) + across;
    float d = edge_coverage(q.c, q.d) + edge_coverage(q.d, q.a) - across;
    return intensity.x * b + intensity.y * d;
}
