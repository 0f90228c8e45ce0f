// The darker of two scrolled copies of a map, the second turned by a quarter. Held to caustics/published/scrolling.py.
uniform sampler2D light;
uniform int size;
uniform ivec4 shift;
out float darker;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) + size;
    darker = min(texelFetch(light, (at - shift.xy) % size, 0).r, texelFetch(light, ((at - shift.zw) % size).yx, 0).r);
}
