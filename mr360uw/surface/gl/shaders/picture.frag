// Radiance of the sea's picture. Three programs: DIRECT for pixels whose rays cannot meet the surface; SIMPLE for rays
// that meet it once, with alpha 0 where that is not all or not exact enough; TREE, which follows all rays of listed
// pixels. Software drivers
// run both sides of every branch, so what a program does not need is not in it. Held to surface/tracing/ray_kernel.py
#include "medium/lookup.glsl"
#include "ibl/lookup.glsl"
#include "camera.glsl"
#include "waves.glsl"
#include "facets.glsl"
#include "dome.glsl"
#include "floor.glsl"

uniform Camera camera;
uniform Waves waves;
uniform Dome dome;
uniform Sun sun;
uniform Tiled albedo_tile, pattern_tile[2];
uniform MediumTable from_camera, from_surface;
uniform sampler2D heights, shifts, lost_slopes, seen_slopes, sky, albedo, pattern_0, pattern_1, listed;
#ifdef AROUND_SUN
uniform sampler2DArray around;
#endif
uniform sampler2D veil_from_camera, attenuation_from_camera, veil_from_surface, attenuation_from_surface;
uniform float floor_y_m, refractive_index, pixel_rad, pixel_m, first_row;
uniform vec3 even_light, dry_light, lost_light;
#ifdef RIPPLES
#include "caustics/sea/detail.glsl"
uniform Detail detail;
uniform sampler2D ripples;
uniform float ripple_wave, ripple_variance;
#endif

layout(location = 0) out vec4 radiance;
#ifdef CENTRES
#include "centres.glsl"
layout(location = 1) out vec4 lengths;
layout(location = 2) out vec4 normal;
#endif

#include "parting.glsl"
#ifdef TREE
uniform sampler2D coefficients;
#include "particles.glsl"
#include "tree.glsl"
#else
#include "simple.glsl"
#endif

void main() {
#ifdef TREE
    vec2 corner = texelFetch(listed, ivec2(gl_FragCoord.xy), 0).rg;
#else
    vec2 corner = vec2(floor(gl_FragCoord.x), first_row + floor(gl_FragCoord.y));
#endif
    uint number = (uint(corner.y) * uint(camera.size.x) + uint(corner.x)) * uint(SAMPLES * SAMPLES);
    vec3 total = vec3(0.0);
    bool whole = true;
    Hit hit;
    for (int k = 0; k < SAMPLES * SAMPLES; ++k) {
        vec2 place = corner + (vec2(k % SAMPLES, k / SAMPLES) + 0.5) / float(SAMPLES);
        Ray ray = Ray(camera_origin(camera, place), camera_direction(camera, place), vec3(1.0),
                      pixel_m / float(SAMPLES), pixel_rad / float(SAMPLES), 0.0, next_key(number + uint(k), 0u), 0,
                      CAMERA_IN_WATER);
        total += light_of(ray, whole, hit);
#ifdef CENTRES
        set_centre(waves, heights, ray.origin, ray.direction, CAMERA_IN_WATER, hit, floor_y_m, refractive_index,
                   pixel_m, pixel_rad, lengths, normal);
#endif
    }
    radiance = vec4(total / float(SAMPLES * SAMPLES), whole ? 1.0 : 0.0);
}
