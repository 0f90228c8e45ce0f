// Mip levels of the planes of one colour in the layout that lookup.glsl reads, scaled to mean 1.
// Held to caustic_lookup.py.
uniform sampler2D light_0, light_1, light_2, light_3;  // with mip levels
uniform sampler2D total_0, total_1, total_2, total_3;  // incoming light, one texel
uniform int size;
uniform int last;
out vec4 ratio;

float channel(sampler2D light, sampler2D total, ivec2 at, int level) {
    return texelFetch(light, at, level).r / texelFetch(total, ivec2(0), 0).r;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) - 1;
    int level = 0;
    int side = size;
    while (level < last && at.y > side) {
        at.y -= side + 2;
        side /= 2;
        ++level;
    }
    ratio = vec4(0.0);
    if (at.x > side) return;
    at -= side * ivec2(greaterThanEqual(at, ivec2(side)));
    at += side * ivec2(lessThan(at, ivec2(0)));
    ratio.r = channel(light_0, total_0, at, level);
#if PLANES > 1
    ratio.g = channel(light_1, total_1, at, level);
#endif
#if PLANES > 2
    ratio.b = channel(light_2, total_2, at, level);
    ratio.a = channel(light_3, total_3, at, level);
#endif
}
