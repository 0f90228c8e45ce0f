// Coarse map of a plate: mean expanded radiance and brightest luminance of each cell. Held to ibl/plate.py.
#include "ibl/gl/reduce.glsl"
uniform sampler2D plate, gains, curve;
uniform Expansion expansion;
uniform ivec2 cells;
out vec4 reduced;
void main() {
    reduced = reduce_cell(expansion, plate, gains, curve, ivec2(gl_FragCoord.xy), cells);
}
