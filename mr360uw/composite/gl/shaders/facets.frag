// Per triangle of a body: the rectangle of pixels that it may cover, and its vectors for ray intersection (rays.glsl).
// Held to composite/tiles.py and rays.py.
#include "composite/gl/shaders/geometry.glsl"
#include "composite/gl/shaders/tiles.glsl"
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

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int number = (at.y - first_row) * FACET_COLUMNS + at.x;
    Triangle t = fetch_triangle(triangles, camera_from_object, min(number, count - 1));
    float volume = dot(t.a, cross(t.b, t.c - t.b));
    vec4 more = listed(materials, t.material * MATERIAL_TEXELS + 3);
    bool shown = number < count && volume != 0.0 && (volume < 0.0 || more.y > 0.0);
    vec4 rectangle = floor(rectangle_of_triangle(t.a, t.b, t.c, frame_size) + MARGIN * vec4(-1.0, -1.0, 1.0, 1.0));
    rectangle.yw = clamp(rectangle.yw, 0.0, frame_size.y - 1.0);
    if (rectangle.z - rectangle.x >= frame_size.x) rectangle.xz = vec2(0.0, frame_size.x - 1.0);
    rectangle.xz -= frame_size.x * floor(rectangle.x / frame_size.x);
    pixels = shown ? rectangle : vec4(0.0, 0.0, -1.0, -1.0);
    Facet facet = make_facet(t.a, t.b, t.c);
    facet_a = vec4(facet.a, first_piece + t.patch_number);
    nearest = nearest_of(t, facet);
    facet_b = vec4(facet.b, nearest);
    facet_c = vec4(facet.c, 0.0);
#if defined(CUTOUTS)
    mat3x2 uv = fetch_uv(triangles, t.first);
    float alpha = listed(materials, t.material * MATERIAL_TEXELS).a;
    cutout_a = vec4(uv[0], uv[1]);
    cutout_b = vec4(uv[2], alpha * listed(triangles, t.first + 2).a, alpha * listed(triangles, t.first + 5).a);
    cutout_c = vec4(alpha * listed(triangles, t.first + 8).a, more.x, more.w < 0.0 ? -1.0 : first_map + more.w, 0.0);
#endif
}
