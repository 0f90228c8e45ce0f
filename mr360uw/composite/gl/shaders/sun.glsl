// Light of the sun at a place: attenuated beam, caustic factor, and visibility behind bodies.
// Held to composite/lighting/light_sources.py.
#include "composite/gl/shaders/footprint.glsl"
#include "composite/gl/shaders/light.glsl"
#include "composite/gl/shaders/shadow.glsl"
#include "caustic_lookup.glsl"

// axes: rows (across, across, along) in the world's axes, the last one near the sun's direction. slope: that direction
// in these axes, across over along. up: sine of the sun's elevation. half_angle, halo_angle: radii of disc, halo [rad].
// grid_*: of light_textures.py, whose table begins in the row grid_row of `casters`
struct Sun {
    vec3 irradiance;
    vec3 direction;
    float up;
    float half_angle;
    float halo_angle;
    mat3 axes;
    vec2 slope;
    int casters;
    vec3 grid_low;
    vec3 grid_scale;
    vec3 grid_last;
    vec3 grid_steps;
    float grid_radius;
    int grid_row;
};

const int HALF_BITS = 15;  // twin: light_textures.py

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

vec3 in_sun_axes(Sun sun, View view, vec3 point) {
    return sun.axes * (point + view.position);
}

// bits of the bodies that may occlude part of the sun from part of a ball about p, in the sun's axes, and of some that
// do not; held to composite/gl/light_textures.py
int bodies_listed(Sun sun, sampler2D casters, vec3 p, float radius) {
    vec3 cell = clamp(floor((p - sun.grid_low) * sun.grid_scale), vec3(0.0), sun.grid_last);
    int number = int(dot(cell, sun.grid_steps));
    vec4 two = texelFetch(casters, ivec2((number >> 1) & 3, sun.grid_row + (number >> 3)), 0);
    ivec2 halves = ivec2((number & 1) == 0 ? two.xy : two.zw);
    return radius <= sun.grid_radius ? halves.x | halves.y << HALF_BITS : (1 << sun.casters) - 1;
}

// visible fraction of a disc about the sun, a mean over a footprint about p, in the sun's axes, over each `every`-th ray
float disc_seen(Sun sun, Shadows shadows, sampler2D sun_map, sampler2D casters, vec4 rays[MAXIMUM_SUN_RAYS], vec3 p,
                mat2x3 sides, float half_angle, int every, bool wanted) {
    int listed = bodies_listed(sun, casters, p, footprint_radius(sides));
    return sun_visibility(sun_map, casters, listed, shadows.slot_size, p, sides, sun.slope, rays,
                          (shadows.samples + every - 1) / every, every, tan(half_angle), wanted);
}

// visible fraction of the beam, a mean over a footprint. halo: visible fraction of the halo if known, else -1: then it
// is computed over each `every`-th ray
float visibility(Sun sun, Shadows shadows, View view, MediumTable medium, sampler2D beam, sampler2D sun_map,
                 sampler2D casters, vec4 rays[MAXIMUM_SUN_RAYS], Footprint area, float halo, int every,
                 bool wanted) {
    vec3 p = in_sun_axes(sun, view, area.middle);
    mat2x3 sides = sun.axes * area.sides;
    float seen = disc_seen(sun, shadows, sun_map, casters, rays, p, sides, sun.half_angle, 1, wanted);
#if defined(HALO)
    float found = disc_seen(sun, shadows, sun_map, casters, rays, p, sides, sun.halo_angle, every, wanted && halo < 0.0);
    seen = mix(seen, halo < 0.0 ? found : halo, scattered_at(sun, view, medium, beam, area.middle));
#endif
    return seen;
}
