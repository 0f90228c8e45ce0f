// Light reflected by a surface: ambient light, and light from one direction. Held to composite/shading.py.
// Features of a shot (MEDIUM, SUN, CAUSTICS, LAMPS, GLOSSY) are switched at compile time, because software drivers
// execute both sides of every branch.
#include "composite/gl/shaders/geometry.glsl"
#include "composite/gl/shaders/ambient.glsl"
#include "composite/shading.glsl"
#include "ibl/lookup.glsl"
#include "ibl/filters.glsl"
#include "medium/lookup.glsl"

struct View {
    vec3 position;
    float surface_y_m;
};

struct Parts {
    vec3 diffuse;
    vec3 glossy;
    vec3 sun;
    vec3 lamps;
    vec3 caustics;
    vec3 emission;
};

// reflection of a surface towards the camera: view direction, n.v, reflectance at normal incidence, diffuse albedo, and
// the fraction of uniform light that the coat reflects
struct Coat {
    vec3 view;
    float n_dot_v;
    vec3 f0;
    vec3 albedo;
    vec3 mirrors;
};

float dielectric_f0(float refractive_index, float medium_index) {
    float ratio = (refractive_index - medium_index) / (refractive_index + medium_index);
    return ratio * ratio;
}

float depth_of(View view, vec3 point) {
    return view.surface_y_m - (point.y + view.position.y);
}

vec3 ambient_factor(View view, MediumTable medium, sampler2D diffuse, vec3 point, float normal_up) {
#if defined(MEDIUM)
    return ambient_ratio(medium, diffuse, depth_of(view, point), normal_up);
#else
    return vec3(1.0);
#endif
}

Coat make_coat(Surface s, float outside_index) {
    Coat coat;
    coat.view = -s.direction;
    coat.n_dot_v = clamp(dot(s.normal, coat.view), 1e-3, 1.0);
    float dielectric = dielectric_f0(s.refractive_index, outside_index);
    vec2 split = split_sum(s.roughness, coat.n_dot_v);
    vec3 varnish = reflectance(vec3(dielectric), split);
    coat.mirrors = mix(varnish, reflectance(s.base.rgb, split), s.metallic);
    coat.albedo = s.base.rgb * (1.0 - s.metallic) * (1.0 - varnish);
    coat.f0 = mix(vec3(dielectric), s.base.rgb, s.metallic);
    return coat;
}

// ambient: irradiance, then glossy levels. level: fractional glossy level of the roughness. axis: of the light that the
// coat reflects. scale, mirrored: ambient light at the surface's depth over that at the camera, on its normal and on the
// axis
Parts ambient_light(Coat coat, Surface s, Among among, sampler2DArray ambient, float level, vec3 axis, vec3 scale,
                    vec3 mirrored) {
    Parts parts;
#if defined(GLOSSY)
    vec3 reflected = glossy_lookup(ambient, 1.0 + level, axis);
#if defined(AMONG_BODIES)
    reflected = reflected * among.kept + among.instead;
#endif
#else
    vec3 reflected = environment_lookup(ambient, 0, axis) * INV_PI * among.ratio;
#endif
    parts.diffuse = coat.albedo * INV_PI * environment_lookup(ambient, 0, s.normal) * among.ratio * scale * s.occlusion;
    parts.glossy = coat.mirrors * reflected * mirrored * s.occlusion;
    parts.emission = s.emission;
    parts.sun = parts.lamps = parts.caustics = vec3(0.0);
    return parts;
}

Parts trimmed(Parts parts, vec3 trim) {
    parts.diffuse *= trim;
    parts.glossy *= trim;
    parts.sun *= trim;
    parts.lamps *= trim;
    parts.caustics *= trim;
    parts.emission *= trim;
    return parts;
}

// radiance reflected to the camera of a beam from one direction; irradiance: across the beam
vec3 reflected_light(Coat coat, Surface s, vec3 towards, vec3 irradiance, float half_angle) {
    float n_dot_l = max(dot(s.normal, towards), 0.0);
    vec3 half_vector = coat.view + towards;
    half_vector /= max(length(half_vector), 1e-9);
    float v_dot_h = clamp(dot(coat.view, half_vector), 0.0, 1.0);
#if defined(SMOOTH)
    float alpha = resolved_alpha(s.roughness, s.normal_change[0], s.normal_change[1]);
    vec3 lobe = vec3(0.0);
    for (int k = 0; k < 4; ++k) {
        vec2 place = PIXEL_POINT * vec2((k & 1) == 0 ? -1.0 : 1.0, k < 2 ? -1.0 : 1.0);
        vec3 normal = normalize(s.normal + place.x * s.normal_change[0] + place.y * s.normal_change[1]);
        lobe += 0.25 * highlight(coat.f0, alpha, clamp(dot(normal, coat.view), 1e-3, 1.0),
                                 max(dot(normal, towards), 0.0), clamp(dot(normal, half_vector), 0.0, 1.0), v_dot_h, half_angle);
    }
#else
    vec3 lobe = highlight(coat.f0, s.roughness * s.roughness, coat.n_dot_v, n_dot_l,
                          clamp(dot(s.normal, half_vector), 0.0, 1.0), v_dot_h, half_angle);
#endif
    return (coat.albedo * INV_PI * n_dot_l + lobe) * irradiance;
}
