// Codes of a plate's planes, lists of numbers, and the dither. Held to yuv/decoding.py, video/pixels/kernels.py

float listed(sampler2D list, int n) {
    return texelFetch(list, ivec2(n % LIST_COLUMNS, n / LIST_COLUMNS), 0).r;
}

vec3 listed_color(sampler2D list, int n) {
    return vec3(listed(list, 3 * n), listed(list, 3 * n + 1), listed(list, 3 * n + 2));
}

float code_at(usampler2D plane, int column, int row) {
    return float(texelFetch(plane, ivec2(column, row), 0).r);
}

// Interleaved gradient noise (Jimenez 2014) at a column and a row.
float dither(ivec2 place, int frame) {
    vec2 at = vec2(place) + DITHER_STEP * float(frame & (DITHER_FRAMES - 1));
    float value = DITHER_CONTRAST * fract(DITHER_ALONG * at.x + DITHER_DOWN * at.y);
    return DITHER_LEAST + (1.0 - 2.0 * DITHER_LEAST) * fract(value);
}

uint quantised(float code, float noise, float peak) {
    return uint(clamp(code + noise, 0.0, peak));
}
