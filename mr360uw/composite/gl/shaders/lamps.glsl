// Light of lamps at a place: inverse square, cone, water on the way there and back, and visibility behind bodies.
// Held to composite/lighting/light_sources.py.
// `casters` has a row for every slot of the shadow atlas and, below those, one for each lamp. A slot of a lamp shows
// bodies through the projective map (x, y, z) -> (x m/z, y m/z, m^2/z), z the distance along its axis and m its middle
// distance. Lines through the lamp become parallel, straight lines stay straight, and lengths at the middle distance
// stay metres, so shadow.glsl traces it like a slot of the sun.
#include "composite/gl/shaders/footprint.glsl"
#include "composite/gl/shaders/light.glsl"
#include "composite/gl/shaders/shadow.glsl"

struct Lamp {
    vec3 place;      // from the camera, world axes
    float radius;
    vec3 axis;
    float cos_core;
    vec3 intensity;
    float cos_edge;
    int first_slot;
    int slots;
    float table;     // row of `beam` that holds the attenuation of its light
    float nearest;
};

struct LampLight {
    vec3 towards;
    vec3 irradiance;
    float half_angle;
};

Lamp fetch_lamp(sampler2D casters, int row) {
    vec4 a = texelFetch(casters, ivec2(0, row), 0), b = texelFetch(casters, ivec2(1, row), 0);
    vec4 c = texelFetch(casters, ivec2(2, row), 0), d = texelFetch(casters, ivec2(3, row), 0);
    return Lamp(a.xyz, a.w, b.xyz, b.w, c.xyz, c.w, int(d.x), int(d.y), d.z, d.w);
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

// a point in the projective axes of a slot; z <= 0 if it lies behind the lamp
vec3 in_slot(sampler2D casters, int slot, vec3 point, out float middle) {
    vec4 q = vec4(point, 1.0);
    vec3 p = vec3(dot(texelFetch(casters, ivec2(2, slot), 0), q), dot(texelFetch(casters, ivec2(3, slot), 0), q),
                  dot(texelFetch(casters, ivec2(4, slot), 0), q));
    middle = texelFetch(casters, ivec2(5, slot), 0).x;
    if (p.z <= 0.0) return vec3(0.0, 0.0, -1.0);
    return vec3(p.xy * middle, middle * middle) / p.z;
}

// visible fraction of a lamp, a mean over a footprint; undefined unless `wanted`. A point lamp has one ray
float lamp_visibility(Lamp lamp, Shadows shadows, sampler2D sun_map, sampler2D casters,
                      vec4 rays[MAXIMUM_SUN_RAYS], Footprint area, bool wanted) {
    int between = 0, number = 0;
    float middle, radius = footprint_radius(area.sides);
    while (number < lamp.slots) {
        vec3 p = in_slot(casters, lamp.first_slot + number, area.middle, middle);
        Caster caster = fetch_caster(casters, lamp.first_slot + number);
        vec2 across = abs(p.xy - caster.center) - caster.half_size;
        float scale = p.z / middle, above = caster.reach.y - p.z + radius * scale * scale;
        bool beside = max(across.x, across.y) > lamp.radius / middle * above + 2.0 * radius * scale;
        if (p.z > 0.0 && above > 0.0 && !beside) between |= 1 << number;
        ++number;
    }
    int count = lamp.radius > 0.0 ? shadows.samples : 1;
    int k = !wanted || between == 0 ? count : 0;
    vec3 facing = cross(area.sides[0], area.sides[1]);
    float grain = ray_grain(count) * sqrt(abs(dot(facing, normalize(lamp.place - area.middle))));
    vec2 places = ray_places(count);
    mat2x3 sides = area.sides * places.x;
    float blocked = 0.0;
    while (k < count) {
        int left = between;
        float most = 0.0;
        while (left != 0 && most < 1.0) {
            int lowest = left & -left, slot = lamp.first_slot + int(log2(float(lowest)) + 0.5);
            vec3 p = in_slot(casters, slot, area.middle + sides * rays[k].zw, middle);
            float spread = lamp.radius / middle;
            most = both_block(most, sun_blocked(sun_map, fetch_caster(casters, slot), shadows.slot_size, p,
                                                places.y * spread * rays[k].xy, grain * p.z / middle,
                                                spread * ray_widening(count)));
            left &= ~lowest;
        }
        blocked += most;
        ++k;
    }
    return 1.0 - blocked / float(count);
}
