// Convolution along one axis of the sun's disc. Held to caustics/flux/sun_disc.py.
uniform sampler2D image;
uniform sampler2D weights;  // symmetric: the middle and one side
uniform int reach;
uniform ivec2 axis;
uniform int size;
out float blurred;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    blurred = texelFetch(weights, ivec2(0), 0).r * texelFetch(image, at, 0).r;
    for (int i = 1; i <= reach; ++i) {
        ivec2 after = at + i * axis;
        ivec2 before = at - i * axis;
        after -= size * ivec2(greaterThanEqual(after, ivec2(size)));
        before += size * ivec2(lessThan(before, ivec2(0)));
        float pair = texelFetch(image, after, 0).r + texelFetch(image, before, 0).r;
        blurred += texelFetch(weights, ivec2(i, 0), 0).r * pair;
    }
}
