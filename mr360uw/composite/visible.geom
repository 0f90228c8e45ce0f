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

void emit_rectangle(vec4 rectangle, Facet facet) {
    for (int k = 0; k < 4; ++k) {
        vec2 corner = vec2((k & 1) == 0 ? rectangle.x : rectangle.z, (k & 2) == 0 ? rectangle.y : rectangle.w);
        vec2 place = raster_from_frame(corner - window.xy, gaussian) - raster_origin;
        gl_Position = vec4(2.0 * place / raster_size - 1.0, 0.0, 1.0);
        bc = facet.bc; ca = facet.ca; ab = facet.ab; volume = facet.volume;
        number = float(gl_PrimitiveIDIn);
        EmitVertex();
    }
    EndPrimitive();
}

void main() {
    vec3 a = placed[0].xyz, b = placed[1].xyz, c = placed[2].xyz;
    Facet facet = make_facet(a, b, c);
    if (facet.volume == 0.0 || (facet.volume > 0.0 && placed[0].w == 0.0)) return;
    vec4 rectangle = rectangle_of_triangle(a, b, c, frame_size) + vec4(-0.02, -0.02, 0.02, 0.02);
    if (rectangle.w < window.y || rectangle.y > window.y + window.w) return;
    // the copy of the triangle that lies in the window, and its neighbours a turn away
    float turn = floor((window.x + window.z - rectangle.x) / frame_size.x) * frame_size.x;
    for (int k = 0; k < 3; ++k, turn -= frame_size.x) {
        if (rectangle.z + turn < window.x || rectangle.x + turn > window.x + window.z) continue;
        emit_rectangle(rectangle + vec4(turn, 0.0, turn, 0.0), facet);
    }
}
