// Light of lamps at a place: inverse square, cone, water on the way there and back. Their visibility behind bodies is found
// on the processor (light_visibility.py). Held to composite/light_sources.py.
#include "composite/gl/shaders/light.glsl"

struct Lamp {
    vec3 place;      // from the camera, world axes
    float radius;
    vec3 axis;
    float cos_core;
    vec3 intensity;
    float cos_edge;
    float table;     // row of `beam` that holds the attenuation of its light
    float nearest;
};

struct LampLight {
    vec3 towards;
    vec3 irradiance;
    float half_angle;
};

Lamp fetch_lamp(sampler2D lamps, int row) {
    vec4 a = texelFetch(lamps, ivec2(0, row), 0), b = texelFetch(lamps, ivec2(1, row), 0);
    vec4 c = texelFetch(lamps, ivec2(2, row), 0), d = texelFetch(lamps, ivec2(3, row), 0);
    vec4 cone = texelFetch(lamps, ivec2(4, row), 0);  // of `Lamp.beam`, whose axis follows
    return Lamp(a.xyz, a.w, b.xyz, cone.x, c.xyz, cone.y, d.x, d.y);
}

float spot_factor(Lamp lamp, vec3 towards) {
    if (lamp.cos_edge <= -1.0) return 1.0;
    float t = clamp((-dot(towards, lamp.axis) - lamp.cos_edge) / max(lamp.cos_core - lamp.cos_edge, 1e-6), 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

LampLight lamp_light(Lamp lamp, MediumTable medium, sampler2D beam, sampler2D attenuation, vec3 point) {
    vec3 away = lamp.place - point;
    float apart = max(length(away), lamp.nearest);
    LampLight light;
    light.towards = away / apart;
    light.irradiance = lamp.intensity * spot_factor(lamp, light.towards) / (apart * apart);
    light.half_angle = asin(min(lamp.radius / apart, 1.0));
#if defined(MEDIUM)
    float back = length(point), path = apart + back;
    vec3 lost = linear(beam, int(lamp.table + 0.5), table_coordinate(path, medium.length_m)) * path;
    light.irradiance *= exp(optical_length(medium, attenuation, back, point.y / max(back, 1e-9)) - lost);
#endif
    return light;
}
