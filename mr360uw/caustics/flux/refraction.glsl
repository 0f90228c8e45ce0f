// twin: refraction.py
// not the built-in refract: total reflection grazes the surface instead of giving zero
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
