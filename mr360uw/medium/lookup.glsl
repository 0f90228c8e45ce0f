// twin: lookup.py
struct MediumTable {
    float camera_depth_m;
    float length_m;
};

float table_coordinate(float s, float length_m) {
    return 1.0 - length_m / (max(s, 0.0) + length_m);
}

// a table (U, V, 3) is a texture of U rows and V columns
vec3 bilinear(sampler2D table, float u, float v) {
    ivec2 size = textureSize(table, 0);
    vec2 p = clamp(vec2(v, u), 0.0, 1.0) * vec2(size - 1);
    ivec2 i = max(min(ivec2(p), size - 2), 0);
    vec2 f = p - vec2(i);
    ivec2 next = min(i + 1, size - 1);
    return mix(mix(texelFetch(table, i, 0).rgb, texelFetch(table, ivec2(next.x, i.y), 0).rgb, f.x),
               mix(texelFetch(table, ivec2(i.x, next.y), 0).rgb, texelFetch(table, next, 0).rgb, f.x), f.y);
}

// a row of a texture is a table (U, 3) over one coordinate
vec3 linear(sampler2D table, int row, float u) {
    int last = textureSize(table, 0).x - 1;
    float p = clamp(u, 0.0, 1.0) * float(last);
    int i = max(min(int(p), last - 1), 0);
    return mix(texelFetch(table, ivec2(i, row), 0).rgb, texelFetch(table, ivec2(min(i + 1, last), row), 0).rgb,
               p - float(i));
}

float in_water_distance(float distance_m, float camera_depth_m, float up) {
    return min(distance_m, camera_depth_m / max(up, 1e-9));
}

vec3 veil_lookup(MediumTable medium, sampler2D veil, float distance_m, float up) {
    float s = in_water_distance(distance_m, medium.camera_depth_m, up);
    return (1.0 - exp(-s / medium.length_m)) * bilinear(veil, 0.5 + 0.5 * up, table_coordinate(s, medium.length_m));
}

vec3 optical_length(MediumTable medium, sampler2D attenuation, float distance_m, float up) {
    float s = in_water_distance(distance_m, medium.camera_depth_m, up);
    float depth = medium.camera_depth_m - s * up;
    return s * bilinear(attenuation, table_coordinate(depth, medium.length_m), table_coordinate(s, medium.length_m));
}

vec3 transmittance_lookup(MediumTable medium, sampler2D attenuation, float distance_m, float up) {
    return exp(-optical_length(medium, attenuation, distance_m, up));
}

vec3 ambient_ratio(MediumTable medium, sampler2D diffuse, float depth_m, float normal_up) {
    float d = max(depth_m, 0.0);
    vec3 attenuation = bilinear(diffuse, 0.5 + 0.5 * normal_up, table_coordinate(d, medium.length_m));
    return exp(min(-attenuation * (d - medium.camera_depth_m), vec3(BRIGHTEST_LOG)));
}

// the tables over depth, (D, 3), are rows of the texture `beam`: the beam, then its unscattered part
vec3 path_attenuation(MediumTable medium, sampler2D beam, int row, float depth_m, float sun_up) {
    float path = max(depth_m, 0.0) / sun_up;
    return linear(beam, row, table_coordinate(path, medium.length_m)) * path;
}

vec3 beam_ratio(MediumTable medium, sampler2D beam, float depth_m, float sun_up) {
    vec3 here = path_attenuation(medium, beam, 0, medium.camera_depth_m, sun_up);
    return exp(min(here - path_attenuation(medium, beam, 0, depth_m, sun_up), vec3(BRIGHTEST_LOG)));
}

vec3 unscattered_share(MediumTable medium, sampler2D beam, float depth_m, float sun_up) {
    return exp(min(path_attenuation(medium, beam, 0, depth_m, sun_up)
                 - path_attenuation(medium, beam, 1, depth_m, sun_up), 0.0));
}
