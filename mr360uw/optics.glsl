// twin: optics.py

// not the built-in refract, which is zero under total reflection
vec3 refract_clamped(vec3 travel, vec3 normal, float eta) {
    float cosine = dot(travel, normal);
    float k = max(1.0 - eta * eta * (1.0 - cosine * cosine), 0.0);
    return eta * travel - (eta * cosine + sqrt(k)) * normal;
}

float fresnel_transmittance(float cos_air, float refractive_index) {
    float c_i = max(cos_air, 0.0);
    float n = refractive_index;
    float c_t = sqrt(1.0 - (1.0 - c_i * c_i) / (n * n));
    float s = c_i + n * c_t;
    float p = n * c_i + c_t;
    return 2.0 * n * c_i * c_t * (1.0 / (s * s) + 1.0 / (p * p));
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
