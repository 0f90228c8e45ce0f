// Rays of an eye's panorama, which start on the viewing circle. Held to eyes.py.
uniform float eye_m;  // of the eye to the right of the middle, negative to the left

// where the ray in a direction of the camera's axes starts, in the same axes
vec3 ray_start(vec3 direction) {
    return eye_m * vec3(-direction.z, 0.0, direction.x);
}
