#include "composite/gl/shaders/geometry.glsl"
uniform mat4 sun_from_object;
uniform vec4 slot;
in vec4 corner;
out float along;
#if defined(MASKED)
uniform sampler2D triangles;
out vec2 uv;
out float vertex_alpha;
flat out int material_row;
#endif

void main() {
    vec3 place = (sun_from_object * vec4(corner.xyz, 1.0)).xyz;
    along = place.z;
    gl_Position = vec4((place.xy - slot.xy) * slot.zw, 0.0, 1.0);
#if defined(MASKED)
    int first = gl_VertexID / 3 * TRIANGLE_TEXELS, texel = first + 3 * (gl_VertexID - gl_VertexID / 3 * 3);
    uv = vec2(listed(triangles, texel).w, listed(triangles, texel + 1).w);
    vertex_alpha = listed(triangles, texel + 2).a;
    material_row = int(listed(triangles, first + 9).x) * MATERIAL_TEXELS;
#endif
}
