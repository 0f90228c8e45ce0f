// Convolution along one axis of a periodic map; rows may be moved along x in proportion to their distance.
// Held to caustics/flux/sun_disc.py and caustics/flux/detail_blur.py.
uniform sampler2D image;
uniform sampler2D weights;  // symmetric: the middle and one side
uniform int reach;
uniform ivec2 axis;
uniform float shear;  // pixels along x for each step
uniform int size;
uniform float scale;
#ifdef ADD
uniform sampler2D onto;
#endif
out float blurred;

float read(ivec2 at, int steps) {
    float moved = shear * float(steps);
    float whole = floor(moved);
    ivec2 place = at + steps * axis + ivec2(int(whole), 0);
    place -= size * ivec2(floor(vec2(place) / float(size)));
    float f = moved - whole;
    if (f == 0.0) return texelFetch(image, place, 0).r;
    // cubic convolution (Keys 1981), which does not blur to second order
    vec4 share = vec4(f * (-0.5 + f * (1.0 - 0.5 * f)), 1.0 + f * f * (1.5 * f - 2.5),
                      f * (0.5 + f * (2.0 - 1.5 * f)), f * f * (0.5 * f - 0.5));
    float sum = 0.0;
    for (int k = 0; k < 4; ++k) {
        int x = place.x + k - 1;
        x += x < 0 ? size : x < size ? 0 : -size;
        sum += share[k] * texelFetch(image, ivec2(x, place.y), 0).r;
    }
    return sum;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    blurred = texelFetch(weights, ivec2(0), 0).r * read(at, 0);
    for (int i = 1; i <= reach; ++i) blurred += texelFetch(weights, ivec2(i, 0), 0).r * (read(at, i) + read(at, -i));
    blurred *= scale;
#ifdef ADD
    blurred += texelFetch(onto, at, 0).r;
#endif
}
