// twin: gerstner.py
#include "caustics/sea/surface.glsl"

// lengths in tiles; waves: row 0 = wave vector and phase - omega t in cycles, amplitude; row 1 = Q A k/|k|
SurfaceFields gerstner(sampler2D waves, int count, vec2 uv) {
    SurfaceFields f = SurfaceFields(0.0, vec2(0.0), vec2(0.0), vec3(0.0));
    for (int i = 0; i < count; ++i) {
        vec4 wave = texelFetch(waves, ivec2(i, 0), 0);
        vec2 sideways = texelFetch(waves, ivec2(i, 1), 0).xy;
        float theta = 2.0 * PI * fract(dot(wave.xy, uv) + wave.z);
        vec2 k = 2.0 * PI * wave.xy;
        float s = sin(theta);
        float c = cos(theta);
        f.height += wave.w * s;
        f.shift += c * sideways;
        f.slope += wave.w * c * k;
        f.strain -= s * vec3(sideways * k, sideways.x * k.y);
    }
    return f;
}
