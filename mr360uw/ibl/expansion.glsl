// twin: expansion.py
float region_ramp(float elevation, float edge, float ramp) {
    if (ramp == 0.0) return elevation >= edge ? 1.0 : 0.0;
    float t = clamp((elevation - edge) / (2.0 * ramp) + 0.5, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}
