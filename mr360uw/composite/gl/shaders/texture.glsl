// Trilinear lookup of texture maps, averaged along the longer axis of the pixel. Held to composite/mesh/material.py.
// Each function calls the one above it in a single place: compilers write out every call, and would take seconds.
// All levels of all maps lie in one store, row after row; a map is (address / 64, width, height, wrap).
const int STORE_COLUMNS = 4096;
const int STORE_ALIGNMENT = 64;
const float LARGEST_COUNT = 8.0;

// texels of whole numbers along an axis: repeated (wrap 0), clamped (1) or mirrored (2). In floating point, because
// software drivers divide integers one lane at a time
vec2 wrapped(vec2 index, float size, float wrap) {
    float period = wrap == 2.0 ? 2.0 * size : size;
    vec2 within = wrap == 1.0 ? clamp(index, 0.0, size - 1.0) : index - period * floor((index + 0.5) / period);
    return min(within, 2.0 * size - 1.0 - within);
}

vec4 stored(sampler2D store, int address) {
    return texelFetch(store, ivec2(address & (STORE_COLUMNS - 1), address >> 12), 0);
}

vec4 bilinear_level(sampler2D store, int address, vec2 size, vec2 wrap, vec2 uv) {
    vec2 p = uv * size - 0.5, corner = floor(p), f = p - corner;
    ivec2 column = ivec2(wrapped(corner.x + vec2(0.0, 1.0), size.x, wrap.x));
    ivec2 row = address + int(size.x) * ivec2(wrapped(corner.y + vec2(0.0, 1.0), size.y, wrap.y));
    return mix(mix(stored(store, row.x + column.x), stored(store, row.x + column.y), f.x),
               mix(stored(store, row.y + column.x), stored(store, row.y + column.y), f.x), f.y);
}

// du, dv: changes over half a pixel
vec4 texture_lookup(sampler2D store, vec4 map, vec2 uv, vec2 du, vec2 dv) {
    vec2 size = map.yz, a = du * size, b = dv * size;
    float p = dot(a, a), q = dot(a, b), r = dot(b, b);
    float longer = sqrt(0.5 * (p + r) + length(vec2(0.5 * (p - r), q)));
    float shorter = abs(a.x * b.y - a.y * b.x) / max(longer, 1e-30);
    float extent = max(max(shorter, 2.0 * longer / (LARGEST_COUNT + 1.0)), 1.0);
    float level = min(log2(extent), floor(log2(max(size.x, size.y)) + 1e-4));
    float beyond = max(longer - extent, 0.0);
    int count = min(1 + int(ceil(2.0 * beyond / extent - 1e-4)), int(LARGEST_COUNT));
    vec2 offset = vec2(0.0);
    if (count > 1) {
        float angle = 0.5 * atan(2.0 * q, p - r);
        offset = beyond / longer * (cos(angle) * du + sin(angle) * dv);
    }
    vec2 wrap = vec2(mod(map.w, 3.0), floor(map.w / 3.0));
    int address = int(map.x) * STORE_ALIGNMENT;
    for (int k = int(level); k > 0; --k) {
        address += int(size.x) * int(size.y);
        size = max(floor(0.5 * size), 1.0);
    }
    // all places on the finer of the two levels, then all on the other
    float fraction = fract(level);
    int k = 0, all = fraction == 0.0 ? count : 2 * count;
    vec4 sum = vec4(0.0);
    do {
        if (k == count) {
            address += int(size.x) * int(size.y);
            size = max(floor(0.5 * size), 1.0);
        }
        float place = float(k < count ? k : k - count) / float(max(count - 1, 1));
        sum += (k < count ? 1.0 - fraction : fraction)
             * bilinear_level(store, address, size, wrap, uv + offset * (2.0 * place - 1.0));
    } while (++k < all);
    return sum / float(count);
}
