// What the ray through a pixel's centre meets. Held to surface/sea_picture.py
#include "camera.glsl"
#include "waves.glsl"
#include "facets.glsl"
#include "centres.glsl"

uniform Camera camera;
uniform Waves waves;
uniform sampler2D heights;
uniform float floor_y_m, refractive_index, pixel_rad, pixel_m, first_row;

layout(location = 0) out vec4 lengths;
layout(location = 1) out vec4 normal;

void main() {
    vec2 place = gl_FragCoord.xy + vec2(0.0, first_row);
    vec3 origin = camera_origin(camera, place), direction = camera_direction(camera, place);
    Hit hit = Hit(NO_HIT, vec2(0.0), 0.0, 0.0);
#ifndef DIRECT
    bool down = direction.y < 0.0 && (CAMERA_IN_WATER || floor_y_m > waves.lowest_m);
    float far = down ? (floor_y_m - origin.y) / direction.y : FARTHEST_M;
    hit = first_hit(waves, heights, origin, direction, CAMERA_IN_WATER ? -1.0 : 1.0, pixel_m, pixel_rad,
                    clamp(far, 0.0, FARTHEST_M), false);
#endif
    set_centre(waves, heights, origin, direction, CAMERA_IN_WATER, hit, floor_y_m, refractive_index, pixel_m, pixel_rad,
               lengths, normal);
}
