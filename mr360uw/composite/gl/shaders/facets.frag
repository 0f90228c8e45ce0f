// Per triangle of a body: the rectangle of pixels that it may cover, and its vectors for ray intersection (rays.glsl).
// Held to composite/tiles.py and rays.py.
#include "composite/gl/shaders/geometry.glsl"
#include "composite/gl/shaders/tiles.glsl"
#if defined(EYE)
uniform float eye_m;  // of the eye to the right of the middle, negative to the left
#endif
uniform sampler2D triangles, materials;
uniform mat4 camera_from_object;
uniform vec2 frame_size;
uniform int count;
uniform int first_row;
uniform float first_piece;
layout(location = 0) out vec4 pixels;
layout(location = 1) out vec4 facet_a;
layout(location = 2) out vec4 facet_b;
layout(location = 3) out vec4 facet_c;
layout(location = 4) out float nearest;
#if defined(CUTOUTS)
uniform float first_map;
layout(location = 5) out vec4 cutout_a;
layout(location = 6) out vec4 cutout_b;
layout(location = 7) out vec4 cutout_c;
#endif

// pixels added around the rectangle of a triangle, for rounding in single precision
const float MARGIN = 0.02;

// upper bound of one over the distance to a triangle: from its plane, or from its nearest corner less the circumradius
// of an equilateral triangle of its longest edge (0.578 of the edge)
float nearest_of(Triangle t, Facet facet) {
    float plane = 1.0 / length(facet.a + facet.b + facet.c);
    float edge = max(distance(t.a, t.b), max(distance(t.b, t.c), distance(t.c, t.a)));
    float corner = min(length(t.a), min(length(t.b), length(t.c)));
    return 1.0 / (max(plane, corner - 0.578 * edge) * (1.0 - 1e-5));
}

#if defined(EYE)
// least distance [m] between an eye's viewpoints and the plane of a triangle, in which rays cannot be intersected
const float LEAST_M = 1e-5;

// a triangle whose plane holds the middle between the eyes, beside it: an eye sees what the middle sees edge-on
Triangle beside_middle(Triangle t) {
    vec3 normal = cross(t.b - t.a, t.c - t.a);
    float size = length(normal), away = dot(normal, t.a) / max(size, 1e-30);
    if (size == 0.0 || abs(away) >= LEAST_M) return t;
    vec3 shift = (away < 0.0 ? -LEAST_M : LEAST_M) * normal / size;
    return Triangle(t.a + shift, t.b + shift, t.c + shift, t.first, t.material, t.patch_number);
}

// rectangle (left, top, right, bottom) that holds what an eye sees of a triangle (composite/tiles.py)
vec4 seen_rectangle(vec4 rectangle, float nearest) {
    float ratio = abs(eye_m) * nearest;
    if (ratio > 1.0 / NEAREST) return vec4(0.0, 0.0, frame_size);
    float beside = frame_size.x * asin(ratio) / (2.0 * PI), over = frame_size.y * ratio * ratio / PI;
    return rectangle + vec4(eye_m > 0.0 ? -beside : 0.0, -over, eye_m > 0.0 ? 0.0 : beside, over);
}
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int number = (at.y - first_row) * FACET_COLUMNS + at.x;
    Triangle t = fetch_triangle(triangles, camera_from_object, min(number, count - 1));
#if defined(EYE)
    t = beside_middle(t);
#endif
    float volume = dot(t.a, cross(t.b, t.c - t.b)), side = 0.0;
    vec4 more = listed(materials, t.material * MATERIAL_TEXELS + 3);
    bool shown = number < count && volume != 0.0 && (volume < 0.0 || more.y > 0.0);
    Facet facet = make_facet(t.a, t.b, t.c);
    nearest = nearest_of(t, facet);
    vec4 rectangle = rectangle_of_triangle(t.a, t.b, t.c, frame_size);
#if defined(EYE)
    // the plane of a triangle that shows the middle its back may pass between it and an eye
    shown = number < count && volume != 0.0
        && (volume < abs(eye_m) * length(cross(t.b - t.a, t.c - t.a)) || more.y > 0.0);
    side = more.y > 0.0 ? 0.0 : sign(volume);
    rectangle = seen_rectangle(rectangle, nearest);
    nearest *= inversesqrt(max(1.0 - eye_m * eye_m * nearest * nearest, 1e-6));
#endif
    rectangle = floor(rectangle + MARGIN * vec4(-1.0, -1.0, 1.0, 1.0));
    rectangle.yw = clamp(rectangle.yw, 0.0, frame_size.y - 1.0);
    if (rectangle.z - rectangle.x >= frame_size.x) rectangle.xz = vec2(0.0, frame_size.x - 1.0);
    rectangle.xz -= frame_size.x * floor(rectangle.x / frame_size.x);
    pixels = shown ? rectangle : vec4(0.0, 0.0, -1.0, -1.0);
    facet_a = vec4(facet.a, first_piece + t.patch_number);
    facet_b = vec4(facet.b, nearest);
    facet_c = vec4(facet.c, side);
#if defined(CUTOUTS)
    mat3x2 uv = fetch_uv(triangles, t.first);
    float alpha = listed(materials, t.material * MATERIAL_TEXELS).a;
    cutout_a = vec4(uv[0], uv[1]);
    cutout_b = vec4(uv[2], alpha * listed(triangles, t.first + 2).a, alpha * listed(triangles, t.first + 5).a);
    cutout_c = vec4(alpha * listed(triangles, t.first + 8).a, more.x, more.w < 0.0 ? -1.0 : first_map + more.w, 0.0);
#endif
}
