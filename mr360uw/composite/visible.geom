#include "composite/rays.glsl"
#include "composite/sampling.glsl"
#include "composite/tiles.glsl"
layout(triangles) in;
layout(triangle_strip, max_vertices = 12) out;
uniform vec2 frame_size;
uniform vec4 window;
uniform vec2 gaussian;
uniform vec2 raster_origin;
uniform vec2 raster_size;
in vec4 placed[];
flat out vec3 bc, ca, ab;
flat out float volume;
flat out float number;

// beyond these the rectangle is used: margins in cells, and sharpness of corners as 1 - cos
const float WIDEST_MARGIN = 3.0;
const float SHARPEST = 0.004;

void emit_corner(vec2 place, Facet facet) {
    gl_Position = vec4(2.0 * (place - raster_origin) / raster_size - 1.0, 0.0, 1.0);
    bc = facet.bc; ca = facet.ca; ab = facet.ab; volume = facet.volume;
    number = float(gl_PrimitiveIDIn);
    EmitVertex();
}

void emit_rectangle(vec4 rectangle, float turn, Facet facet) {
    for (int k = 0; k < 4; ++k) {
        vec2 corner = vec2((k & 1) == 0 ? rectangle.x : rectangle.z, (k & 2) == 0 ? rectangle.y : rectangle.w);
        emit_corner(raster_from_frame(corner + vec2(turn, 0.0) - window.xy, gaussian), facet);
    }
    EndPrimitive();
}

// where the lines of two edges that meet at `at` cross once they are moved outwards by a margin
vec2 moved_corner(vec2 at, vec2 along_in, vec2 along_out, float side, float margin) {
    vec2 n = side * vec2(along_in.y, -along_in.x), m = side * vec2(along_out.y, -along_out.x);
    return at + margin * (n + m) / (1.0 + dot(n, m));
}

void main() {
    vec3 a = placed[0].xyz, b = placed[1].xyz, c = placed[2].xyz;
    Facet facet = make_facet(a, b, c);
    if (facet.volume == 0.0 || (facet.volume > 0.0 && placed[0].w == 0.0)) return;
    vec4 rectangle = rectangle_of_triangle(a, b, c, frame_size) + vec4(-0.02, -0.02, 0.02, 0.02);
    if (rectangle.w < window.y || rectangle.y > window.y + window.w) return;
    mat3x2 at = unwrapped(normalize(a), normalize(b), normalize(c), frame_size);
    float margin = bend(at, frame_size) * frame_size.y / PI * length(gaussian) + 0.05;
    vec2 p = raster_from_frame(at[0] - window.xy, gaussian), q = raster_from_frame(at[1] - window.xy, gaussian);
    vec2 r = raster_from_frame(at[2] - window.xy, gaussian);
    vec2 pq = normalize(q - p), qr = normalize(r - q), rp = normalize(p - r);
    float sharpest = 1.0 + min(dot(pq, qr), min(dot(qr, rp), dot(rp, pq)));
    bool tight = margin < WIDEST_MARGIN && sharpest > SHARPEST && pole_of_triangle(a, b, c) == 0.0;
    float side = sign((q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x));
    // the copy of the triangle that lies in the window, and its neighbours a turn away
    float turn = floor((window.x + window.z - rectangle.x) / frame_size.x) * frame_size.x;
    for (int k = 0; k < 3; ++k, turn -= frame_size.x) {
        if (rectangle.z + turn < window.x || rectangle.x + turn > window.x + window.z) continue;
        if (!tight) {
            emit_rectangle(rectangle, turn, facet);
            continue;
        }
        vec2 offset = raster_from_frame(vec2(turn, 0.0), gaussian);
        emit_corner(moved_corner(p, rp, pq, side, margin) + offset, facet);
        emit_corner(moved_corner(q, pq, qr, side, margin) + offset, facet);
        emit_corner(moved_corner(r, qr, rp, side, margin) + offset, facet);
        EndPrimitive();
    }
}
