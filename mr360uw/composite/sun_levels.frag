// the halves of every slot, their halves, ... above each other
uniform sampler2D halves;
uniform int slot_size;
uniform int first_column;
out vec4 column;

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy) - ivec2(first_column, 0);
    int size = slot_size >> 1, level = 0;
    ivec2 slot = place / ivec2(size, slot_size);
    ivec2 inside = place - slot * ivec2(size, slot_size);
    while (inside.y >= size && size > 1) {
        inside.y -= size;
        size >>= 1;
        ++level;
    }
    column = inside.x < size ? texelFetch(halves, slot * size + inside, level) : vec4(0.0);
}
