// Points of the grid that the sun sees: 1, and `dark` in the shadow of other waves. Held to caustics/flux/shadowed.py.
uniform sampler2D position;
uniform vec3 towards;  // the sun: horizontal unit vector over (x, z), and the rise along it
uniform int grid;
uniform int steps;
uniform float dark;
out float lit;

// shift x, height, shift z in cells
vec3 surface_at(vec2 place) {
    vec2 whole = floor(place);
    vec2 f = place - whole;
    ivec2 i = ivec2(whole - float(grid) * floor(whole / float(grid)));
    ivec2 j = ivec2(i.x + 1 < grid ? i.x + 1 : 0, i.y + 1 < grid ? i.y + 1 : 0);
    return float(grid) * mix(mix(texelFetch(position, i, 0).xyz, texelFetch(position, ivec2(j.x, i.y), 0).xyz, f.x),
                             mix(texelFetch(position, ivec2(i.x, j.y), 0).xyz, texelFetch(position, j, 0).xyz, f.x), f.y);
}

void main() {
    vec2 rest = floor(gl_FragCoord.xy);
    vec3 start = surface_at(rest);
    vec2 place = rest + start.xz;
    float height = start.y;
    lit = 1.0;
    for (int i = 0; i < steps && lit == 1.0; ++i) {
        place += towards.xy;
        height += towards.z;
        rest = place - surface_at(rest + towards.xy).xz;
        if (surface_at(rest).y > height) lit = dark;
    }
}
