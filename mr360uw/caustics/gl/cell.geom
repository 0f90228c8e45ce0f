// Bounding rectangle of a cell that is larger than the driver's points. Held to caustics/flux/deposit.py.
layout(points) in;
layout(triangle_strip, max_vertices = 4) out;
uniform float size;
flat in vec4 cell_ab[];
flat in vec4 cell_cd[];
flat in vec4 cell_light_at[];
flat in vec2 cell_extent[];
flat out vec4 quad_ab;
flat out vec4 quad_cd;
flat out vec4 quad_light_at;

void main() {
    if (cell_extent[0].x == 0.0) return;
    for (int k = 0; k < 4; ++k) {
        quad_ab = cell_ab[0];
        quad_cd = cell_cd[0];
        quad_light_at = cell_light_at[0];
        gl_Position = vec4((cell_light_at[0].zw + cell_extent[0] * vec2(k & 1, k >> 1)) / vec2(size, size + 0.5) - 1.0, 0.0, 1.0);
        EmitVertex();
    }
    EndPrimitive();
}
