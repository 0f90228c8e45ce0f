// Trilinear lookup of texture maps, averaged along the longer axis of the pixel. Held to composite/mesh/texture.py.
// Each function calls the one below it in a single place, in a loop: compilers write out every call, and would take seconds.
// All levels of all maps lie in one store, row after row; a map is (address / 64, width, height, wrap).
const int STORE_COLUMNS = 4096;
const int STORE_ALIGNMENT = 64;
const float LARGEST_COUNT = 8.0;

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

vec4 trilinear(sampler2D store, vec4 map, vec2 uv, float level) {
    ivec2 size = ivec2(map.yz);
    ivec2 wrap = ivec2(int(mod(map.w, 3.0)), int(map.w / 3.0));
    int address = int(map.x) * STORE_ALIGNMENT;
    for (int k = int(level); k > 0; --k) {
        address += size.x * size.y;
        size = max(size >> 1, ivec2(1));
    }
    float fraction = fract(level);
    int levels = fraction == 0.0 ? 1 : 2;
    vec4 value = vec4(0.0);
    for (int k = 0; k < levels; ++k) {
        vec4 found = bilinear_level(store, address, size, wrap, uv);
        value = k == 0 ? found : mix(value, found, fraction);
        address += size.x * size.y;
        size = max(size >> 1, ivec2(1));
    }
    return value;
}

// du, dv: changes over half a pixel
vec4 texture_lookup(sampler2D store, vec4 map, vec2 uv, vec2 du, vec2 dv) {
    vec2 a = du * map.yz, b = dv * map.yz;
    float p = dot(a, a), q = dot(a, b), r = dot(b, b);
    float longer = sqrt(0.5 * (p + r) + length(vec2(0.5 * (p - r), q)));
    float shorter = abs(a.x * b.y - a.y * b.x) / max(longer, 1e-30);
    float extent = max(max(shorter, 2.0 * longer / (LARGEST_COUNT + 1.0)), 1.0);
    float level = min(log2(extent), floor(log2(max(map.y, map.z)) + 1e-4));
    float beyond = max(longer - extent, 0.0);
    int count = min(1 + int(ceil(2.0 * beyond / extent - 1e-4)), int(LARGEST_COUNT));
    vec2 offset = vec2(0.0);
    if (count > 1) {
        float angle = 0.5 * atan(2.0 * q, p - r);
        offset = beyond / longer * (cos(angle) * du + sin(angle) * dv);
    }
    vec4 sum = vec4(0.0);
    for (int k = 0; k < count; ++k)
        sum += trilinear(store, map, uv + offset * (2.0 * float(k) / float(max(count - 1, 1)) - 1.0), level);
    return sum / float(count);
}
