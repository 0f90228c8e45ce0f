// what bodies keep off a receiver at every STRIDE-th pixel: ambient light (part blocked), sun (part seen)
#include "composite/light.glsl"
uniform sampler2D shape, surfels, sun_map, casters;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform ivec2 last;
uniform int surfel_count;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
out vec2 kept;

void main() {
    ivec2 pixel = min(ivec2(gl_FragCoord.xy) * STRIDE, last);
    vec4 place = texelFetch(shape, pixel, 0);
    vec3 point = place.w * (world_from_camera * direction_from_frame(window + vec2(pixel) + 0.5, frame_size));
    kept = vec2(0.0, 1.0);
#if defined(OCCLUSION)
    kept.x = place.w > 0.0 ? ambient_blocked(surfels, 0, surfel_count, point, place.xyz) : 0.0;
#endif
#if defined(SHADOW)
    kept.y = visibility(lights, sun_map, casters, slopes, point, true);
#endif
}
