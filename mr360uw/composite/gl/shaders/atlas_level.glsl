// One filtered fetch from a stack's texture in the layout of stack.py: all planes of a layer, one in each channel, in
// the level whose pixels are tile/side wide. Held to base/caustic_lookup.py.
vec4 caustic_level(sampler2DArray ratio, float size, float side, float number, vec2 uv, float layer) {
    vec2 texel = 1.0 / vec2(textureSize(ratio, 0).xy);
    float top = 2.0 * (size - side + number);
    return textureLod(ratio, vec3((uv * side + vec2(1.0, 1.0 + top)) * texel, layer), 0.0);
}

// where a point is read in a stack: share of each plane of a layer, level of detail, place in the tile
struct CausticPlace {
    vec4 share;
    float layer;
    int layers;
    vec2 uv;
    float size;
    float number;
    float between;
};

// point = (x, depth below the mean surface, z)
CausticPlace caustic_place(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, vec3 point,
                           float footprint_m) {
    CausticPlace place;
    int steps = textureSize(plane_depth, 0).x;
    float position = 0.0;
    int k = 0;
    // tests at its end, because software drivers run a body once more to leave
    do {
        vec2 plane = texelFetch(plane_depth, ivec2(k, 0), 0).rg;
        position += clamp((point.y - plane.x) * plane.y, 0.0, 1.0);
        ++k;
    } while (k < steps);
    place.layers = (steps + 2) / 3;
    place.layer = min(floor(position / 3.0), float(place.layers - 1));
    place.share = max(1.0 - abs(position - 3.0 * place.layer - vec4(0.0, 1.0, 2.0, 3.0)), 0.0);

    vec2 uv = (point.xz + stack.sun_direction.xz * (point.y / stack.sun_direction.y)) / stack.tile_m;
    place.uv = uv - floor(uv);
    place.size = float(textureSize(ratio, 0).x - 2);
    float level = log2(max(footprint_m * place.size / (sqrt(3.0) * stack.tile_m), 1.0));
    place.number = min(floor(level), log2(place.size) - 1.0);
    place.between = min(level - place.number, 1.0);
    return place;
}

float caustic_layer(sampler2DArray ratio, CausticPlace place, float layer) {
    float side = place.size * exp2(-place.number);
    vec4 planes = mix(caustic_level(ratio, place.size, side, place.number, place.uv, layer),
                      caustic_level(ratio, place.size, 0.5 * side, place.number + 1.0, place.uv, layer), place.between);
    return dot(planes, place.share);
}

// 1 or 3, whether or not the layers of turned light follow
int colours_of(sampler2DArray ratio, CausticPlace place) {
    return textureSize(ratio, 0).z >= 3 * place.layers ? 3 : 1;
}

vec3 caustic_colours(sampler2DArray ratio, CausticPlace place) {
    int colours = colours_of(ratio, place);
    vec3 value = vec3(0.0), colour = colours == 1 ? vec3(1.0) : vec3(1.0, 0.0, 0.0);
    float at = place.layer * float(colours), end = at + float(colours);
    do {
        value += caustic_layer(ratio, place, at) * colour;
        colour = colour.zxy;
        at += 1.0;
    } while (at < end);
    return value;
}
