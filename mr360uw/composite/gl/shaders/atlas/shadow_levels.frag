// Levels of the shadow atlas: means of `side` x `side` texels of a part of a texture. Held to
// composite/lighting/shadow.py.
uniform sampler2D source;
uniform int side;  // 1 or 2
uniform ivec2 corner;  // of the target's part
out vec4 column;

void main() {
    ivec2 place = side * (ivec2(gl_FragCoord.xy) - corner);
    column = texelFetch(source, place, 0);
    if (side == 2)
        column = 0.25 * (column + texelFetch(source, place + ivec2(1, 0), 0) + texelFetch(source, place + ivec2(0, 1), 0)
                         + texelFetch(source, place + 1, 0));
}
