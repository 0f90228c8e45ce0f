// Camera rays. Held to types/frames.py
#include "sphere.glsl"

struct Camera {
    vec2 size;
    vec3 position;
    mat3 world_from_camera;
    int projection;  // 0 equirectangular, 1 perspective, 2 orthographic
    float half_width;  // of the frame at distance 1, or of parallel rays
};

vec2 from_middle(Camera camera, vec2 place) {
    return vec2(2.0 * place.x - camera.size.x, camera.size.y - 2.0 * place.y) / camera.size.x;
}

vec3 camera_direction(Camera camera, vec2 place) {
    if (camera.projection == 0) return camera.world_from_camera * direction_from_frame(place, camera.size);
    vec2 aside = camera.projection == 1 ? camera.half_width * from_middle(camera, place) : vec2(0.0);
    return camera.world_from_camera * normalize(vec3(aside, -1.0));
}

vec3 camera_origin(Camera camera, vec2 place) {
    if (camera.projection != 2) return camera.position;
    return camera.position + camera.world_from_camera * vec3(camera.half_width * from_middle(camera, place), 0.0);
}
