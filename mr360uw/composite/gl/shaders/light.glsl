#include "composite/gl/shaders/geometry.glsl"
#include "composite/lighting/shading.glsl"
#include "composite/gl/shaders/shadow.glsl"
#include "ibl/lookup.glsl"
#include "ibl/splitsum.glsl"
#include "medium/lookup.glsl"
#include "caustics/lookup.glsl"

// what a shot has is known at compile time (MEDIUM, SUN, CAUSTICS, GLOSSY): software drivers run both sides of branches
#if defined(MEDIUM)
const float OUTSIDE_INDEX = REFRACTIVE_INDEX_SEA;
#else
const float OUTSIDE_INDEX = 1.0;
#endif

// the numbers of a shot; `sun_axes` has the rows (across, across, along), all in the world's axes, the last one near the
// sun's direction, and `sun_slope` is that direction in them
struct Lights {
    vec3 camera_position;
    float camera_depth_m;
    vec3 sun_irradiance;
    vec3 sun_direction;
    float sun_up;
    float half_angle;
    float halo_angle;
    mat3 sun_axes;
    vec2 sun_slope;
    int sun_count;
    int casters;
    float slot_size;
    float bias_scale;  // of how far off a body its shadow rays start
    int glossy_levels;
};

struct Parts {
    vec3 diffuse;
    vec3 glossy;
    vec3 sun_diffuse;
    vec3 sun_glossy;
    vec3 caustics;
    vec3 emission;
};

float dielectric_f0(float refractive_index, float medium_index) {
    float ratio = (refractive_index - medium_index) / (refractive_index + medium_index);
    return ratio * ratio;
}

float depth_of(Lights lights, vec3 point) {
    return lights.camera_depth_m - (point.y + lights.camera_position.y);
}

vec3 ambient_factor(Lights lights, MediumTable medium, sampler2D diffuse, vec3 point) {
#if defined(MEDIUM)
    return ambient_ratio(medium, diffuse, depth_of(lights, point));
#else
    return vec3(1.0);
#endif
}

vec3 beam_at(Lights lights, MediumTable medium, sampler2D beam, vec3 point) {
#if !defined(SUN)
    return vec3(0.0);
#elif defined(MEDIUM)
    return lights.sun_irradiance * beam_ratio(medium, beam, depth_of(lights, point), lights.sun_up);
#else
    return lights.sun_irradiance;
#endif
}

vec3 waves_at(Lights lights, MediumTable medium, sampler2D beam, CausticStack stack, sampler2DArray ratio,
              sampler2D plane_depth, vec3 point, float footprint_m) {
#if !defined(CAUSTICS)
    return vec3(1.0);
#else
    float depth = depth_of(lights, point);
    vec3 world = point + lights.camera_position;
    vec3 value = caustic_lookup(stack, ratio, plane_depth, vec3(world.x, depth, world.z), footprint_m);
#if defined(MEDIUM)
    value = 1.0 + (value - 1.0) * unscattered_share(medium, beam, depth, lights.sun_up);
#endif
    return value;
#endif
}

// the part of the beam that the water has scattered into the halo
float scattered_at(Lights lights, MediumTable medium, sampler2D beam, vec3 point) {
#if defined(HALO)
    return 1.0 - dot(unscattered_share(medium, beam, depth_of(lights, point), lights.sun_up), vec3(1.0 / 3.0));
#else
    return 0.0;
#endif
}

// of the disc with the second moment of what the beam comes from
float half_angle_at(Lights lights, MediumTable medium, sampler2D beam, vec3 point) {
    vec2 squared = vec2(lights.half_angle * lights.half_angle, lights.halo_angle * lights.halo_angle);
    return sqrt(mix(squared.x, squared.y, scattered_at(lights, medium, beam, point)));
}

vec3 in_sun_axes(Lights lights, vec3 point) {
    return lights.sun_axes * (point + lights.camera_position);
}

// the part of a disc about the sun that is seen from p, in the sun's axes; by each `every`-th of its directions
float disc_seen(Lights lights, sampler2D sun_map, sampler2D casters, vec2 slopes[MAXIMUM_SUN_SAMPLES], vec3 p,
                float half_angle, int every, bool wanted) {
    return sun_visibility(sun_map, casters, lights.casters, lights.slot_size, p, lights.sun_slope, slopes,
                          (lights.sun_count + every - 1) / every, every, tan(half_angle), wanted);
}

// the part of the beam that reaches a point. halo: the part of the halo that is seen, where that is known, else -1;
// then it is found by each `every`-th direction
float visibility(Lights lights, MediumTable medium, sampler2D beam, sampler2D sun_map, sampler2D casters,
                 vec2 slopes[MAXIMUM_SUN_SAMPLES], vec3 point, float halo, int every, bool wanted) {
    vec3 p = in_sun_axes(lights, point);
    float seen = disc_seen(lights, sun_map, casters, slopes, p, lights.half_angle, 1, wanted);
#if defined(HALO)
    float found = disc_seen(lights, sun_map, casters, slopes, p, lights.halo_angle, every, wanted && halo < 0.0);
    seen = mix(seen, halo < 0.0 ? found : halo, scattered_at(lights, medium, beam, point));
#endif
    return seen;
}

// `level` is the place of the roughness among the glossy levels; `irradiance` that of the sun with waves and shadow
Parts surface_light(Lights lights, Surface s, sampler2DArray ambient, sampler2DArray glossy, float level,
                    vec3 ambient_scale, vec3 irradiance, vec3 waves, float half_angle) {
    vec3 view = -s.direction;
    float n_dot_v = clamp(dot(s.normal, view), 1e-3, 1.0);
    float dielectric = dielectric_f0(s.refractive_index, OUTSIDE_INDEX);
    vec2 split = split_sum(s.roughness, n_dot_v);
    vec3 varnish = reflectance(vec3(dielectric), split);
    vec3 coat = mix(varnish, reflectance(s.base.rgb, split), s.metallic);
    vec3 albedo = s.base.rgb * (1.0 - s.metallic) * (1.0 - varnish);
    vec3 axis = lobe_axis(s.normal, view, n_dot_v, s.roughness);
#if defined(GLOSSY)
    vec3 reflected = glossy_lookup(glossy, level, axis);
#else
    vec3 reflected = environment_lookup(ambient, 0, axis) * INV_PI;
#endif
    Parts parts;
    parts.diffuse = albedo * INV_PI * environment_lookup(ambient, 0, s.normal) * ambient_scale * s.occlusion;
    parts.glossy = coat * reflected * ambient_scale * s.occlusion;
    parts.emission = s.emission;
    parts.sun_diffuse = parts.sun_glossy = parts.caustics = vec3(0.0);
#if defined(SUN)
    float n_dot_l = max(dot(s.normal, lights.sun_direction), 0.0);
    vec3 half_vector = view + lights.sun_direction;
    half_vector /= max(length(half_vector), 1e-9);
    float n_dot_h = clamp(dot(s.normal, half_vector), 0.0, 1.0), v_dot_h = clamp(dot(view, half_vector), 0.0, 1.0);
    vec3 f0 = mix(vec3(dielectric), s.base.rgb, s.metallic);
    vec3 highlight = sun_highlight(f0, s.roughness * s.roughness, n_dot_v, n_dot_l, n_dot_h, v_dot_h, half_angle);
    parts.sun_diffuse = albedo * INV_PI * irradiance * n_dot_l;
    parts.sun_glossy = highlight * irradiance;
    parts.caustics = (parts.sun_diffuse + parts.sun_glossy) * (1.0 - 1.0 / max(waves, 1e-6));
#endif
    return parts;
}
