// twin: sphere.py
vec3 direction_from_frame(vec2 position, vec2 size) {
    float longitude = 2.0 * PI * (position.x / size.x - 0.5);
    float latitude = PI * (0.5 - position.y / size.y);
    float cos_latitude = cos(latitude);
    return vec3(cos_latitude * sin(longitude), sin(latitude), -cos_latitude * cos(longitude));
}

vec2 frame_from_direction(vec3 direction, vec2 size) {
    float longitude = atan(direction.x, -direction.z);
    float latitude = atan(direction.y, length(direction.xz));
    return size * vec2(longitude / (2.0 * PI) + 0.5, 0.5 - latitude / PI);
}
