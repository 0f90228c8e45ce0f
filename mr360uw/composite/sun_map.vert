uniform mat4 sun_from_object;
uniform vec4 slot;
in vec4 corner;
out float along;

void main() {
    vec3 place = (sun_from_object * vec4(corner.xyz, 1.0)).xyz;
    along = place.z;
    gl_Position = vec4((place.xy - slot.xy) * slot.zw, 0.0, 1.0);
}
