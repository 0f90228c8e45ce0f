// Sun visibility at listed places, each with a ball around it: visible fraction of the disc and of the halo at the
// place; which of them bodies may occlude within the ball (0 neither, 1 the halo, 2 part of the disc, 3 all of both);
// distance to the nearest such body [m]. Held to composite/lighting/light_sources.py.
#include "composite/gl/shaders/sun.glsl"
uniform int count;
uniform sampler2D places, beam, sun_map, casters;
uniform vec4 rays[MAXIMUM_SUN_RAYS];
uniform View view;
uniform Sun sun;
uniform Shadows shadows;
uniform MediumTable medium;
out vec4 seen;

void main() {
    vec4 place = texelFetch(places, list_place(min(lane_number(ivec2(gl_FragCoord.xy)), count - 1)), 0);
    vec3 p = in_sun_axes(sun, view, place.xyz);
    float gap, halo = 1.0;
    bool umbra;
    int listed = bodies_listed(sun, casters, p, place.w);
    int between = bodies_between(sun_map, casters, listed, shadows.slot_size, p, place.w, sun.slope,
                                 tan(sun.halo_angle), gap, umbra);
    float kept = between == 0 ? 0.0 : umbra ? 3.0 : 2.0;
#if defined(HALO)
    float disc_gap;
    bool disc_umbra;
    int of_disc = bodies_between(sun_map, casters, listed, shadows.slot_size, p, place.w,
                                 sun.slope, tan(sun.half_angle), disc_gap, disc_umbra);
    if (kept == 2.0 && (of_disc == 0 || disc_umbra)) kept = 1.0;
    halo = disc_seen(sun, shadows, sun_map, casters, rays, p, POINT, sun.halo_angle, 1, true);
#endif
    Footprint area = Footprint(place.xyz, POINT);
    float free = visibility(sun, shadows, view, medium, beam, sun_map, casters, rays, area, halo, 1, true);
    seen = vec4(free, halo, kept, gap);
}
