// (top, -bottom) of the columns of sun_map.frag as shadow.glsl reads them: (1, top, bottom) above the lowest, or nothing
uniform sampler2D drawn, casters;
uniform int slot_size;
uniform int slot_columns;
out vec4 column;

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    ivec2 slot = place / slot_size;
    int number = min(slot.y * slot_columns + slot.x, textureSize(casters, 0).y - 1);
    float lowest = texelFetch(casters, ivec2(1, number), 0).x;
    vec2 ends = texelFetch(drawn, place, 0).rg;
    column = ends.r < -1e8 ? vec4(0.0) : vec4(1.0, ends.r - lowest, -ends.g - lowest, 0.0);
}
