// the mean of 2x2 columns: a linear filter between four texels
uniform sampler2D columns;
out vec4 column;

void main() {
    column = textureLod(columns, 2.0 * gl_FragCoord.xy / vec2(textureSize(columns, 0)), 0.0);
}
