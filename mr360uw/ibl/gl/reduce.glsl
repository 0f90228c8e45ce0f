// Means of the expanded plate over the cells of a coarse map. Held to ibl/plate.py.
#include "ibl/expansion.glsl"
#include "sphere.glsl"
// `gains` is a row of gains over the luma of code values; `curve` a row of the transfer's inverse over linear light's
// square root: tables that reduction.py fills from the functions of the reference
struct Expansion {
    vec3 luma_weight;
    float edge;
    float ramp;
    vec3 up;  // of the world, in the axes of the frame
};

float table_lookup(sampler2D table, float x) {
    int last = textureSize(table, 0).x - 1;
    float p = clamp(x, 0.0, 1.0) * float(last);
    int i = min(int(p), last - 1);
    return mix(texelFetch(table, ivec2(i, 0), 0).r, texelFetch(table, ivec2(i + 1, 0), 0).r, p - float(i));
}

float expansion_gain(Expansion expansion, sampler2D gains, sampler2D curve, vec3 linear_rgb) {
    vec3 x = sqrt(clamp(linear_rgb, 0.0, 1.0));
    vec3 code = vec3(table_lookup(curve, x.r), table_lookup(curve, x.g), table_lookup(curve, x.b));
    return table_lookup(gains, dot(expansion.luma_weight, code));
}

// mean over the exact solid angle of one cell; xyz = expanded radiance, w = the brightest luminance before expansion
vec4 reduce_cell(Expansion expansion, sampler2D plate, sampler2D gains, sampler2D curve, ivec2 cell, ivec2 cells) {
    ivec2 size = textureSize(plate, 0);
    vec2 low = vec2(cell * size) / vec2(cells);
    vec2 high = vec2((cell + 1) * size) / vec2(cells);
    vec3 sum = vec3(0.0);
    float total = 0.0;
    float peak = 0.0;
    for (int j = int(low.y); j < int(ceil(high.y)); ++j) {
        float top = PI * (0.5 - max(float(j), low.y) / float(size.y));
        float bottom = PI * (0.5 - min(float(j + 1), high.y) / float(size.y));
        float rows = 2.0 * cos(0.5 * (top + bottom)) * sin(0.5 * (top - bottom));
        float latitude = PI * (0.5 - (float(j) + 0.5) / float(size.y));
        float share = region_ramp(latitude, expansion.edge, expansion.ramp);
        for (int i = int(low.x); i < int(ceil(high.x)); ++i) {
            float weight = rows * (min(float(i + 1), high.x) - max(float(i), low.x));
            vec3 value = max(texelFetch(plate, ivec2(i, j), 0).rgb, 0.0);
            if (expansion.up.y < 1.0) {
                vec3 direction = direction_from_frame(vec2(i, j) + 0.5, vec2(size));
                share = region_ramp(asin(clamp(dot(direction, expansion.up), -1.0, 1.0)), expansion.edge, expansion.ramp);
            }
            peak = max(peak, dot(value, vec3(LUMINANCE_R, LUMINANCE_G, LUMINANCE_B)));
            float gain = share > 0.0 ? 1.0 + (expansion_gain(expansion, gains, curve, value) - 1.0) * share : 1.0;
            sum += weight * gain * value;
            total += weight;
        }
    }
    return vec4(sum / total, peak);
}
