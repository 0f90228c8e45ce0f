// twin: detail.py
struct Detail {
    vec2 repeats;
    vec4 offset;  // x, z of the first map, x, z of the second
};

vec2 periodic_slope(sampler2D slopes, vec2 uv) {
    int n = textureSize(slopes, 0).x;
    vec2 p = uv * float(n);
    vec2 i = floor(p);
    vec2 f = p - i;
    i -= float(n) * floor(i / float(n));
    ivec2 i0 = ivec2(i);
    ivec2 i1 = ivec2(i0.x + 1 < n ? i0.x + 1 : 0, i0.y + 1 < n ? i0.y + 1 : 0);
    return mix(mix(texelFetch(slopes, i0, 0).rg, texelFetch(slopes, ivec2(i1.x, i0.y), 0).rg, f.x),
               mix(texelFetch(slopes, ivec2(i0.x, i1.y), 0).rg, texelFetch(slopes, i1, 0).rg, f.x), f.y);
}

// uv: place in tiles
vec2 detail_slope(Detail detail, sampler2D slopes, vec2 uv) {
    return periodic_slope(slopes, detail.repeats.x * uv + detail.offset.xy)
         + periodic_slope(slopes, detail.repeats.y * uv.yx + detail.offset.wz).yx;
}
