// the sun at listed places, each with a ball around it: part of the disc seen from the place; whether bodies may shade
// the ball; whether all of it lies in the umbra; how far the nearest of them is
#include "composite/light.glsl"
uniform sampler2D places, sun_map, casters;
uniform vec2 slopes[MAXIMUM_SUN_SAMPLES];
uniform Lights lights;
out vec4 sun;

void main() {
    vec4 place = texelFetch(places, ivec2(gl_FragCoord.xy), 0);
    vec3 p = lights.sun_axes * (place.xyz + lights.camera_position);
    float gap;
    bool umbra;
    int between = bodies_between(sun_map, casters, lights.casters, lights.slot_size, p, place.w,
                                 tan(lights.half_angle), gap, umbra);
    sun = vec4(visibility(lights, sun_map, casters, slopes, place.xyz, true), float(between != 0), float(umbra), gap);
}
