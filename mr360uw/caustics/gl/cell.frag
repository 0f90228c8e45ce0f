// Flux of one cell into one pixel. Held to caustics/flux/deposit.py.
#include "caustics/flux/cell.glsl"
#ifdef RECTANGLES
#define cell_ab quad_ab
#define cell_cd quad_cd
#define cell_light_at quad_light_at
#endif
flat in vec4 cell_ab;
flat in vec4 cell_cd;
flat in vec4 cell_light_at;

out float light;

void main() {
    vec2 pixel = floor(gl_FragCoord.xy) - cell_light_at.zw;
    light = cell_light(Cell(cell_ab.xy - pixel, cell_ab.zw - pixel, cell_cd.xy - pixel, cell_cd.zw - pixel),
                       cell_light_at.xy);
}
