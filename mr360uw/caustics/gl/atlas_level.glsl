// One filtered fetch from a stack's texture in the layout of atlas.py: all planes of a layer, one in each channel, in
// the level whose pixels are tile/side wide. Held to caustics/lookup.py.
vec4 caustic_level(sampler2DArray ratio, float size, float side, float number, vec2 uv, float layer) {
    vec2 texel = 1.0 / vec2(textureSize(ratio, 0).xy);
    float top = 2.0 * (size - side + number);
    return textureLod(ratio, vec3((uv * side + vec2(1.0, 1.0 + top)) * texel, layer), 0.0);
}
