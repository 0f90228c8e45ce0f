// one axis of the sun's disc
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
        float pair = texelFetch(image, (at + i * axis) % size, 0).r
                   + texelFetch(image, (at - i * axis + (i / size + 1) * size) % size, 0).r;
        blurred += texelFetch(weights, ivec2(i, 0), 0).r * pair;
    }
}
