// What the ray through a pixel's centre meets: distances, normal and masks. Held to surface/sea_picture.py
#include "optics.glsl"
#include "camera.glsl"
#include "waves.glsl"

uniform Camera camera;
uniform Waves waves;
uniform sampler2D heights;
uniform float floor_y_m, refractive_index, pixel_rad, pixel_m, first_row;
uniform bool camera_in_water;

layout(location = 0) out vec4 lengths;  // first thing met and in the water, both -1 for infinity, surface, floor
layout(location = 1) out vec4 normal;

const float FOREVER = -1.0;

float floor_distance(vec3 origin, vec3 direction, bool wet) {
    bool reached = direction.y < 0.0 && (wet || floor_y_m > waves.lowest_m);
    return reached ? max((floor_y_m - origin.y) / direction.y, 0.0) : FOREVER;
}

Hit surface_hit(vec3 origin, vec3 direction, bool wet, float far, float width, bool leaves) {
    return first_hit(waves, heights, origin, direction, wet ? -1.0 : 1.0, width, pixel_rad,
                     far < 0.0 ? FARTHEST_M : min(far, FARTHEST_M), leaves);
}

void main() {
    vec2 place = gl_FragCoord.xy + vec2(0.0, first_row);
    vec3 origin = camera_origin(camera, place), direction = camera_direction(camera, place);
    float far = floor_distance(origin, direction, camera_in_water);
    Hit hit = surface_hit(origin, direction, camera_in_water, far, pixel_m, false);
    bool met = hit.distance >= 0.0;
    float distance = met ? hit.distance : far, wet = camera_in_water ? distance : 0.0;
    normal = met ? vec4(normalize(vec3(-hit.slope.x, 1.0, -hit.slope.y)), 1.0) : vec4(0.0);
    if (met && !camera_in_water) {
        vec3 bent = normalize(refract_clamped(direction, normal.xyz, 1.0 / refractive_index));
        vec3 point = origin + hit.distance * direction;
        float below = floor_distance(point, bent, true);
        Hit again = surface_hit(point, bent, true, below, pixel_m, true);
        wet = again.distance >= 0.0 ? again.distance : below;
    }
    lengths = vec4(distance, wet, met ? 1.0 : 0.0, !met && far >= 0.0 ? 1.0 : 0.0);
}
