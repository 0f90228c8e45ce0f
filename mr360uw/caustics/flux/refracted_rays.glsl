// twin: refracted_rays.py
#include "optics.glsl"

const float STEEPEST_RAY = 0.05;

vec2 ray_slope(vec3 normal, vec3 sun_in_air, float refractive_index) {
    vec3 t = refract_clamped(-sun_in_air, normal, 1.0 / refractive_index);
    return t.xz / max(-t.y, STEEPEST_RAY);
}

float ray_transmittance(vec3 normal, vec3 sun_in_air, float refractive_index) {
    return fresnel_transmittance(dot(normal, sun_in_air), refractive_index);
}

float facet_flux(vec3 a, vec3 b, vec3 c, float transmittance, vec3 sun_in_air) {
    vec3 area = 0.5 * cross(b - a, c - a);
    return transmittance * max(dot(area, sun_in_air), 0.0);
}
