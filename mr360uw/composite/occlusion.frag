// the ambient light that bodies block at every STRIDE-th pixel of a receiver
#include "composite/shadow.glsl"
#include "sphere.glsl"
uniform sampler2D shape, surfels;
uniform mat3 world_from_camera;
uniform vec2 frame_size;
uniform vec2 window;
uniform ivec2 last;
uniform int surfel_count;
out float blocked;

void main() {
    ivec2 pixel = min(ivec2(gl_FragCoord.xy) * STRIDE, last);
    vec4 place = texelFetch(shape, pixel, 0);
    vec3 direction = world_from_camera * direction_from_frame(window + vec2(pixel) + 0.5, frame_size);
    blocked = place.w > 0.0 ? ambient_blocked(surfels, 0, surfel_count, place.w * direction, place.xyz) : 0.0;
}
