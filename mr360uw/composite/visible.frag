// what a sample sees: (number of the triangle + 1, distance); distance as depth
#include "composite/geometry.glsl"
#include "composite/sampling.glsl"
#include "sphere.glsl"
uniform vec2 frame_size;
uniform vec4 window;
uniform vec2 gaussian;
uniform vec2 raster_origin;
uniform float first_number;
#if defined(MASKED)
uniform mat4 placed_world;
uniform mat3 world_from_camera;
uniform sampler2D triangles, materials, store;
uniform float first_triangle;
#endif
#if defined(PEELED)
uniform sampler2D opaque, nearer;
#endif
flat in vec3 bc, ca, ab;
flat in float volume;
flat in float number;
out vec2 seen;

void main() {
    vec2 place = window.xy + frame_from_raster(gl_FragCoord.xy + raster_origin, gaussian);
    vec3 direction = direction_from_frame(place, frame_size);
    Facet facet = Facet(bc, ca, ab, volume);
    vec3 weights = facet_weights(facet, direction) * sign(volume);
    if (min(weights.x, min(weights.y, weights.z)) < 0.0) discard;
    float distance_m = abs(volume) / (weights.x + weights.y + weights.z);
#if defined(PEELED)
    vec2 solid = texelFetch(opaque, ivec2(gl_FragCoord.xy), 0).rg;
    if (solid.r > 0.0 && distance_m >= solid.g) discard;
    vec2 front = texelFetch(nearer, ivec2(gl_FragCoord.xy), 0).rg;
    if (PEELED > 0 && (front.r == 0.0 || distance_m <= front.g * 1.000004 + 1e-7)) discard;
#endif
#if defined(MASKED)
    float pixel = inversesqrt(dot(gaussian, gaussian));
    Triangle triangle = fetch_triangle(triangles, placed_world, int(number + first_triangle));
    if (masked_out(triangles, materials, store, triangle, world_from_camera * direction,
                   world_from_camera * direction_from_frame(place + vec2(pixel, 0.0), frame_size),
                   world_from_camera * direction_from_frame(place + vec2(0.0, pixel), frame_size))) discard;
#endif
    seen = vec2(number + first_number, distance_m);
    gl_FragDepth = distance_m / (distance_m + 1.0);
}
