// Rays of an eye's panorama, which start on the viewing circle. Held to types.py.

// where the ray in a direction of the camera's axes starts, in the same axes; eye_m: of the eye to the right of the
// middle, negative to the left
vec3 ray_start(vec3 direction, float eye_m) {
    return eye_m * vec3(-direction.z, 0.0, direction.x);
}
