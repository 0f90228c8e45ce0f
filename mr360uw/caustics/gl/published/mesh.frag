// Intensity of a triangle at a pixel's centre. Held to caustics/published/divided_areas.py.
flat in float intensity;
in vec2 light_jacobian;
out float light;

void main() {
#ifdef RATIO
    light = intensity;
#else
    light = light_jacobian.x / max(abs(light_jacobian.y), 1e-6);
#endif
}
