// (top, -bottom) of a body along the light in one texel, for MAX blending; masked texels are left out.
// Held to composite/lighting/blockers.py.
#include "composite/gl/shaders/geometry.glsl"
#if defined(MASKED)
uniform sampler2D materials, store;
in vec2 uv;
in float vertex_alpha;
flat in int material_row;
#endif
in float along;
#if defined(PROJECTED)
uniform float middle;
#endif
out vec2 column;

void main() {
#if defined(MASKED)
    float alpha = vertex_alpha * listed(materials, material_row).a;
    vec4 map = listed(materials, material_row + 4);
    if (map.x >= 0.0) alpha *= texture_lookup(store, map, uv, vec2(0.0), vec2(0.0)).a;
    if (alpha < listed(materials, material_row + 3).x) discard;
#endif
#if defined(PROJECTED)
    float top = middle * middle * gl_FragCoord.w;  // over the distance along the axis, which perspective divides by
#else
    float top = along;
#endif
    column = vec2(top, -top);
}
