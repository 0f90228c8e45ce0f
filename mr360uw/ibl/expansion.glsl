// twin: expansion.py
float mr360_gain(float luma, float strength, float power, float base) {
    return strength * pow(luma, power) + base;
}

float landis_gain(float value, float threshold, float alpha, float peak) {
    float w = pow(max(value - threshold, 0.0) / (1.0 - threshold), alpha);
    return 1.0 + (peak - 1.0) * w;
}

float akyuz_gain(float value, float gamma, float peak) {
    return peak * pow(max(value, 1e-6), gamma - 1.0);
}

float piecewise_gain(float value, float split, float peak) {
    float excess = max(value - split, 0.0);
    return 1.0 + excess * ((peak - split) / (1.0 - split) - 1.0) / max(value, split);
}

float region_ramp(float elevation, float edge, float ramp) {
    if (ramp == 0.0) return elevation >= edge ? 1.0 : 0.0;
    float t = clamp((elevation - edge) / (2.0 * ramp) + 0.5, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}
