// twin: optics.py
vec3 refract_to_air(vec3 direction_in_water, float refractive_index) {
    vec2 horizontal = refractive_index * direction_in_water.xz;
    float sine = length(horizontal);
    horizontal /= max(sine, 1.0);
    float up = sine < 1.0 ? sqrt(max(1.0 - dot(horizontal, horizontal), 0.0)) : 0.0;
    return vec3(horizontal.x, up, horizontal.y);
}

vec3 refract_to_water(vec3 direction_in_air, float refractive_index) {
    vec2 horizontal = direction_in_air.xz / refractive_index;
    return vec3(horizontal.x, sqrt(1.0 - dot(horizontal, horizontal)), horizontal.y);
}

// not the built-in refract, which is zero under total reflection
vec3 refract_clamped(vec3 travel, vec3 normal, float eta) {
    float cosine = dot(travel, normal);
    float k = max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0);
    return eta * travel - (eta * cosine + sqrt(k)) * normal;
}

float critical_cosine(float refractive_index) {
    return sqrt(max(1.0 - 1.0 / (refractive_index * refractive_index), 0.0));
}

float fresnel_transmittance(float cos_air, float refractive_index) {
    float c_i = max(cos_air, 0.0);
    float n = refractive_index;
    float c_t = sqrt(1.0 - (1.0 - c_i * c_i) / (n * n));
    float s = c_i + n * c_t;
    float p = n * c_i + c_t;
    return 2.0 * n * c_i * c_t * (1.0 / (s * s) + 1.0 / (p * p));
}

float fresnel_reflectance(float cos_air, float refractive_index) {
    return 1.0 - fresnel_transmittance(cos_air, refractive_index);
}

float fresnel_from_below(float cos_water, float refractive_index) {
    float c_t = max(cos_water, 1e-30);
    float n = refractive_index;
    if (n == 1.0) return 0.0;
    float c_i = sqrt(max(1.0 - n * n * (1.0 - c_t * c_t), 0.0));
    float s = (n * c_t - c_i) / (n * c_t + c_i);
    float p = (c_t - n * c_i) / (c_t + n * c_i);
    return 0.5 * (s * s + p * p);
}

float cosine_behind(float cosine, float relative_index) {
    return sqrt(max(1.0 - (1.0 - cosine * cosine) / (relative_index * relative_index), 0.0));
}

float fresnel(float cosine, float relative_index) {
    float before = max(cosine, 1e-30);
    float m = relative_index;
    float behind = cosine_behind(before, m);
    float s = (before - m * behind) / (before + m * behind);
    float p = (m * before - behind) / (m * before + behind);
    return 0.5 * (s * s + p * p);
}

float radiance_factor(float cosine, float relative_index) {
    return (1.0 - fresnel(cosine, relative_index)) * relative_index * relative_index;
}

// 3e38 stands for infinity
float solid_angle_change(float cosine, float relative_index) {
    float flux = relative_index * relative_index * cosine_behind(cosine, relative_index);
    return flux > 0.0 ? cosine / flux : 3e38;
}

float sea_water_index(float wavelength_nm, float temperature_c, float salinity) {
    float w = wavelength_nm;
    float t = temperature_c;
    float s = salinity;
    return 1.31405 + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t * t) * s - 2.02e-6 * t * t
         + (15.868 + 0.01155 * s - 0.00423 * t) / w - 4382.0 / (w * w) + 1.1455e6 / (w * w * w);
}
