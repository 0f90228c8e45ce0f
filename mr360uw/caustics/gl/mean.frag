// Mean along one axis of the sum of an image's first two channels. Held to caustics/flux/irradiance.py.
uniform sampler2D image;
uniform ivec2 axis;
uniform int count;
out float mean;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy) * (1 - axis);
    float total = 0.0;
    for (int i = 0; i < count; ++i) total += dot(texelFetch(image, at + i * axis, 0).rg, vec2(1.0));
    mean = total / float(count);
}
