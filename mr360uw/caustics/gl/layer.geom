// Full-screen triangle into one layer of the target. Held to caustics/flux/irradiance.py.
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;
uniform int layer;

void main() {
    for (int k = 0; k < 3; ++k) {
        gl_Layer = layer;
        gl_Position = gl_in[k].gl_Position;
        EmitVertex();
    }
    EndPrimitive();
}
