// the sun at listed places, each with a ball around it: part of it seen from the place, and of its halo; what of it
// bodies may keep off the ball (0 nothing, 1 of the halo, 2 of the disc, 3 all); how far the nearest of them is
#include "composite/gl/shaders/light.glsl"
uniform sampler2D places, beam, sun_map, casters;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
uniform MediumTable medium;
out vec4 sun;

void main() {
    vec4 place = texelFetch(places, ivec2(gl_FragCoord.xy), 0);
    vec3 p = in_sun_axes(lights, place.xyz);
    float gap, halo = 1.0;
    bool umbra;
    int between = bodies_between(sun_map, casters, lights.casters, lights.slot_size, p, place.w,
                                 tan(lights.halo_angle) + length(lights.sun_slope), gap, umbra);
    float kept = between == 0 ? 0.0 : umbra ? 3.0 : 2.0;
#if defined(HALO)
    float disc_gap;
    bool disc_umbra;
    int of_disc = bodies_between(sun_map, casters, lights.casters, lights.slot_size, p, place.w,
                                 tan(lights.half_angle) + length(lights.sun_slope), disc_gap, disc_umbra);
    if (kept == 2.0 && (of_disc == 0 || disc_umbra)) kept = 1.0;
    halo = disc_seen(lights, sun_map, casters, slopes, p, lights.halo_angle, 1, true);
#endif
    float seen = visibility(lights, medium, beam, sun_map, casters, slopes, place.xyz, halo, 1, true);
    sun = vec4(seen, halo, kept, gap);
}
