// (top, -bottom) of a body along the light in one texel, for MAX blending; masked and clear texels are left out.
// PASSED: the fraction of light that a surface lets through instead, for blending by products.
// Held to composite/lighting/shadow.py.
#include "composite/gl/shaders/geometry.glsl"
#if defined(READS_ALPHA)
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
    float passed = 0.0;
#if defined(READS_ALPHA)
    float alpha = vertex_alpha * listed(materials, material_row).a;
    vec4 map = listed(materials, material_row + 4);
    if (map.x >= 0.0) alpha *= texture_lookup(store, map, uv, vec2(0.0), vec2(0.0)).a;
#if defined(MASKED)
    if (alpha < listed(materials, material_row + 3).x) discard;
#else
    if (alpha <= 0.0) discard;
    passed = 1.0 - min(alpha, 1.0);
#endif
#endif
#if defined(PROJECTED)
    float top = middle * middle * gl_FragCoord.w;  // over the distance along the axis, which perspective divides by
#else
    float top = along;
#endif
#if defined(PASSED)
    column = vec2(passed);
#else
    column = vec2(top, -top);
#endif
}
