// Light of the sun at a place: attenuated beam and caustic factor. Its visibility behind bodies is found on the processor
// (light_visibility.py). Held to composite/light_sources.py.
#include "composite/gl/shaders/light.glsl"
#include "base/caustic_lookup.glsl"

// up: sine of the sun's elevation. half_angle, halo_angle: radii of disc, halo [rad]
struct Sun {
    vec3 irradiance;
    vec3 direction;
    float up;
    float half_angle;
    float halo_angle;
};

vec3 beam_at(Sun sun, View view, MediumTable medium, sampler2D beam, vec3 point) {
#if !defined(SUN)
    return vec3(0.0);
#elif defined(MEDIUM)
    return sun.irradiance * beam_ratio(medium, beam, depth_of(view, point), sun.up);
#else
    return sun.irradiance;
#endif
}

vec3 waves_at(Sun sun, View view, MediumTable medium, sampler2D beam, CausticStack stack, sampler2DArray ratio,
              sampler2D plane_depth, vec3 point, float footprint_m) {
#if !defined(CAUSTICS)
    return vec3(1.0);
#else
    float depth = depth_of(view, point);
    vec3 world = point + view.position;
#if defined(MEDIUM) && defined(SOFT)
    return soft_caustic_lookup(stack, ratio, plane_depth, vec3(world.x, depth, world.z), footprint_m,
                               unscattered_share(medium, beam, depth, sun.up));
#endif
    vec3 value = caustic_lookup(stack, ratio, plane_depth, vec3(world.x, depth, world.z), footprint_m);
#if defined(MEDIUM)
    value = 1.0 + (value - 1.0) * unscattered_share(medium, beam, depth, sun.up);
#endif
    return value;
#endif
}

// fraction of the beam that the water has scattered into the halo
float scattered_at(Sun sun, View view, MediumTable medium, sampler2D beam, vec3 point) {
#if defined(HALO)
    return 1.0 - dot(unscattered_share(medium, beam, depth_of(view, point), sun.up), vec3(1.0 / 3.0));
#else
    return 0.0;
#endif
}

// radius [rad] of the disc that has the second moment of the beam's directions
float half_angle_at(Sun sun, View view, MediumTable medium, sampler2D beam, vec3 point) {
    vec2 squared = vec2(sun.half_angle * sun.half_angle, sun.halo_angle * sun.halo_angle);
    return sqrt(mix(squared.x, squared.y, scattered_at(sun, view, medium, beam, point)));
}
