// a plane with all its mip levels, as lookup.glsl reads them, scaled to mean 1
uniform sampler2D light_0, light_1, light_2;  // with mip levels
uniform sampler2D total_0, total_1, total_2;  // incoming light, one texel
uniform int size;
out vec4 ratio;

float channel(sampler2D light, sampler2D total, ivec2 at, int level) {
    return texelFetch(light, at, level).r / texelFetch(total, ivec2(0), 0).r;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int last = int(log2(float(size)) + 0.5);
    int level = 0;
    int side = size;
    while (level < last && at.y >= side) {
        at.y -= side;
        side /= 2;
        ++level;
    }
    ratio = vec4(0.0);
    if (at.x >= side || at.y >= side) return;
    ratio = vec4(vec3(channel(light_0, total_0, at, level)), 1.0);
#if CHANNELS == 3
    ratio.g = channel(light_1, total_1, at, level);
    ratio.b = channel(light_2, total_2, at, level);
#endif
}
