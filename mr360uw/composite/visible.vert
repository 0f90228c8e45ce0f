#include "sphere.glsl"
uniform mat4 camera_from_object;
in vec4 corner;
out vec4 placed;

void main() {
    placed = vec4((camera_from_object * vec4(corner.xyz, 1.0)).xyz, corner.w);
}
