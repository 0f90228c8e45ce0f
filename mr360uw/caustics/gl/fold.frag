// Sum of the flux inside the tile and of what was drawn beyond its edges, plus the even light below.
// Held to caustics/flux/deposit.py.
uniform sampler2D light;
uniform int size;
out float folded;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    folded = texelFetch(light, at, 0).r + texelFetch(light, at + ivec2(size, 0), 0).r
           + texelFetch(light, at + ivec2(0, size), 0).r + texelFetch(light, at + ivec2(size), 0).r
           + texelFetch(light, ivec2(0, 2 * size), 0).r / float(size * size);
}
