// twin: gamut.py
vec3 compress_gamut(vec3 c) {
    float largest = max(max(c.r, max(c.g, c.b)), 0.0);
    if (largest == 0.0) return vec3(0.0);
    vec3 d = 1.0 - c / largest;
    vec3 x = max(d - GAMUT_THRESHOLD, 0.0) / (1.0 - GAMUT_THRESHOLD);
    vec3 compressed = GAMUT_THRESHOLD
        + (1.0 - GAMUT_THRESHOLD) * x / pow(1.0 + pow(x, vec3(GAMUT_POWER)), vec3(1.0 / GAMUT_POWER));
    vec3 mapped = largest * (1.0 - mix(d, compressed, greaterThan(d, vec3(GAMUT_THRESHOLD))));
    vec3 weight = vec3(LUMINANCE_R, LUMINANCE_G, LUMINANCE_B);
    return mapped * max(dot(weight, c), 0.0) / dot(weight, mapped);
}
