// Projection of a body's corners into its slot of the shadow atlas; lamps use the projective map of lamps.glsl.
// Held to composite/lighting/shadow.py.
#include "composite/gl/shaders/geometry.glsl"
uniform mat4 light_from_object;
#if defined(PROJECTED)
uniform float middle, nearest;
#endif
uniform vec4 slot;
in vec4 corner;
out float along;
#if defined(READS_ALPHA)
uniform sampler2D triangles;
out vec2 uv;
out float vertex_alpha;
flat out int material_row;
#endif

void main() {
    vec3 place = (light_from_object * vec4(corner.xyz, 1.0)).xyz;
#if defined(PROJECTED)
    // the map of lamps.glsl; the near plane clips what is too near to cast a shadow
    gl_Position = vec4((place.xy * middle - slot.xy * place.z) * slot.zw, place.z - 2.0 * nearest, place.z);
#else
    gl_Position = vec4((place.xy - slot.xy) * slot.zw, 0.0, 1.0);
#endif
    along = place.z;
#if defined(READS_ALPHA)
    int first = gl_VertexID / 3 * TRIANGLE_TEXELS, texel = first + 3 * (gl_VertexID - gl_VertexID / 3 * 3);
    uv = vec2(listed(triangles, texel).w, listed(triangles, texel + 1).w);
    vertex_alpha = listed(triangles, texel + 2).a;
    material_row = int(listed(triangles, first + 9).x) * MATERIAL_TEXELS;
#endif
}
