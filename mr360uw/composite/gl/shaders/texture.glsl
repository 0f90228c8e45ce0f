// Trilinear lookup of texture maps. Held to composite/mesh/texture.py.
// All levels of all maps lie in one store, row after row; a map is (address / 64, width, height, wrap).
const int STORE_COLUMNS = 4096;
const int STORE_ALIGNMENT = 64;

// in floating point, because software drivers divide integers one lane at a time
int periodic(int index, int period) {
    int rest = index - period * int(floor(float(index) / float(period)));
    return rest < 0 ? rest + period : rest >= period ? rest - period : rest;
}

int wrapped(int index, int size, int wrap) {
    if (wrap == 1) return clamp(index, 0, size - 1);
    if (wrap == 0) return periodic(index, size);
    int folded = periodic(index, 2 * size);
    return min(folded, 2 * size - 1 - folded);
}

vec4 stored(sampler2D store, int address) {
    return texelFetch(store, ivec2(address & (STORE_COLUMNS - 1), address >> 12), 0);
}

vec4 bilinear_level(sampler2D store, int address, ivec2 size, ivec2 wrap, vec2 uv) {
    vec2 p = uv * vec2(size) - 0.5;
    ivec2 i = ivec2(floor(p));
    vec2 f = p - vec2(i);
    int i0 = wrapped(i.x, size.x, wrap.x), i1 = wrapped(i.x + 1, size.x, wrap.x);
    int upper = address + size.x * wrapped(i.y, size.y, wrap.y);
    int lower = address + size.x * wrapped(i.y + 1, size.y, wrap.y);
    return mix(mix(stored(store, upper + i0), stored(store, upper + i1), f.x),
               mix(stored(store, lower + i0), stored(store, lower + i1), f.x), f.y);
}

float texture_level(vec2 size, vec2 du, vec2 dv) {
    float a = length(du * size), b = length(dv * size);
    float longer = max(a, b);
    float extent = sqrt(longer * max(min(a, b), longer / 16.0));
    return clamp(log2(max(extent, 1e-6)), 0.0, floor(log2(max(size.x, size.y)) + 1e-4));
}

vec4 texture_lookup(sampler2D store, vec4 map, vec2 uv, vec2 du, vec2 dv) {
    ivec2 size = ivec2(map.yz);
    ivec2 wrap = ivec2(int(mod(map.w, 3.0)), int(map.w / 3.0));
    float level = texture_level(map.yz, du, dv);
    int address = int(map.x) * STORE_ALIGNMENT;
    for (int k = int(level); k > 0; --k) {
        address += size.x * size.y;
        size = max(size >> 1, ivec2(1));
    }
    vec4 value = bilinear_level(store, address, size, wrap, uv);
    float fraction = fract(level);
    if (fraction == 0.0) return value;
    vec4 coarser = bilinear_level(store, address + size.x * size.y, max(size >> 1, ivec2(1)), wrap, uv);
    return mix(value, coarser, fraction);
}
