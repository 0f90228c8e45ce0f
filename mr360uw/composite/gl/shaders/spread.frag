// What groups of fragments see of the sun, for each fragment; all of it for those without a group. Held to
// composite/gl/sun_groups.py.
#include "composite/gl/shaders/blocks.glsl"
uniform sampler2D groups, values;
uniform int count;
out vec2 seen;

void main() {
    int number = min(lane_number(ivec2(gl_FragCoord.xy)), count - 1);
    int group = int(texelFetch(groups, list_place(number), 0).r);
    vec2 value = texelFetch(values, lane_place(max(group, 0)), 0).rg;
    seen = group < 0 ? vec2(1.0) : value;
}
