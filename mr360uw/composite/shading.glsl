// twin: shading.py
const float MINIMUM_ALPHA = 0.002;
const float LEAST_COSINE = 0.001;
const float PIXEL_POINT = 0.28867513;  // 1/sqrt(12)

float ggx_distribution(float n_dot_h, float alpha) {
    float squared = alpha * alpha;
    float d = n_dot_h * n_dot_h * (squared - 1.0) + 1.0;
    return squared * INV_PI / (d * d);
}

float smith_visibility(float n_dot_v, float n_dot_l, float alpha) {
    float squared = alpha * alpha;
    float v = n_dot_l * sqrt(n_dot_v * n_dot_v * (1.0 - squared) + squared);
    float s = n_dot_v * sqrt(n_dot_l * n_dot_l * (1.0 - squared) + squared);
    return 0.5 / max(v + s, 1e-6);
}

vec3 grazing_reflectance(vec3 f0) {
    return min(pow(max(f0, 0.0) / 0.04, vec3(0.2)), 1.0);
}

vec3 lobe_axis(vec3 normal, vec3 view, float n_dot_v, float roughness) {
    vec3 mirror = 2.0 * dot(normal, view) * normal - view;
    float lean = (1.0 - roughness) * (1.0 + roughness * (1.01 - 1.86 * roughness + n_dot_v * (1.15 + 1.27 * roughness)));
    vec3 axis = normal + (mirror - normal) * min(lean, 1.0);
    return axis / max(length(axis), 1e-6);
}

vec3 reflectance(vec3 f0, vec2 split) {
    vec3 single = f0 * split.x + grazing_reflectance(f0) * split.y;
    return single * (1.0 + f0 * (1.0 / max(split.x + split.y, 1e-3) - 1.0));
}

float resolved_alpha(float roughness, vec3 columns, vec3 rows) {
    float squared = roughness * roughness;
    return sqrt(min(max(squared * squared, (dot(columns, columns) + dot(rows, rows)) / 24.0), 1.0));
}

vec3 highlight(vec3 f0, float alpha, float n_dot_v, float n_dot_l, float n_dot_h, float v_dot_h, float half_angle) {
    float spread = 0.5 * half_angle * inversesqrt(max(v_dot_h, LEAST_COSINE));  // derived in shading.py
    float wide = min(length(vec2(max(alpha, MINIMUM_ALPHA), spread)), 1.0);
    float lobe = ggx_distribution(n_dot_h, wide) * smith_visibility(n_dot_v, n_dot_l, wide) * n_dot_l;
    float grazing = pow(clamp(1.0 - v_dot_h, 0.0, 1.0), 5.0);
    return lobe * (f0 + (grazing_reflectance(f0) - f0) * grazing);
}
