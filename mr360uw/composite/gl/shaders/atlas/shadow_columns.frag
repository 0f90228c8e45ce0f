// Columns of the shadow atlas as shadow.glsl reads them: means of 2 x 2 texels of shadow_atlas.frag.
// Held to composite/lighting/shadow.py.
uniform sampler2D drawn, passed, casters;
uniform int slot_size;
uniform int slot_columns;
out vec4 column;

vec4 filled(ivec2 place, float lowest) {
    vec2 ends = texelFetch(drawn, place, 0).rg;
    float opacity = 1.0;
#if defined(TRANSLUCENT)
    opacity -= texelFetch(passed, place, 0).r;
#endif
    return ends.r < -1e8 ? vec4(0.0) : vec4(1.0, ends.r - lowest, -ends.g - lowest, opacity);
}

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    ivec2 slot = place / slot_size;
    int number = min(slot.y * slot_columns + slot.x, textureSize(casters, 0).y - 1);
    float lowest = texelFetch(casters, ivec2(1, number), 0).x;
    vec4 sum = filled(2 * place, lowest) + filled(2 * place + ivec2(1, 0), lowest)
             + filled(2 * place + ivec2(0, 1), lowest) + filled(2 * place + 1, lowest);
    column = 0.25 * sum;
}
