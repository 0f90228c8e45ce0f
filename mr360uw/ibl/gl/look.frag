// Plate at listed frame coordinates, bilinear, closed over the seam. Held to ibl/plate.py.
uniform sampler2D plate, places;
out vec4 seen;
vec3 texel(ivec2 p) {
    ivec2 size = textureSize(plate, 0);
    return texelFetch(plate, ivec2((p.x + size.x) % size.x, clamp(p.y, 0, size.y - 1)), 0).rgb;
}
void main() {
    vec2 p = texelFetch(places, ivec2(gl_FragCoord.xy), 0).rg - 0.5;
    ivec2 corner = ivec2(floor(p));
    vec2 f = p - vec2(corner);
    seen = vec4(mix(mix(texel(corner), texel(corner + ivec2(1, 0)), f.x),
                    mix(texel(corner + ivec2(0, 1)), texel(corner + ivec2(1, 1)), f.x), f.y), 1.0);
}
