// twin: gerstner.py
#include "surface.glsl"

// waves: row 0 = wave vector and phase - omega t in cycles, amplitude in tiles; row 1 = steepness. Lengths in tiles
SurfaceFields gerstner(sampler2D waves, int count, vec2 uv) {
    SurfaceFields f = SurfaceFields(0.0, vec2(0.0), vec2(0.0), vec3(0.0));
    for (int i = 0; i < count; ++i) {
        vec4 wave = texelFetch(waves, ivec2(i, 0), 0);
        float theta = 2.0 * PI * fract(dot(wave.xy, uv) + wave.z);
        vec2 k = 2.0 * PI * wave.xy;
        float wavenumber = length(k);
        vec2 direction = k / wavenumber;
        float sideways = texelFetch(waves, ivec2(i, 1), 0).x * wave.w;
        float s = sin(theta);
        float c = cos(theta);
        f.height += wave.w * s;
        f.shift += sideways * c * direction;
        f.slope += wave.w * c * k;
        f.strain -= sideways * wavenumber * s * vec3(direction * direction, direction.x * direction.y);
    }
    return f;
}
