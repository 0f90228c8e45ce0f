// twin: surface.py
struct SurfaceFields {
    float height;
    vec2 shift;   // x, z
    vec2 slope;
    vec3 strain;  // xx, zz, xz
};

vec3 surface_normal(SurfaceFields f, vec2 detail) {
    vec3 n = vec3(f.slope.y * f.strain.z - (1.0 + f.strain.y) * f.slope.x,
                  (1.0 + f.strain.x) * (1.0 + f.strain.y) - f.strain.z * f.strain.z,
                  f.slope.x * f.strain.z - (1.0 + f.strain.x) * f.slope.y);
    n -= vec3(detail.x, 0.0, detail.y) * n.y;
    return n / max(length(n), 1e-30);
}

float surface_jacobian(SurfaceFields f) {
    return (1.0 + f.strain.x) * (1.0 + f.strain.y) - f.strain.z * f.strain.z;
}
