// Luma codes of a tile over the plate, and the steps of its chroma.
// Held to yuv/decoding.py, composite/over.py, video/pixels/kernels.py
#include "composite/gl/shaders/plate.glsl"
uniform usampler2D y_codes, u_codes, v_codes;
uniform sampler2D decoded, encoded;  // tables, lists
uniform sampler2D radiance, alpha;   // lists of the pixels of `covered`
uniform sampler2D ratio, veil;       // of the rows of `relit`
uniform sampler2D shafts;            // of all pixels of the tile
uniform ivec2 corner, size;          // of the tile: column and row, columns and rows
uniform ivec4 covered;               // of the tile: column, row, columns, rows
uniform ivec2 relit;                 // the first row and the one after the last
uniform bool lit;                    // whether there are shafts
uniform bool wrap;
uniform int frame;
uniform float peak;
uniform vec4 spans;  // offset and span of luma, offset and span of chroma
uniform mat3 rgb_from_ycbcr, ycbcr_from_rgb;
#if defined(GAMUT)
uniform mat3 rec709_from_plate, plate_from_rec709;
#endif
layout(location = 0) out uint code;
layout(location = 1) out vec4 steps;  // of Cb and Cr in codes, coverage, 1 where the plate changes

float between_rows(usampler2D plane, int i, int j, int far) {
    vec2 weights = vec2(1.0 - 0.25 * float(SY), 0.25 * float(SY)) / spans.w;
    return -spans.z / spans.w + weights.x * code_at(plane, i, j) + weights.y * code_at(plane, i, far);
}

// Sited at the even columns, between the rows of a pair.
float chroma(usampler2D plane, ivec2 place) {
    ivec2 extent = textureSize(plane, 0);
    int i = place.x >> SX, j = place.y >> SY, far = j;
    if (SY == 1) far = (place.y & 1) == 1 ? min(j + 1, extent.y - 1) : max(j - 1, 0);
    float value = between_rows(plane, i, j, far);
    if (SX == 0 || (place.x & 1) == 0) return value;
    int after = i + 1 < extent.x ? i + 1 : wrap ? 0 : i;
    return 0.5 * (value + between_rows(plane, after, j, far));
}

float decode(float signal) {
    float place = clamp((signal - DECODE_LOW) * DECODE_SCALE, 0.0, DECODE_LAST);
    int i = int(place);
    float low = listed(decoded, i);
    return low + (place - float(i)) * (listed(decoded, i + 1) - low);
}

float encode(float light) {
    uint bits = floatBitsToUint(light), magnitude = bits & 0x7fffffffu, mask = (1u << ENCODE_STEP_BITS) - 1u;
    int i = clamp(int(magnitude >> ENCODE_STEP_BITS) - ENCODE_LOW, 0, ENCODE_STEPS - 1);
    i += int(bits >> 31) * (ENCODE_STEPS + 1);
    float low = listed(encoded, i), part = float(magnitude & mask) / float(mask + 1u);
    return low + part * (listed(encoded, i + 1) - low);
}

void main() {
    ivec2 p = ivec2(gl_FragCoord.xy), place = corner + p, inside = p - covered.xy;
    vec4 body = vec4(0.0);
    if (all(greaterThanEqual(inside, ivec2(0))) && all(lessThan(inside, covered.zw))) {
        int n = inside.y * covered.z + inside.x;
        body = vec4(listed_color(radiance, n), listed(alpha, n));
    }
    vec3 factor = vec3(1.0), haze = vec3(0.0), added = vec3(0.0);
    if (p.y >= relit.x && p.y < relit.y) {
        int n = (p.y - relit.x) * size.x + p.x;
        factor = listed_color(ratio, n);
        haze = listed_color(veil, n);
    }
    if (lit) added = listed_color(shafts, p.y * size.x + p.x);
    code = texelFetch(y_codes, place, 0).r;
    steps = vec4(0.0);
    if (body == vec4(0.0) && factor == vec3(1.0) && added == vec3(0.0)) return;

    float luma = (float(code) - spans.x) / spans.y;
    vec3 old = rgb_from_ycbcr * vec3(luma, chroma(u_codes, place), chroma(v_codes, place));
    vec3 below = vec3(decode(old.r), decode(old.g), decode(old.b));
#if defined(GAMUT)
    below = rec709_from_plate * below;
#endif
    vec3 before = below;
    float least = 1.0;
    for (int c = 0; c < 3; ++c) {
        if (before[c] < 0.0) continue;
        if (factor[c] != 1.0) {
            float clipped = min(haze[c], before[c]);
            below[c] = clipped + (before[c] - clipped) * factor[c];
        }
        if (lit) below[c] = max(below[c] + added[c], 0.0);
        if (below[c] < least * before[c]) least = below[c] / before[c];
    }
    for (int c = 0; c < 3; ++c) {
        if (before[c] < 0.0) below[c] = least * before[c] + max(added[c], 0.0);
    }
    float clear = 1.0 - body.a;
    vec3 light = body.rgb + clear * below;
#if defined(GAMUT)
    light = plate_from_rec709 * light;
#endif
    vec3 signal = vec3(encode(light.r), encode(light.g), encode(light.b));
    vec3 change = clamp(signal, clear * min(old, 0.0), 1.0 + clear * max(old - 1.0, 0.0)) - old;
    vec3 ycbcr = spans.yww * (ycbcr_from_rgb * change);
    code = quantised(float(code) + ycbcr.x, dither(place, frame), peak);
    steps = vec4(ycbcr.yz, body.a, 1.0);
}
