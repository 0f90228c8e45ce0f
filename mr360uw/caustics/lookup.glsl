// twin: lookup.py
// `ratio` holds the mip_atlas of every plane; `plane_depth` has one texel a plane
struct CausticStack {
    float tile_m;
    vec3 sun_direction;
};

vec3 periodic_bilinear(sampler2DArray ratio, int level, int plane, vec2 uv) {
    int full = textureSize(ratio, 0).x;
    int size = full >> level;
    ivec2 origin = ivec2(0, 2 * full - 2 * size);
    vec2 p = uv * float(size) - 0.5;
    ivec2 i = ivec2(floor(p));
    vec2 f = p - vec2(i);
    ivec2 i0 = ((i % size) + size) % size;
    ivec2 i1 = (i0 + 1) % size;
    return mix(mix(texelFetch(ratio, ivec3(origin + i0, plane), 0).rgb,
                   texelFetch(ratio, ivec3(origin + ivec2(i1.x, i0.y), plane), 0).rgb, f.x),
               mix(texelFetch(ratio, ivec3(origin + ivec2(i0.x, i1.y), plane), 0).rgb,
                   texelFetch(ratio, ivec3(origin + i1, plane), 0).rgb, f.x), f.y);
}

vec3 caustic_at_plane(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, int plane, vec3 point, float level) {
    float along = (point.y - texelFetch(plane_depth, ivec2(plane, 0), 0).r) / stack.sun_direction.y;
    vec2 uv = (point.xz + stack.sun_direction.xz * along) / stack.tile_m;
    uv -= floor(uv);
    int lower = int(level);
    vec3 value = periodic_bilinear(ratio, lower, plane, uv);
    if (level == float(lower)) return value;
    return mix(value, periodic_bilinear(ratio, lower + 1, plane, uv), level - float(lower));
}

// point = (x, depth below the mean surface, z)
vec3 caustic_lookup(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, vec3 point, float footprint_m) {
    ivec3 size = textureSize(ratio, 0);
    int plane = 0;
    float fraction = 0.0;
    for (int k = 0; k + 1 < size.z; ++k) {
        float above = texelFetch(plane_depth, ivec2(k, 0), 0).r;
        float below = texelFetch(plane_depth, ivec2(k + 1, 0), 0).r;
        if (point.y >= above) {
            plane = k;
            fraction = clamp((point.y - above) / (below - above), 0.0, 1.0);
        }
    }
    float last = log2(float(size.x));
    float level = clamp(log2(max(footprint_m * float(size.x) / stack.tile_m, 1.0)), 0.0, last);
    vec3 value = caustic_at_plane(stack, ratio, plane_depth, plane, point, level);
    if (fraction == 0.0) return value;
    return mix(value, caustic_at_plane(stack, ratio, plane_depth, plane + 1, point, level), fraction);
}
